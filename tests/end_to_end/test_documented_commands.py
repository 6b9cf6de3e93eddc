"""Every command that README and docs show is run: as it stands, small, or by a named test."""

from __future__ import annotations

import ast
import gzip
import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
from cloud_helpers import write_hall
from sweep_helpers import TESTS, call

REPO = TESTS.parent
PAGES = (REPO / "README.md", *sorted((REPO / "docs").glob("*.md")))
COMMAND = re.compile(
    r"(rbtm-bench|python scripts/|python -m (rbtm_bench|pytest)|(bash )?scripts/\w+\.sh|pytest) ?"
)

ELSEWHERE = {
    "bash scripts/demo.sh": "end_to_end/test_setup.py",
    "bash scripts/test.sh": "end_to_end/test_setup.py",
    "scripts/test.sh": "end_to_end/test_setup.py",
    "pytest ": "end_to_end/test_setup.py",
    "scripts/processors.sh": "end_to_end/test_setup.py",
    "rbtm-bench study": "studies/test_study.py",
    "python scripts/benchmarks/kill_sweep.py": "engine/test_stopped_sweeps.py",
    "python scripts/benchmarks/bench_": "end_to_end/test_benchmarks.py",
    "python scripts/benchmarks/best.py": "end_to_end/test_recipes.py",
    "python scripts/benchmarks/best_3d.py": "end_to_end/test_recipes.py",
    "python scripts/benchmarks/cases.py": "datasets/test_cases.py",
    "python scripts/benchmarks/placebo.py": "report/test_placebo.py",
    "python scripts/benchmarks/nothing_matches.py": "odometry/test_nothing_matches.py",
    "python scripts/make_python_page.py": "cli/test_python_page.py",
    "python scripts/mutants.py": "end_to_end/test_mutants.py",
    "python -m rbtm_bench.contract": "end_to_end/test_plugins.py",
    "rbtm-bench compare backend=open3d_p2p,my_icp": "end_to_end/test_plugins.py",
    "rbtm-bench list backend --config-dir": "end_to_end/test_plugins.py",
    "rbtm-bench sweep --resume": "engine/test_sweep_folder.py",
    "rbtm-bench sweep selector.window=8,16": "engine/test_launchers.py",
    "rbtm-bench sweep selector.threshold=0.5": "engine/test_launchers.py",
    "rbtm-bench sweep '+point": "runs/test_experiments.py",
    "rbtm-bench sweep +experiment": "runs/test_experiments.py",
    "rbtm-bench table results/overnight": "report/test_best.py",
    "rbtm-bench report results/sweep --serve": "page/test_live_page.py",
    "rbtm-bench run --config-dir mine": "calibration/test_calibrate_command.py",
    "rbtm-bench plot PATH": "plots/test_plots.py",
    "rbtm-bench new backend nearest": "cli/test_new.py",
    "rbtm-bench run backend=nearest": "cli/test_new.py",
    "python -m pytest plugins/": "cli/test_new.py",
    "rbtm-bench compare backend=open3d_p2p,nearest": "end_to_end/test_plugins.py",
    "rbtm-bench compare --resume": "engine/test_sweep_folder.py",
}
"""Starts of commands that need more than a small folder, and the tests that run them."""

SMALL = {
    "corridor": ("dataset.scans=10", "dataset.beams=181"),
    "simulated": ("dataset.scans=3", "dataset.azimuths=128"),
    "carmen": ("dataset.max_scans=24",),
    "kitti": ("dataset.max_scans=3",),
    "cloud_folder": ("dataset.max_scans=4",),
}
RUNS = ("run", "compare", "sweep")


def commands(text: str) -> Iterator[str]:
    """The commands of a page: lines of code, and code within a line."""
    code, begun = False, ""
    for line in text.splitlines():
        if line.lstrip().startswith("```"):
            code = not code
        elif code or line.startswith("    "):
            whole = f"{begun} {line.strip()}".strip()
            begun = whole[:-1].strip() if whole.endswith("\\") else ""
            if COMMAND.match(whole) and not begun:
                yield re.split(r"\s+#|\s{3,}", whole)[0].strip()
        else:
            yield from (m for m in re.findall(r"`([^`]+)`", line) if COMMAND.match(m))


SHOWN = {c: page.name for page in PAGES for c in commands(page.read_text(encoding="utf-8"))}
BARE = re.compile(r"rbtm-bench( \w+| table --\w+)?$")
"""Names of commands in a sentence: nothing to run."""
SMALL_ENOUGH = [
    command
    for command in SHOWN
    if not command.startswith(tuple(ELSEWHERE)) and not (BARE.match(command) and " " in command)
] + ["rbtm-bench run", "rbtm-bench list", "rbtm-bench doctor", "rbtm-bench calibrate"]


