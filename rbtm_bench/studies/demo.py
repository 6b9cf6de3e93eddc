"""The main job on the embedded corridor: every backend, every way to choose the model scan.

Settings were chosen on seeds 100 to 104 by ``rbtm-bench study demo`` (four tries for each
strategy); shown are seeds 5 to 9, on which nothing was tuned. Leaves results/demo/table.csv (a
row a run), summary.csv (a row a method, medians) and figures.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from rbtm_bench import plots
from rbtm_bench.core.files import make_folder
from rbtm_bench.core.guarded import guarded
from rbtm_bench.engine import drive
from rbtm_bench.engine.progress import bar
from rbtm_bench.report import screen
from rbtm_bench.runs import stored
from rbtm_bench.runs.grid import make_points

OUT = Path("results/demo")
BACKENDS = "open3d_p2p,open3d_p2plane,open3d_gicp,kiss_icp"
SEEDS = "5,6,7,8,9"
GRIDS = (
    ["backend=none", "selector=previous"],
    [f"backend={BACKENDS}", "selector=previous"],
    [f"backend={BACKENDS}", "selector=keyframe", "selector.distance=0.3"],
    [f"backend={BACKENDS}", "selector=fixed_gap", "selector.gap=40"],
    [f"backend={BACKENDS}", "selector=oldest", "selector.window=32"],
    [
        f"backend={BACKENDS}",
        "selector=rbtm,random_gap",
        "selector.window=64",
        "selector.threshold=0.5",
    ],
)


def demo(out: Path) -> int:
    """Run the grids side by side and print the table, the verdict and the figures."""
    words = ["dataset=corridor", f"seed={SEEDS}", "overwrite=true"]
    points = [point for grid in GRIDS for point in make_points([*grid, *words])[0]]
    make_folder(out)
    failed: list[str] = []
    print(f"{len(points)} runs on the simulated corridor, 181 scans each, seeds {SEEDS}")
    with bar("runs", len(points)) as progress:

        def done(name: str, record: dict[str, Any]) -> None:
            if record["status"] != "done":
                failed.append(f"{name}: {record['reason']}")
            progress.step()

        drive.run_points(points, out, drive.default_jobs(), done)
    folders = [out / point.name for point in points]
    figures = plots.draw(stored.find_runs(folders), out / "figures")
    tables = screen.tables_of(folders)
    screen.write_tables(out, tables)
    print(screen.of_runs(out, tables))
    print("settings chosen on seeds 100-104, four tries for each strategy")
    for figure in figures:
        print(figure)
    for line in failed:
        print(f"failed: {line}", file=sys.stderr)
    return 1 if failed else 0


def main() -> int:
    """The demo; ``--debug`` shows a whole traceback."""
    return guarded(lambda: demo(OUT), debug="--debug" in sys.argv)
