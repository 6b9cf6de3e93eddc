"""Where a run's numbers come from."""

from __future__ import annotations

import datetime
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from rbtm_bench import __version__
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.runs import provenance
from rbtm_bench.runs.settings import compose_settings


def test_a_record_before_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["/somewhere/rbtm-bench", "run", "out=my runs", "seed=3"])
    settings = compose_settings(["seed=3", "backend=none"])
    dataset = Corridor(scans=5, beams=61, seed=3)
    record = provenance.of_run(settings, dataset, 1)
    assert (record["status"], record["reason"], record["finished"]) == ("started", None, None)
    assert record["command"] == "rbtm-bench run 'out=my runs' seed=3"
    assert record["overrides"] == ["seed=3", "backend=none"] and record["seed"] == 3
    assert (record["scans"], record["core"]) == (5, 1)
    assert record["dataset_fingerprint"] == dataset.fingerprint()
    assert record["versions"]["rbtm_bench"] == __version__
    json.dumps(record, allow_nan=False)


def test_a_record_of_a_run_without_data() -> None:
    record = provenance.of_run(compose_settings([]), None, None)
    assert record["scans"] is record["dataset_fingerprint"] is record["skipped_records"] is None


def test_versions_of_what_makes_the_numbers(monkeypatch: pytest.MonkeyPatch) -> None:
    found = provenance.packages()
    assert all(found[name] for name in ("numpy", "scipy", "open3d", "kiss-icp", "hydra-core"))
    monkeypatch.setattr(provenance, "PACKAGES", ("a-package-that-is-not-there",))
    assert provenance.packages() == {"a-package-that-is-not-there": None}


def test_times_are_iso_with_a_zone() -> None:
    moment = datetime.datetime.fromisoformat(provenance.now())
    assert moment.tzinfo is not None and moment.microsecond == 0
    assert abs(datetime.datetime.now(datetime.UTC) - moment) < datetime.timedelta(seconds=5)


def checkout(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make ``folder`` the place that the package seems to run from."""
    module = folder / "rbtm_bench" / "runs" / "provenance.py"
    module.parent.mkdir(parents=True)
    module.touch()
    monkeypatch.setattr(provenance, "__file__", str(module))


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_git_hash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkout(tmp_path, monkeypatch)
    assert provenance.git_hash() is None  # an installed package
    git = ["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@example.org"]
    for words in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "first"]):
        subprocess.run([*git, *words], check=True, capture_output=True)
    clean = provenance.git_hash()
    assert clean is not None and re.fullmatch(r"[0-9a-f]{12}", clean)
    (tmp_path / "rbtm_bench" / "runs" / "provenance.py").write_text("# changed\n")
    assert provenance.git_hash() == f"{clean}+"


def test_no_git_is_no_hash(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    checkout(tmp_path, monkeypatch)
    (tmp_path / ".git").mkdir()
    assert provenance.git_hash() is None  # not a repository
    monkeypatch.setenv("PATH", str(tmp_path))
    assert provenance.git_hash() is None  # no git at all
