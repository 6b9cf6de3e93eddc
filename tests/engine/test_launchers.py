"""Sweeps by every launcher give the table that the basic one gives."""

from __future__ import annotations

import csv
import importlib.util
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine import hydra_sweep
from rbtm_bench.metrics.cost import COLUMNS
from rbtm_bench.runs.settings import composed, composing

GRID = ("backend=open3d_p2p", "seed=0,1", "dataset.scans=10", "controls=none")
WORDS = ("selector.window=4,8", *GRID)
HALF = ("selector.window=4", *GRID)
"""The first two of these runs, for launchers that start a process a run."""
OWN = ("pairs.store=per_worker",)
START_TRIES = 3
"""Ray's start, and only that, may time out on a loaded machine."""
START_S = 300.0
NOT_STARTED = re.compile(
    r"the launcher gave up: .*(timed? ?out|failed to start|could not (connect|find)|unavailable)",
    re.IGNORECASE,
)


def command(*words: str) -> list[str]:
    return [sys.executable, "-m", "rbtm_bench", "sweep", *words]


def sweep(out: Path, launcher: str, *words: str, grid: tuple[str, ...] = WORDS) -> tuple[int, str]:
    """Exit code and standard error of a sweep."""
    done = subprocess.run(
        command(*grid, *words, f"hydra/launcher={launcher}", f"out={out}"),
        env={**os.environ, "RAY_AUTH_MODE": "disabled"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=2 * START_S,
    )
    return done.returncode, done.stderr


def table(out: Path) -> list[dict[str, str]]:
    """The rows of a sweep without what differs from time to time."""
    costs = ("seconds", "reused", *COLUMNS)
    with open(out / "table.csv", newline="") as file:
        return [
            {key: value for key, value in row.items() if key not in costs}
            for row in csv.DictReader(file)
        ]


def needs(module: str, extra: str) -> None:
    """Skip where a launcher is not installed; never where CI runs."""
    if importlib.util.find_spec(module) is None:
        message = f"{module} is not installed: pip install '.[{extra}]'"
        if os.environ.get("CI") == "true":
            pytest.fail(message)
        pytest.skip(message)


@pytest.fixture(scope="module")
def basic(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, str]]:
    """The table of Hydra's basic launcher."""
    out = tmp_path_factory.mktemp("basic") / "out"
    code, err = sweep(out, "basic")
    assert code == 0, err
    rows = table(out)
    assert [(row["window"], row["seed"]) for row in rows] == [
        ("4", "0"),
        ("4", "1"),
        ("8", "0"),
        ("8", "1"),
    ]
    assert all(row["status"] == "done" for row in rows)
    return rows


@pytest.mark.slow
def test_joblib(tmp_path: Path, basic: list[dict[str, str]]) -> None:
    code, err = sweep(tmp_path / "out", "joblib", "hydra.launcher.n_jobs=2")
    assert code == 0, err
    assert table(tmp_path / "out") == basic


@pytest.mark.slow
def test_submitit_local(tmp_path: Path, basic: list[dict[str, str]]) -> None:
    """For real: submitit's executor for this machine, a process a run, all at once."""
    needs("hydra_plugins.hydra_submitit_launcher", "slurm")
    words = ("hydra.launcher.timeout_min=5",)
    code, err = sweep(tmp_path / "out", "submitit_local", *words, grid=HALF)
    assert code == 0, err
    assert table(tmp_path / "out") == basic[:2]


@pytest.mark.slow
def test_ray(tmp_path: Path, basic: list[dict[str, str]]) -> None:
    """For real: a cluster on this machine."""
    needs("hydra_plugins.hydra_ray_launcher", "ray")
    for attempt in range(START_TRIES):
        out = tmp_path / f"out{attempt}"
        code, err = sweep(out, "ray_local", "hydra.launcher.ray.init.num_cpus=2", grid=HALF)
        started = any(path.name.isdigit() for path in out.iterdir())
        if started or not NOT_STARTED.search(err):
            break
    assert code == 0, err
    assert table(out) == basic[:2]


@pytest.mark.slow
def test_the_slurm_preset_is_what_sbatch_gets(tmp_path: Path) -> None:
    """There is no SLURM here: a stand-in for sbatch keeps the script that it is given."""
    needs("hydra_plugins.hydra_submitit_launcher", "slurm")
    tools = tmp_path / "bin"
    tools.mkdir()
    for name, text in (("srun", "exit 1"), ("sbatch", f'cp "$1" "{tmp_path}/script"; exit 1')):
        (tools / name).write_text(f"#!/bin/sh\n{text}\n")
        (tools / name).chmod(0o755)
    out = tmp_path / "out"
    done = subprocess.run(
        command(
            *WORDS, "hydra/launcher=slurm", "hydra.launcher.partition=short", *OWN, f"out={out}"
        ),
        env={**os.environ, "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 1 and "the launcher gave up" in done.stderr
    script = (tmp_path / "script").read_text()
    options = set(re.findall(r"^#SBATCH --(\S+)$", script, re.MULTILINE))
    assert {
        "array=0-3%4",
        "cpus-per-task=1",
        "mem=4GB",
        "nodes=1",
        "ntasks-per-node=1",
        "partition=short",
        "time=240",
    } <= options


@pytest.mark.parametrize("name", ["ray_local", "ray_cluster"])
def test_the_ray_presets_compose(name: str) -> None:
    needs("hydra_plugins.hydra_ray_launcher", "ray")
    with composing() as words:
        launcher = composed([f"hydra/launcher={name}", *words]).hydra.launcher
    assert launcher._target_.endswith("RayLauncher")
    assert launcher.ray.remote == {"num_cpus": 1, "max_retries": 0}


@pytest.mark.parametrize(
    ("name", "extra"),
    [("ray", "ray"), ("ray_local", "ray"), ("slurm", "slurm"), ("submitit_slurm", "slurm")],
)
def test_a_missing_launcher_names_its_extra(
    name: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(hydra_sweep.importlib.util, "find_spec", lambda module: None)
    with pytest.raises(ConfigError) as error:
        hydra_sweep.SweepPlan.of([f"hydra/launcher={name}"], ())
    assert error.value.exit_code == 2
    assert str(error.value) == (
        f"hydra/launcher={name}: not installed: pip install 'rbtm-bench[{extra}]'"
    )