@pytest.mark.parametrize("start", ELSEWHERE)
def test_the_tests_of_other_commands_exist_and_the_commands_are_shown(start: str) -> None:
    path = TESTS / ELSEWHERE[start]
    names = [
        n.name for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.FunctionDef)
    ]
    assert any(name.startswith("test_") for name in names)
    pages = [*SHOWN, *commands((REPO / "results/reference/README.md").read_text("utf-8"))]
    assert any(command.startswith(start) for command in pages), f"no page shows {start}"


PLACES = {"a": "paper", "b": "bare", "bare": "bare", "paper": "paper", "aces": "l_turn"}
PLACES |= {"intel": "cluttered", "csail": "bare"}


def run(folder: Path, name: str, place: str, selector: str, backend="none", *words: str) -> None:
    """A run in the corridor that the pages call by this name."""
    choice = (f"dataset.environment={place}", f"selector={selector}", f"backend={backend}")
    code, _, error = call("run", *choice, *words, *SMALL["corridor"], f"out='{folder / name}'")
    assert code == 0, error


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, data_dir: Path) -> Path:
    """The data and the results that the pages name, small."""
    root = tmp_path_factory.mktemp("documented")
    with gzip.open(data_dir / "freiburg" / "aces.clf.gz", "rt") as log:
        lines = [next(log) for _ in range(400)]
    for name in ("aces.clf.gz", "intel.clf.gz"):
        with gzip.open(root / name, "wt") as log:
            log.writelines(lines)
    (root / "aces.relations").write_bytes((data_dir / "freiburg/aces.relations").read_bytes())
    for name in ("aces-corrected.log.gz", "intel-corrected.log.gz"):
        (root / name).symlink_to(data_dir / "corrected" / name)
    (root / "kitti").symlink_to(data_dir / "kitti")
    write_hall(root / "clouds", scans=4, suffix="pcd")
    (root / "clouds" / "poses.tum").rename(root / "poses.tum")
    for name, environment in PLACES.items():
        for selector in ("previous", "rbtm"):
            run(root / "results" / name, f"none-{selector}", environment, selector)
    for seed in (0, 1):
        for selector in ("previous", "keyframe", "rbtm"):
            for backend in ("none", "open3d_p2p"):
                name = f"{backend}-{selector}-seed={seed}"
                run(root / "results/compare", name, "paper", selector, backend, f"seed={seed}")
    for seed in (0, 100, 101, 102):
        for window in (4, 6):
            words = (f"seed={seed}", f"selector.window={window}")
            run(root / "results/sweep", f"{seed}-{window}", "paper", "rbtm", "none", *words)
    (root / "results" / "s1").symlink_to(root / "results" / "sweep")
    (root / "names.yaml").write_text("selector:\n  rbtm: Ours\n")
    for name in ("main", "first"):
        (root / "results" / name).symlink_to(root / "results" / "compare")
    return root


@pytest.mark.slow
@pytest.mark.parametrize("command", SMALL_ENOUGH)
def test_a_documented_command_works(command: str, folder: Path, tmp_path: Path) -> None:
    name, *words = shlex.split(command)[1:]
    words = words[: words.index(">")] if ">" in words else words
    if name in RUNS:
        words = [word for word in words if not word.startswith(("seed=", "out="))]
        words += (
            [] if "--resume" in words else ["controls=none"]
        )  # 22 runs more each: tests/engine/test_beside.py
    if name in (*RUNS, "similarity", "calibrate"):
        by_path = "carmen" if words and words[0].endswith(".clf.gz") else "corridor"
        kind = next((w.split("=")[1] for w in words if w.startswith("dataset=")), by_path)
        words = ["replicates=2" if w.startswith("replicates=") else w for w in words]
        words += SMALL[kind] if name != "calibrate" else ()
        words += [f"out={tmp_path / 'out'}"] if name in RUNS else ["--out", str(tmp_path / "out")]
    if name == "calibrate":
        words += ["--jobs", "1", "--replicates", "1"]
        words += ["--pairs", "40"] if "--pairs" not in words else []
        words = [w for w in words if w != "--write" and not w.startswith("mine/")]
    code, out, error = call(name, *words, cwd=folder)
    assert code == (1 if name == "diff" else 0), error  # diff: they differ
    assert out or list((tmp_path / "out").iterdir())
