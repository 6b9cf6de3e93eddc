"""Does "better" hold? A placebo, A/A and a positive control for ``rbtm_bench.report.better``.

    python scripts/benchmarks/placebo.py                       # CSAIL and ACES, 10 replicates
    python scripts/benchmarks/placebo.py --logs corridor --settings 3 --replicates 8 --extra 8

Placebo: seven settings that nobody would tell apart (keyframe spacing .44 to .56 m, rbtm threshold
.880 to .910), on replicates whose settings are not moved; at most 2 of 21 pairs may be called
different. A/A: one setting against itself on disjoint draws of its replicates; at most 7 % of 200
pairs. Power: a twin whose registered translations are shrunk until its error is 1.5, 2, 3, 4 times
as large; 80 % at 4 times. Runs are kept in --out and done once; the tables are made from them.
--moved moves the settings of the replicates as compare does: what a user's table calls different.
"""

from __future__ import annotations

import argparse
import itertools
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from placebo_twin import shrink_for, twin_error
from tabulate import tabulate

from rbtm_bench.core.types import Array
from rbtm_bench.engine import sweep_folder
from rbtm_bench.report import better, frame, margin
from rbtm_bench.report.best_settings import main_error
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.margin import Margin
from rbtm_bench.report.replicates import number_of, spread, value_of
from rbtm_bench.report.units import Units
from rbtm_bench.runs import experiment, stored
from rbtm_bench.runs.grid import make_points
from rbtm_bench.runs.stored import Run
from rbtm_bench.runs.workbench import Workbench

SPACINGS = [0.50, 0.44, 0.56, 0.46, 0.48, 0.52, 0.54]
THRESHOLDS = [0.895, 0.880, 0.910, 0.885, 0.890, 0.900, 0.905]
"""The first of either is also run on the extra replicates."""
FACTORS = (1.5, 2.0, 3.0, 4.0)
SIMULATED = 200
MORE = (12, 16, 20, 30, 40, 60)
"""Replicates tried where those there are do not find an error of 4 times."""
STILL = ["perturbation.distances=0", "perturbation.thresholds=0"]
"""Replicates of the data alone, the settings to the last digit."""

Cell = tuple[str, str, str]
"""Log, backend, selector."""


def main() -> None:
    options = arguments()
    out = Path(options.out)
    cells: dict[Cell, list[MethodRuns]] = {}
    started = time.perf_counter()
    for log in options.logs:
        make_runs(log, options, out / log)
        for method in frame.methods(stored.find_runs([out / log])):
            name = (log, str(method.row["backend"]), str(method.row["selector"]))
            cells.setdefault(name, []).append(method)
    print(f"runs: {time.perf_counter() - started:.0f} s", flush=True)
    key = main_key(cells)
    margins = {cell: measured_margin(methods, key) for cell, methods in cells.items()}
    pooled = [r for methods in cells.values() for r in ratios(methods, key)]
    print(f"margin over all cells: {factor_of(pooled):.3g} ({len(pooled)} pairs)\n")
    print_table("placebo: called different", placebo(cells, key, margins))
    print_table("A/A: called different", same(cells, key, options))
    print_table("power: twin found worse", power(cells, key, options))
    print_table("plicp against open3d_p2p, per setting", backends(cells, key))


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    data = os.environ.get("RBTM_BENCH_DATA", "data")
    parser.add_argument("--data", default=f"{data}/freiburg", help="folder of the logs")
    parser.add_argument("--logs", nargs="+", default=["mit-csail", "aces"])
    parser.add_argument("--backends", nargs="+", default=["plicp", "open3d_p2p"])
    parser.add_argument("--selectors", nargs="+", default=["keyframe", "rbtm"])
    parser.add_argument("--settings", type=int, default=7)
    parser.add_argument("--replicates", type=int, default=10)
    parser.add_argument("--extra", type=int, default=10, help="more of the first setting, for A/A")
    parser.add_argument("--scans", type=int, default=None, help="the first so many scans")
    parser.add_argument("--moved", action="store_true", help="move the settings as well")
    parser.add_argument("--out", default="results/placebo")
    return parser.parse_args()


