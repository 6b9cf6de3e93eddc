"""What is installed, what is missing, and what to do about it: list and doctor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rbtm_bench.cli import about
from rbtm_bench.cli.commands import main
from rbtm_bench.runs.declared import PLUGIN_GROUPS
from rbtm_bench.runs.settings import config_dir, members

MINE = '''"""A matcher of somebody else.

With more to say about it.
"""

from rbtm_bench.backends.base import Backend


class Mine(Backend):
    requires = {requires}

    def build(self, points, planar):
        return None

    def align(self, source, target, T_target_source):
        return None
'''

BLOCK = """
import sys

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}")

sys.meta_path.insert(0, Block())
"""


def listed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    capsys.readouterr()
    assert main(["list", *words]) == 0
    return capsys.readouterr().out


def blocked(tmp_path: Path, *names: str) -> dict[str, str]:
    """An environment without these packages."""
    (tmp_path / "sitecustomize.py").write_text(BLOCK.format(names=names))
    return {**os.environ, "PYTHONPATH": str(tmp_path)}


def doctor(environment: dict[str, str], folder: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "rbtm_bench", "doctor"]
    return subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True)


# --- list


def test_every_plugin_with_its_parameters(capsys: pytest.CaptureFixture[str]) -> None:
    text = listed(capsys)
    sections = [line[:-1] for line in text.splitlines() if not line.startswith(" ")]
    assert sections == list(PLUGIN_GROUPS)
    for file in sorted(config_dir().glob("*/*.yaml")):
        if file.parent.name in PLUGIN_GROUPS:
            assert f"\n  {file.stem} " in text, file.stem
    for setting in (
        "selector.window=10",
        "backend.kernel=none",
        "backend.kernel=null",
        "backend.coarse_to_fine=[1.0]",
        "dataset.path=???",
        "dataset.seed=${seed}",
        "similarity.center=false",
    ):
        assert f"      {setting}\n" in text
    assert "[missing]" not in text and "_target_" not in text


def test_one_group_and_names_only(capsys: pytest.CaptureFixture[str]) -> None:
    text = listed(capsys, "selector", "--names")
    assert text.splitlines() == ["selector:", *(f"  {name}" for name in members("selector"))]


def test_plugins_of_others_and_why_they_cannot_be_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    configs = tmp_path / "their_configs" / "backend"
    configs.mkdir(parents=True)
    for name, requires in (("whole", ()), ("lacking", ("numpy", "no_such_library"))):
        (tmp_path / f"their_{name}.py").write_text(MINE.format(requires=requires))
        (configs / f"{name}.yaml").write_text(f"_target_: their_{name}.Mine\nvoxel_size: 0.5\n")
    (configs / "absent.yaml").write_text("_target_: their_absent.Mine\n")
    (configs / "damaged.yaml").write_text("a: [1\n")
    monkeypatch.syspath_prepend(tmp_path)
    text = listed(capsys, "backend", "--config-dir", str(configs.parent))
    lines = {line.split()[0]: line for line in text.splitlines() if line.startswith("  ")}
    assert lines["whole"].endswith("A matcher of somebody else.")
    assert "\n      backend.voxel_size=0.5\n" in text
    assert lines["lacking"].endswith("[missing] needs no_such_library")
    assert "[missing] " in lines["absent"] and "No module named 'their_absent'" in lines["absent"]
    assert "[missing] " in lines["damaged"]
    assert "open3d_p2p" in lines and "[missing]" not in lines["open3d_p2p"]


def test_a_missing_library_is_listed_as_missing(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "rbtm_bench", "list", "backend"],
        env=blocked(tmp_path, "kiss_icp"),
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("  kiss_icp ")]
    assert "[missing]" in line and "kiss_icp" in line.split("[missing]")[1]


# --- doctor


def test_all_is_well(tmp_path: Path) -> None:
    done = doctor({**os.environ, "RBTM_BENCH_DATA": ""}, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[-1] == "all is well"
    assert "BAD" not in done.stdout and "Traceback" not in done.stdout
    for word in ("Python 3", "open3d", "kiss-icp", "hydra-core", "backend: ", "kiss_icp", "cores"):
        assert word in done.stdout
    assert "RBTM_BENCH_DATA is not set" in done.stdout


def test_a_missing_library_comes_with_advice(tmp_path: Path) -> None:
    done = doctor(blocked(tmp_path, "kiss_icp", "jinja2"), tmp_path)
    assert (done.returncode, done.stderr) == (1, "")
    assert "BAD  kiss-icp cannot be imported" in done.stdout
    advice = done.stdout.split(" to mend:")[1]
    assert "pip install kiss-icp" in advice and "pip install jinja2" in advice
    assert "backend=kiss_icp is not usable" in advice
    assert "all is well" not in done.stdout


@pytest.mark.parametrize("kind", ["ImportError", "OSError"])
def test_a_missing_system_library_comes_with_advice(tmp_path: Path, kind: str) -> None:
    broken = tmp_path / "open3d" / "__init__.py"
    broken.parent.mkdir()
    broken.write_text(f"raise {kind}('libX11.so.6: cannot open shared object file')\n")
    done = doctor({**os.environ, "PYTHONPATH": str(tmp_path)}, tmp_path)
    assert (done.returncode, done.stderr) == (1, "")
    assert "BAD  open3d cannot be imported (libX11.so.6" in done.stdout
    assert "apt-get install" in done.stdout.split(" to mend:")[1]


@pytest.mark.parametrize("package", ["hydra", "pydantic", "numpy"])
def test_even_without_what_everything_needs(tmp_path: Path, package: str) -> None:
    done = doctor(blocked(tmp_path, package), tmp_path)
    assert (done.returncode, done.stderr) == (1, "")
    assert "pip install" in done.stdout.split(" to mend:")[1]


def test_data_that_are_not_where_they_should_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RBTM_BENCH_DATA", str(tmp_path))
    *_, check = about._machine_checks()
    assert check.problem is not None and "freiburg/" in check.problem
    (tmp_path / "freiburg").mkdir()
    *_, check = about._machine_checks()
    assert check.problem is None and check.line == f"ok   RBTM_BENCH_DATA={tmp_path}"
