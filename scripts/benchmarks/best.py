"""The recipe `+experiment=best_2d` on the three logs, without and with loops, by replicates.

    python scripts/benchmarks/best.py $RBTM_BENCH_DATA --out results/best
    python scripts/benchmarks/best.py $RBTM_BENCH_DATA --out results/best --without

Runs what is missing in OUT and writes `best.md` there: each row with its command, the recipe's
digest, and whether the log chose the recipe (tuned) or not (held out). Half an hour on two cores.
`--without` writes `without.md` instead: the recipe without each of its parts, on the logs that it
was chosen on.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

import rbtm_bench as rb
from rbtm_bench.calibration.reference import of_wheels
from rbtm_bench.calibration.track import track_of
from rbtm_bench.core.files import write_text
from rbtm_bench.report.frame import methods
from rbtm_bench.report.render import three_digits
from rbtm_bench.report.replicates import spread
from rbtm_bench.runs import stored

RECIPE = Path(__file__).parents[2] / "configs/experiment/best_2d.yaml"
LOGS = {"aces": "tuned", "mit-csail": "tuned", "intel": "held out"}
MEAN, LOOPED = "relations_translation_mean_m", "looped_relations_translation_mean_m"
SHOWN = (
    ("all relations, m", MEAN),
    ("all, deg", "relations_rotation_mean_deg"),
    ("local, m", "relations_local_translation_mean_m"),
    ("long, m", "relations_long_translation_mean_m"),
    ("with loops: all, m", LOOPED),
    ("with loops: deg", "looped_relations_rotation_mean_deg"),
    ("with loops: long, m", "looped_relations_long_translation_mean_m"),
)
APART = ("not the wheels' own, m (relations)", "the wheels' own, m (relations)", "largest, m")
WITHOUT: dict[str, list[str]] = {
    "the recipe": [],
    "without the search": ["search=none"],
    "without doubt of the search": ["search.doubt=0"],
    "without older keyframes": ["target.older=0"],
    "one keyframe as target": ["target.older=0", "target.keyframes=1"],
    "without the check": [
        *("check.min_fitness=0", "check.max_translation=1000", "check.max_rotation_deg=180"),
    ],
    "without the motion filter": ["motion_filter.distance=0"],
    "without the prior": ["guess_weight=null"],
    "guess=odometry": ["guess=odometry"],
    "without trimming": [
        *("backend.outliers_max_percent=1", "backend.outliers_adaptive_multiplier=1000"),
        "backend.outliers_refine_multiplier=0",
    ],
}
COSTS = (("ms a scan", "ms_per_scan"), ("ms a scan for loops", "loops_ms_per_scan"))


def words(log: Path, replicates: int, out: Path, changes: Sequence[str]) -> list[str]:
    """The command of a log's row."""
    own = [f"replicates={replicates}", "controls=none", "pictures=false"]
    return ["compare", str(log), "+experiment=best_2d", *changes, *own, f"out={out}"]


def run(log: Path, replicates: int, out: Path, changes: Sequence[str]) -> None:
    """Run what is missing of it."""
    own = words(log, replicates, out, changes)
    command = ["compare", "--resume", str(out)] if (out / "sweep.json").exists() else own
    subprocess.run([sys.executable, "-m", "rbtm_bench", *command], check=True)


def row(folder: Path) -> list[str]:
    """The numbers of a log: medians over the distinct replicates."""
    (method,) = methods(stored.find_runs([folder]))
    cells = []
    for _, key in SHOWN:
        over = spread(method.runs, key)
        if over is None:
            cells.append("-")
            continue
        middle, q1, q3, worst = map(three_digits, (over.median, over.q1, over.q3, over.worst))
        as_is = "-" if over.unperturbed is None else three_digits(over.unperturbed)
        cells.append(f"{middle} [{q1} - {q3}], worst {worst}, as it is {as_is}")
    return [*cells, *(three_digits(float(method.row[key])) for _, key in COSTS)]


def main() -> None:
    """Run what is missing, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("data", type=Path, help="the folder with freiburg/")
    parser.add_argument("--out", type=Path, default=Path("results/best"))
    parser.add_argument("--replicates", type=int, default=10)
    parser.add_argument("--logs", default=",".join(LOGS), help="some of: %(default)s")
    parser.add_argument("--without", action="store_true", help="leave out one part after another")
    options = parser.parse_args()
    if options.without:
        without(options)
        return
    table = []
    for log in options.logs.split(","):
        path, folder = options.data / "freiburg" / f"{log}.clf.gz", options.out / log
        run(path, options.replicates, folder, ["loops=position"])
        table.append([log, LOGS[log], *row(folder), *by_relation(path, folder)])
    names = ["", "", *(name for name, _ in (*SHOWN, *COSTS)), *APART]
    head, *body = zip(names, *table, strict=True)  # a column a log
    lines = [
        "# best_2d on the three logs",
        "",
        f"Medians [quartiles] over {options.replicates} replicates (distinct trajectories), the "
        "worst, and the run on the data as they are. *Tuned*: the recipe was chosen on this log; "
        "*held out*: it was not. The wheels' own: local relations that equal odometry to a "
        "millimetre, so that copying it is rewarded.",
        "",
        *("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *body)),
        "",
        "    rbtm-bench "
        + " ".join(words(Path("LOG.clf.gz"), options.replicates, Path("DIR"), ["loops=position"])),
        "",
        f"Recipe: sha256 {hashlib.sha256(RECIPE.read_bytes()).hexdigest()[:12]} of {RECIPE.name}.",
    ]
    write_text(options.out / "best.md", "\n".join(lines) + "\n")
    print("\n".join(lines))


def by_relation(log: Path, folder: Path) -> list[str]:
    """Of the errors of single relations (m), medians over the replicates: the mean of those that
    are not the wheels' own motion, the mean of those that are, and the largest of all."""
    dataset = rb.open_dataset(log)
    assert dataset.relations is not None
    copied = of_wheels(track_of(dataset), dataset.relations)
    rows = []
    for path in sorted(folder.glob("*replicate=*/relations.parquet")):
        if not path.parent.name.endswith("replicate=0"):
            errors = pd.read_parquet(path)["translation_m"].to_numpy()
            rows.append(
                [np.nanmean(errors[~copied]), np.nanmean(errors[copied]), np.nanmax(errors)]
            )
    own, theirs, largest = map(three_digits, np.median(rows, axis=0))
    return [f"{own} ({(~copied).sum()})", f"{theirs} ({copied.sum()})", largest]


def without(options: argparse.Namespace) -> None:
    """The recipe without each of its parts: medians [quartiles] of the mean error (m)."""
    tuned = [log for log in options.logs.split(",") if LOGS[log] == "tuned"]
    lines = [f"| | {' | '.join(tuned)} |", "|" + " --- |" * (1 + len(tuned))]
    for name, changes in WITHOUT.items():
        cells = []
        for log in tuned:
            folder = options.out / f"{log}-{name.replace(' ', '-')}"
            run(options.data / "freiburg" / f"{log}.clf.gz", options.replicates, folder, changes)
            (method,) = methods(stored.find_runs([folder]))
            over = spread(method.runs, MEAN)
            if over is None:
                cells.append("-")
                continue
            middle, q1, q3, worst = map(three_digits, (over.median, over.q1, over.q3, over.worst))
            cells.append(f"{middle} [{q1} - {q3}], worst {worst}")
        lines.append(f"| {name} | {' | '.join(cells)} |")
        write_text(options.out / "without.md", "\n".join(lines) + "\n")
    print("\n".join(lines))


if __name__ == "__main__":
    main()