def make_runs(log: str, options: argparse.Namespace, out: Path) -> None:
    """All runs of a log that are not there yet, a copy of the data at a time."""
    words = [f"backend={','.join(options.backends)}", "pictures=false"]
    words += [] if options.moved else STILL
    if log == "corridor":
        words += [f"dataset.scans={options.scans or 61}"]
    else:
        words += ["dataset=carmen", f"dataset.path={options.data}/{log}.clf.gz"]
        words += ["similarity=curvature_circular"]
        words += [f"dataset.relations={options.data}/{log}.relations"]
        words += [f"dataset.max_scans={options.scans or 'null'}"]
    words += [f"selector={','.join(options.selectors)}"]
    first, last = options.replicates, options.replicates + options.extra
    numbers = {
        options.settings: range(first + 1),
        1: range(first + 1, last + 1),  # the first setting alone
    }
    points = {}
    for count, copies in numbers.items():
        asked = [f"replicate={','.join(map(str, copies))}"] if copies else []
        if "keyframe" in options.selectors:
            asked += [f"selector.distance={','.join(map(str, SPACINGS[:count]))}"]
        if "rbtm" in options.selectors:
            asked += [f"selector.threshold={','.join(map(str, THRESHOLDS[:count]))}"]
        made = make_points([*words, *asked])[0] if copies else []
        points |= {f"{count}-{p.name}": p.settings for p in made}
    bench = Workbench()
    for name, settings in points.items():
        if not sweep_folder.is_finished(out / name, settings):
            config = {**settings.config, "overwrite": True}
            experiment.run(replace(settings, config=config), out / name, bench=bench)


def main_key(cells: dict[Cell, list[MethodRuns]]) -> str:
    rows = frame.table_of([method for methods in cells.values() for method in methods])
    error = main_error(rows)
    assert error is not None
    return error[0]


def first_replicates(method: MethodRuns, most: int) -> MethodRuns:
    """The method without the extra replicates."""
    kept = [run for run in method.runs if number_of(run) <= most]
    return MethodRuns(method.row, kept)


def ratios(methods: Sequence[MethodRuns], key: str) -> list[float]:
    """Absolute log ratios of the medians of all pairs."""
    most = common_replicates(methods)
    medians = [
        over.median for m in methods if (over := spread(first_replicates(m, most).runs, key))
    ]
    return [abs(float(np.log(a / b))) for a, b in itertools.combinations(medians, 2)]


def common_replicates(methods: Sequence[MethodRuns]) -> int:
    return min(max(map(number_of, method.runs)) for method in methods)


def factor_of(log_ratios: Sequence[float]) -> float:
    return float(np.exp(np.quantile(log_ratios, margin.QUANTILE))) if len(log_ratios) else 1.0


def measured_margin(methods: Sequence[MethodRuns], key: str) -> Margin:
    """The cell's own margin, as ``margin_of`` has it of a table."""
    return Margin(factor_of(ratios(methods, key)), "this cell")


def placebo(
    cells: dict[Cell, list[MethodRuns]], key: str, margins: dict[Cell, Margin]
) -> list[dict[str, object]]:
    """Pairs called different: as one run's cluster interval has it (the way before replicates), by
    p alone, and by the rule under the default margin, under the largest of the other cells, and
    under the cell's own (measured on these very pairs: 5 % of them lie beyond by definition)."""
    rows = []
    for cell, methods in cells.items():
        most = common_replicates(methods)
        short = [first_replicates(method, most) for method in methods]
        others = [m.factor for other, m in margins.items() if other != cell]
        elsewhere = Margin(max(others, default=margin.DEFAULT.factor), "the other cells")
        pairs = list(itertools.combinations(short, 2))
        counts = {
            name: called(pairs, key, by)
            for name, by in (
                ("default", margin.DEFAULT),
                ("others' margin", elsewhere),
                ("own", margins[cell]),
            )
        }
        alone = [better.compare(a, b, key, margin.DEFAULT) for a, b in pairs]
        p = [one.p_holm for one in better.adjusted([one for one in alone if one])]
        rows.append(
            {
                "cell": " ".join(cell),
                "pairs": len(pairs),
                "one run, clusters": sum(by_clusters(a, b, key) for a, b in pairs),
                "p alone": sum(q is not None and q < better.SIGNIFICANT for q in p),
                **counts,
                "margin": margins[cell].factor,
                "medians": " ".join(
                    f"{over.median:.3g}"
                    for m in sorted(short, key=knob)
                    if (over := spread(m.runs, key))
                ),
            }
        )
    return rows


def knob(method: MethodRuns) -> float:
    selector = method.runs[0].section("selector")
    return float(selector.get("distance", selector.get("threshold", 0.0)))


def called(pairs: Sequence[tuple[MethodRuns, MethodRuns]], key: str, by: Margin) -> int:
    """Pairs that the rule calls different, adjusted for all of them."""
    made = [better.compare(a, b, key, by) for a, b in pairs]
    return sum(bool(one.holds) for one in better.adjusted([one for one in made if one]))


def by_clusters(a: MethodRuns, b: MethodRuns, key: str) -> bool:
    """Whether the cluster interval of two unperturbed runs excludes 0."""
    plain = [MethodRuns(m.row, [r for r in m.runs if number_of(r) == 0]) for m in (a, b)]
    difference = Units(plain[0]).minus(Units(plain[1]), key)
    return difference is not None and difference.interval.excludes(0.0)


