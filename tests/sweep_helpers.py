"""Sweeps and comparisons called as a user calls them, and what they leave."""

from __future__ import annotations

import contextlib
import csv
import importlib.util
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

from moody_backend import CONFIGS

from rbtm_bench.cli.commands import main

TESTS = Path(__file__).parent
SMALL = ("dataset.scans=12", "selector=previous")
MOODY = ("--config-dir", str(CONFIGS))


def script(name: str) -> ModuleType:
    """A module out of scripts/benchmarks/."""
    spec = importlib.util.spec_from_file_location(
        name, TESTS.parent / "scripts" / "benchmarks" / f"{name}.py"
    )
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def environment() -> dict[str, str]:
    """This one's, with the moody backend to be found."""
    path = os.environ.get("PYTHONPATH")
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, [str(TESTS), path]))}


def begin(*words: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "rbtm_bench", *words],
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def call(*words: str, cwd: Path | None = None) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command in this very process."""
    out, err = io.StringIO(), io.StringIO()
    place = contextlib.chdir(cwd) if cwd else contextlib.nullcontext()
    with place, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(list(words))
    assert "Traceback" not in err.getvalue(), err.getvalue()
    return code, out.getvalue(), err.getvalue()


def outside(*words: str) -> tuple[int, str, str]:
    """The same of a command in a process of its own."""
    process = begin(*words)
    out, err = process.communicate(timeout=300)
    assert "Traceback" not in err, err
    return process.returncode, out, err


def rows(out: Path) -> dict[str, dict[str, str]]:
    """The table of a sweep, by run."""
    with open(out / "table.csv", newline="") as file:
        return {row["run"]: row for row in csv.DictReader(file)}


def statuses(out: Path) -> list[str]:
    return [row["status"] for row in rows(out).values()]


def record_of(out: Path) -> dict[str, Any]:
    value = json.loads((out / "run.json").read_text())
    assert isinstance(value, dict)
    return value


def edit(path: Path, **values: Any) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))
