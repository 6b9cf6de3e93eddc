"""How well each similarity tells the registrations that will succeed: areas under the ROC curve on
every log and simulated place, at all gaps and at equal gaps, and what a pair costs.

    python scripts/premise_areas.py              all data; a quarter of an hour on two cores
    python scripts/premise_areas.py --no-logs    simulated places only

Runs `rbtm-bench calibrate` on each (its page and figures stay in results/premise/calibrate) and
leaves results/premise/areas.md and areas.csv. Data sets that are there already stay; --fresh
starts anew. The logs are looked for in RBTM_BENCH_DATA or --data.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from rbtm_bench.core.errors import DataError, RbtmBenchError
from rbtm_bench.core.files import make_folder, write_text
from rbtm_bench.core.guarded import guarded
from rbtm_bench.engine.sweep_folder import versions
from rbtm_bench.studies.freiburg.plan import LOGS, find_logs
from rbtm_bench.studies.options import DATA, data_folder, make_parser
from rbtm_bench.studies.own_command import rbtm_bench
from rbtm_bench.studies.premise.plan import BACKENDS, SPACING, corrected_log, corridor_words
from rbtm_bench.studies.premise.words import markdown

OUT = Path("results/premise")
SIMILARITIES = (
    "curvature", "curvature_circular", "range_correlation", "overlap", "mutual_neighbours",
)  # fmt: skip
BESIDE = "gap"
"""What a similarity has to beat."""
CORRECTED = {
    "aces": "ACES", "intel": "Intel", "csail": "MIT CSAIL", "freiburg-101": "Freiburg 101",
    "orebro": "Orebro",
}  # fmt: skip
MOST = {"all gaps": "at all gaps", "equal gap": "at equal gaps"}


def data_sets(folder: Path | None) -> dict[str, tuple[str, list[str]]]:
    """Title and overrides of every data set, by name. Raises ``DataError`` for missing logs."""
    sets: dict[str, tuple[str, list[str]]] = {}
    for name in SPACING:
        words = ["dataset=corridor", *corridor_words(name), "seed=0,1,2", "guess=odometry"]
        sets[name] = (f"simulated: {name}", [*words, "--within", "0.01,0.5"])
    if folder is None:
        return sets
    for name, (log, relations) in find_logs(folder).items():
        words = [f"dataset.path='{log}'", f"dataset.relations='{relations}'"]
        sets[name] = (f"{LOGS[name]}, raw", ["dataset=carmen", *words])
    for name, title in CORRECTED.items():
        words = ["dataset=carmen", f"dataset.path='{corrected_log(folder, name)}'"]
        sets[f"{name}-corrected"] = (f"{title}, keyframes", words)
    return sets


def calibrated(folder: Path, words: list[str], options: argparse.Namespace) -> pd.DataFrame:
    """The areas of a data set; complete ones stay. Raises ``DataError`` if it failed."""
    if options.fresh or not _is_complete(folder, options.backends):
        asked = ["calibrate", f"similarity={','.join(SIMILARITIES)}", *words]
        asked += [f"backend={options.backends}", "overwrite=true"]
        asked += ["--out", str(folder), "--jobs", str(options.jobs)]
        code = rbtm_bench(asked, quiet=True)
        if code:
            raise DataError(f"rbtm-bench {' '.join(asked)}: exit code {code}")
    areas = pd.read_csv(folder / "roc.csv")
    return areas[(areas["pairs"] == "gap") & (areas["part"] == "all")]


def _is_complete(folder: Path, backends: str) -> bool:
    """Whether the folder holds the areas of these backends and of all similarities."""
    if not (folder / "roc.csv").is_file():
        return False
    areas = pd.read_csv(folder / "roc.csv")
    whole = set(SIMILARITIES) <= set(areas["predictor"])
    return whole and set(areas["backend"]) == set(backends.split(","))


def knees(folder: Path) -> pd.DataFrame:
    """The curves of a data set, a row a backend and similarity, NaN without a knee."""
    return pd.read_csv(folder / "summary.csv")[["backend", "similarity", "knee"]]


def knee_words(table: pd.DataFrame) -> str:
    """How many curves have a knee, and where."""
    with_knee = table[table["knee"].notna()]
    where = [
        f"{r['data']}, {r['backend']}, {r['similarity']}: S = {r['knee']:.2f}"
        for _, r in with_knee.iterrows()
    ]
    listed = f" ({'; '.join(where)})" if where else ""
    return (
        f"An abrupt change of the error, the paper's knee, is found on {len(with_knee)} of "
        f"{len(table)} curves, a curve a data set, backend and similarity{listed}."
    )


def area_table(table: pd.DataFrame, compared: str) -> str:
    """A row a data set and backend, a column a similarity."""
    chosen = table[table["compared"] == compared]
    rows = []
    for (title, backend), group in chosen.groupby(["data", "backend"], sort=False):
        areas = group.set_index("predictor")
        cells = [_area(areas.loc[name]) if name in areas.index else "" for name in _columns(chosen)]
        counts = group.iloc[0]
        both = f"{counts['successes']:.0f} / {counts['failures']:.0f}"
        rows.append([str(title), str(backend), both, *cells])
    return markdown(rows, ["data", "backend", "succeed / fail", *_columns(chosen)])


def _columns(table: pd.DataFrame) -> list[str]:
    return [n for n in (*SIMILARITIES, BESIDE) if n in set(table["predictor"])]


def _area(row: pd.Series[Any]) -> str:
    if row["auc"] != row["auc"]:
        return ""
    text = f"{row['auc']:.2f}"
    if row["auc_low"] == row["auc_low"]:
        text += f" [{row['auc_low']:.2f}, {row['auc_high']:.2f}]"
    return text


def count_table(table: pd.DataFrame) -> str:
    """For every similarity, over data and backends: how often its area is surely above one half,
    surely below, and surely above the gap's; and the median cost of a pair."""
    rows = []
    for name in SIMILARITIES:
        own = table[table["predictor"] == name]
        row = [name]
        for compared in MOST:
            part = own[(own["compared"] == compared) & own["auc_low"].notna()]
            above, below = int((part["auc_low"] > 0.5).sum()), int((part["auc_high"] < 0.5).sum())
            row.append(f"{above} / {below} of {len(part)}")
        part = own[(own["compared"] == "all gaps") & own["minus_gap_low"].notna()]
        more, less = int((part["minus_gap_low"] > 0).sum()), int((part["minus_gap_high"] < 0).sum())
        row.append(f"{more} / {less} of {len(part)}")
        row += [f"{own[key].median():.3g}" for key in ("score_us", "describe_us")]
        rows.append(row)
    headers = ["similarity", "above / below chance, all gaps", "the same at equal gaps"]
    headers += ["better / worse than the gap itself", "a pair (us)", "a scan (us)"]
    return markdown(rows, headers)