def same(
    cells: dict[Cell, list[MethodRuns]], key: str, options: argparse.Namespace
) -> list[dict[str, object]]:
    """One method on disjoint draws of its replicates, 200 times."""
    rows = []
    for cell, methods in cells.items():
        values = replicates_of(first_of(methods), key)[1]
        n = min(options.replicates, len(values) // 2)
        rng = np.random.default_rng(0)
        drawn = [rng.permutation(len(values))[: 2 * n].reshape(2, n) for _ in range(SIMULATED)]
        made = [compared(values[i], values[j]) for i, j in drawn]
        p = np.mean([one.p is not None and one.p < better.SIGNIFICANT for one in made])
        rule = np.mean([bool(one.holds) for one in made])
        rows.append(
            {
                "cell": " ".join(cell),
                "n": n,
                "p alone": f"{p:.1%}",
                "rule": f"{rule:.1%}",
                "quartiles": "{:.3g} - {:.3g}".format(*np.quantile(values, [0.25, 0.75])),
            }
        )
    return rows


def first_of(methods: Sequence[MethodRuns]) -> MethodRuns:
    """The setting with the extra replicates."""
    return max(methods, key=lambda method: len(method.runs))


def replicates_of(method: MethodRuns, key: str) -> tuple[list[Run], Array]:
    """The method's replicates and their errors."""
    runs = [run for run in method.runs if number_of(run) and value_of(run, key) is not None]
    return runs, np.array([value_of(run, key) for run in runs])


def compared(ours: Array, theirs: Array) -> better.Comparison:
    """Two sets of values, each of a trajectory of its own, as the only comparison."""
    one = better.Comparison(
        np.stack([ours, theirs]),
        better.REPLICATES,
        margin.DEFAULT,
        len(ours),
        False,
        (False, False),
        better.exact_p(ours, theirs),
    )
    return better.adjusted([one])[0]


def power(
    cells: dict[Cell, list[MethodRuns]], key: str, options: argparse.Namespace
) -> list[dict[str, object]]:
    """Shares of 200 experiments that find the twin worse: on the same draws, and on other ones."""
    rows = []
    for cell, methods in cells.items():
        runs, values = replicates_of(first_of(methods), key)
        error_of = [twin_error(run, key) for run in runs]
        n = min(options.replicates, len(values) // 2)
        row: dict[str, object] = {"cell": " ".join(cell), "n": n}
        for factor in FACTORS:
            shrunk = shrink_for(factor, error_of, values)
            twin = np.array([error(shrunk) for error in error_of])
            paired, apart = (found(twin, values, n, other) for other in (False, True))
            reached = float(np.median(twin) / np.median(values))
            wide = "" if abs(reached / factor - 1) < 0.05 else f" (at {reached:.2g})"
            row[f"{factor:g}x"] = f"{paired:.0%} / {apart:.0%}{wide}"
            if factor == FACTORS[-1]:
                row["N for 80%"] = enough(twin, values, n, min(paired, apart))
        rows.append(row)
    return rows


def found(twin: Array, values: Array, n: int, other_draws: bool, again: bool = False) -> float:
    """The share of experiments with n replicates in which the twin is called worse; with ``again``
    replicates are drawn with replacement, where there are not enough."""
    rng = np.random.default_rng(1)
    hits = 0
    for _ in range(SIMULATED):
        if again:
            i, j = rng.integers(len(values), size=(2, n))
        else:
            order = rng.permutation(len(values))
            i, j = order[:n], order[n : 2 * n]
        hits += compared(twin[i], values[j if other_draws else i]).holds == "worse"
    return hits / SIMULATED


def enough(twin: Array, values: Array, n: int, reached: float) -> str:
    if reached >= 0.8:
        return str(n)
    for more in MORE:
        if more > n and found(twin, values, more, True, again=True) >= 0.8:
            return str(more)
    return f"> {MORE[-1]}"


def backends(cells: dict[Cell, list[MethodRuns]], key: str) -> list[dict[str, object]]:
    """The positive control between methods: the two backends at every setting."""
    rows = []
    for (log, backend, selector), methods in cells.items():
        others = cells.get((log, "open3d_p2p", selector), [])
        if backend != "plicp" or not others:
            continue
        pairs = [(a, b) for a in methods for b in others if knob(a) == knob(b)]
        made = [better.compare(a, b, key, margin.DEFAULT) for a, b in pairs]
        of_cell = better.adjusted([one for one in made if one])
        times = [f"{one.theirs / one.ours:.3g}" for one in of_cell]
        words = [one.holds for one in of_cell]
        rows.append(
            {
                "log": log,
                "selector": selector,
                "settings": len(of_cell),
                "plicp better": words.count("better"),
                "worse": words.count("worse"),
                "p2p / plicp": " ".join(times),
            }
        )
    return rows


def print_table(title: str, rows: list[dict[str, object]]) -> None:
    print(f"{title}\n{tabulate(rows, headers='keys', floatfmt='.3g')}\n", flush=True)


if __name__ == "__main__":
    main()