def page(table: pd.DataFrame, knee: str, left_out: Sequence[str]) -> str:
    parts = [
        "# Which similarity tells the registrations that will succeed?",
        "Made by `python scripts/premise_areas.py`: areas under the ROC curve (0.5 is chance) with "
        "95 % intervals from resampled blocks. A registration succeeds within 10 mm and 0.5 deg of "
        "the truth on simulated places, within 0.1 m and 2 deg on logs. At equal gaps only pairs "
        "of the same gap are compared, so that similarity is not the gap in disguise. What is "
        "undefined counts as the lowest score. docs/calibration.md has the rules.",
        "## In short",
        count_table(table),
        knee,
        *(part for c, t in MOST.items() for part in (f"## Areas {t}", area_table(table, c))),
    ]
    parts += [f"Left out: {'; '.join(left_out)}."] if left_out else []
    parts += ["Made with " + ", ".join(f"{name} {v}" for name, v in versions().items() if v) + "."]
    return "\n\n".join(parts) + "\n"


def study(sets: dict[str, tuple[str, list[str]]], options: argparse.Namespace) -> int:
    """Every data set in turn; the last thing printed is the table in short."""
    tables, curves, left_out = [], [], []
    for name, (title, words) in sets.items():
        print(title, flush=True)
        try:
            areas = calibrated(options.out / "calibrate" / name, words, options)
        except RbtmBenchError as error:
            left_out.append(f"{title} ({error})")
            print(f"failed: {error}", file=sys.stderr)
            continue
        tables.append(areas.assign(data=title))
        curves.append(knees(options.out / "calibrate" / name).assign(data=title))
    if not tables:
        raise DataError("no data set could be calibrated")
    table = pd.concat(tables, ignore_index=True)
    write_text(options.out / "areas.csv", table.to_csv(index=False))
    knee = knee_words(pd.concat(curves, ignore_index=True))
    text = page(table, knee, left_out)
    write_text(options.out / "areas.md", text)
    if options.reference:
        make_folder(options.reference)
        write_text(options.reference / "premise_areas.md", text)
    print(options.out / "areas.md")
    print(knee)
    print(count_table(table))
    return 1 if left_out else 0


def main(words: Sequence[str] | None = None) -> int:
    parser = make_parser(__doc__, OUT, "premise_areas.md")
    parser.add_argument("--no-logs", action="store_true", help="simulated places only")
    parser.add_argument("--only", metavar="A,B", help="only these data sets, by name")
    parser.set_defaults(backends=",".join(BACKENDS))
    options = parser.parse_args(words)

    def call() -> int:
        folder = data_folder(options)
        if folder is None and not options.no_logs:
            raise DataError(f"no logs: set {DATA}, give --data FOLDER, or --no-logs")
        sets = data_sets(None if options.no_logs else folder)
        wanted = options.only.split(",") if options.only else list(sets)
        for name in wanted:
            if name not in sets:
                raise DataError(f"--only {name}: no such data here. Known: {', '.join(sets)}")
        return study({name: sets[name] for name in wanted}, options)

    return guarded(call, options.debug)
