"""Does similarity choose the model scan better than chance at the same gap? Strategies between
chance and the truth, on simulated places and on logs.

    python scripts/premise.py                20 seeds, 4 places, 3 logs raw and corrected; an hour
    python scripts/premise.py --quick        3 seeds, the first scans of each log; minutes

Every strategy has four settings to choose from, on seeds that are not shown or on the other logs.
random_gap and random_gap_overlap draw from the gaps of the RBTM beside them: as far back, without
similarity. oracle
registers the whole window and keeps what the truth likes best. Leaves results/premise/README.md
(in words computed from the numbers), table.md, table.csv, against.csv, shares.csv and figures. The
logs are looked for in RBTM_BENCH_DATA or --data (freiburg/ and corrected/); --no-logs leaves them
out. A run that was cut goes on where it was; --fresh starts anew.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.files import make_folder, write_text
from rbtm_bench.core.guarded import guarded
from rbtm_bench.engine import drive
from rbtm_bench.runs.grid import Point
from rbtm_bench.studies.campaign import Campaign, begin
from rbtm_bench.studies.options import DATA, data_folder, make_parser
from rbtm_bench.studies.premise import numbers
from rbtm_bench.studies.premise.figures import draw
from rbtm_bench.studies.premise.numbers import Key, TryOutcome
from rbtm_bench.studies.premise.plan import (
    BACKENDS,
    BOUNDS,
    CHANCE,
    RBTM,
    STRATEGIES,
    Kind,
    Place,
    Try,
    corrected,
    points,
    raw,
    simulated,
    tries,
)
from rbtm_bench.studies.premise.words import PremiseTables, final_lines, readme, table_page

OUT = Path("results/premise")
DRAWS = tuple(range(5))
"""Seeds of random gaps on a log."""


@dataclass(frozen=True)
class PremiseStudy:
    """All tries of all places, by place, backend and strategy."""

    places: dict[str, Place]
    tries: dict[Key, list[Try]]

    def chosen_among(self) -> Iterable[tuple[Key, list[Try]]]:
        """What has something to choose; random gaps take the choice of the RBTM beside them."""
        return (
            (key, group)
            for key, group in self.tries.items()
            if key[2] in STRATEGIES and key[2] not in CHANCE
        )


def make_study(places: Sequence[Place], backends: Sequence[str]) -> PremiseStudy:
    by_key: dict[Key, list[Try]] = {}
    for place in places:
        for one in tries(place, backends):
            by_key.setdefault((place.name, one.backend, one.strategy), []).append(one)
    return PremiseStudy({place.name: place for place in places}, by_key)


def choosing_seeds(kind: Kind) -> tuple[int, ...]:
    return kind.seeds[0] if kind.seeds else ()


def shown_seeds(kind: Kind, strategy: str) -> tuple[int, ...]:
    if kind.seeds:
        return kind.seeds[1]
    return DRAWS if strategy in CHANCE else ()


def first_runs(study: PremiseStudy) -> list[Point]:
    """The runs that settings are chosen by; those on the same data one after the other."""
    keyed = [
        (key[0], seed, point)
        for key, group in study.chosen_among()
        for one in group
        for seed in choosing_seeds(one.place.kind) or (0,)
        for point in points(one, (seed,) if one.place.kind.seeds else ())
    ]
    order = list(study.places)
    keyed.sort(key=lambda item: (order.index(item[0]), item[1]))
    return [point for _, _, point in keyed]


def choose(study: PremiseStudy, folder: Path) -> dict[Key, tuple[Try, int, str]]:
    """Of every place, backend and strategy the chosen try, of how many, and where it was chosen."""
    scores: dict[tuple[str, str, str, int], dict[str, float]] = {}
    for (place, backend, strategy), group in study.chosen_among():
        for one in group:
            of_try = _scores(one, folder)
            scores.setdefault((place, backend, strategy, one.k), {}).update(of_try)
    chosen = {}
    for key, group in study.tries.items():
        place, backend, strategy = key
        if strategy not in STRATEGIES:
            chosen[key] = (group[0], 1, "")
            continue
        kind = group[0].place.kind
        own = CHANCE.get(strategy, strategy)
        others = (
            [place] if kind.seeds else [p.name for p in study.places.values() if p.kind == kind]
        )
        others = others if kind.seeds else [name for name in others if name != place]
        errors = {
            (f"{name} {data}", k): score
            for name in others
            for k in range(len(group))
            for data, score in scores[name, backend, own, k].items()
        }
        k = numbers.choose(errors)
        where = f"seeds {kind.seeds[0][0]}-{kind.seeds[0][-1]}" if kind.seeds else ", ".join(others)
        chosen[key] = (next(one for one in group if one.k == k), len(group), where)
    return chosen


def _scores(one: Try, folder: Path) -> dict[str, float]:
    """The errors of a try on choosing data; NaN where it failed."""
    kind = one.place.kind
    seeds = choosing_seeds(kind)
    runs = numbers.read(folder, [point.name for point in points(one, seeds)])
    errors = numbers.errors(runs, kind, seeds)
    if kind.seeds:
        assert errors is not None
        return {str(seed): float(v) for seed, v in zip(seeds, errors.values, strict=True)}
    return {"": errors.value if errors else float("nan")}


def second_runs(study: PremiseStudy, chosen: dict[Key, tuple[Try, int, str]]) -> list[Point]:
    """The runs that are shown."""
    by_name: dict[str, tuple[str, int, Point]] = {}
    for key, (one, _, _) in chosen.items():
        seeds = shown_seeds(one.place.kind, key[2])
        for seed, point in zip(seeds or (0,), points(one, seeds), strict=True):
            by_name[point.name] = (key[0], seed, point)
    order = list(study.places)
    ordered = sorted(by_name.values(), key=lambda item: (order.index(item[0]), item[1]))
    return [point for _, _, point in ordered]


def outcomes(chosen: dict[Key, tuple[Try, int, str]], folder: Path) -> dict[Key, TryOutcome]:
    by_key = {}
    for key, (one, tried, where) in chosen.items():
        seeds = shown_seeds(one.place.kind, key[2])
        names = [point.name for point in points(one, seeds)]
        runs = numbers.read(folder, names)
        errors = numbers.errors(runs, one.place.kind, seeds)
        by_key[key] = TryOutcome(one, tried, where, runs, len(names), errors)
    return by_key


def study_all(study: PremiseStudy, options: argparse.Namespace, command: str) -> int:
    """Everything in order; the last thing printed is the share of the way to the oracle."""
    started = time.perf_counter()
    folder = options.out / "runs"
    with drive.make_crew(options.jobs) as crew:
        campaign = Campaign(folder, crew)
        campaign.make("choosing settings", first_runs(study))
        chosen = choose(study, folder)
        campaign.make("shown", second_runs(study, chosen))
    results = outcomes(chosen, folder)
    tables = PremiseTables(
        numbers.table(results),
        numbers.against(results),
        numbers.shares(results),
        numbers.shares(results, "oracle_pose"),
        {
            (ours, bound): numbers.pooled_share(results, ours, bound)
            for ours in RBTM
            for bound in BOUNDS
        },
    )
    for name, table in (
        ("table", tables.table), ("against", tables.against), ("shares", tables.all_shares),
    ):  # fmt: skip
        write_text(options.out / f"{name}.csv", table.to_csv(index=False))
    figures = draw(tables, list(study.places.values()), options.out)
    write_text(options.out / "table.md", table_page(tables, command))
    page = readme(tables, study.places, command, figures)
    write_text(options.out / "README.md", page)
    if options.reference:
        write_reference(tables, page, figures, options.reference)
    for file in (options.out / "README.md", options.out / "table.md", *figures):
        print(file)
    spent = (time.perf_counter() - started) / 60
    print(f"{campaign.made} runs made in {spent:.1f} min, {options.jobs} side by side")
    for name, reason in campaign.failed.items():
        print(f"failed: {name}: {reason}", file=sys.stderr)
    print("\n".join(final_lines(tables)))
    return 1 if campaign.failed else 0


def write_reference(
    tables: PremiseTables, page: str, figures: Sequence[Path], folder: Path
) -> None:
    """The page, a table without times, and the pictures, to be committed."""
    make_folder(folder)
    small = tables.table.drop(columns=["ms_per_scan"])
    numeric = small.select_dtypes("float").columns
    small[numeric] = small[numeric].map(lambda value: float(f"{value:.4g}"))
    write_text(folder / "premise.csv", small.to_csv(index=False))
    for file in figures:
        page = page.replace(f"]({file.name})", f"](premise_{file.name})")
        shutil.copyfile(file, folder / f"premise_{file.name}")
    write_text(folder / "premise.md", page)


def make_places(options: argparse.Namespace) -> list[Place]:
    """The data sets of the options. Raises ``DataError`` for missing logs."""
    default = 3 if options.quick else 20
    seeds = default if options.seeds is None else options.seeds
    if not 1 <= seeds <= 100:
        raise ConfigError(f"--seeds {seeds}: expected 1 to 100: later ones choose")
    places = simulated(seeds, min(seeds, 5))
    if options.no_logs:
        return _wanted(places, options.places)
    folder = data_folder(options)
    if folder is None:
        raise DataError(
            f"no logs: set {DATA} to the folder that holds freiburg/ and corrected/, give --data "
            "FOLDER, or leave them out with --no-logs"
        )
    scans = options.max_scans or (600 if options.quick else None)
    places += [*corrected(folder, scans), *raw(folder, scans)]
    return _wanted(places, options.places)


def _wanted(places: list[Place], names: str | None) -> list[Place]:
    wanted = names.split(",") if names else [place.name for place in places]
    known = {place.name: place for place in places}
    for name in wanted:
        if name not in known:
            raise ConfigError(f"--places {name}: no such data here. Known: {', '.join(known)}")
    chosen = [known[name] for name in wanted]
    for place in chosen:
        if not place.kind.seeds and sum(other.kind == place.kind for other in chosen) < 2:
            raise ConfigError(f"--places {names}: {place.name} has no other log to choose by")
    return chosen


def sharing(places: list[Place], folder: Path | None) -> list[Place]:
    """The logs with the registrations of another study (scripts/freiburg_table.py)."""
    if folder is None:
        return places
    word = f"pairs.folder='{folder.resolve()}'"
    return [p if p.kind.seeds else replace(p, words=(*p.words, word)) for p in places]


def command_of(options: argparse.Namespace) -> str:
    """The command that makes the same tables, wherever the data and the results are."""
    words = ["python", "scripts/premise.py"]
    words += ["--quick"] if options.quick else []
    words += ["--no-logs"] if options.no_logs else []
    words += ["--places", options.places] if options.places else []
    words += ["--seeds", str(options.seeds)] if options.seeds else []
    words += ["--backends", options.backends] if options.backends else []
    words += ["--max-scans", str(options.max_scans)] if options.max_scans else []
    return shlex.join(words)


def main(words: Sequence[str] | None = None) -> int:
    parser = make_parser(__doc__, OUT, "premise.md, .csv and pictures")
    parser.add_argument("--quick", action="store_true", help="3 seeds, first 600 scans of each log")
    parser.add_argument("--no-logs", action="store_true", help="simulated places only")
    parser.add_argument("--places", metavar="A,B", help="only these data sets, by name")
    parser.add_argument("--seeds", type=int, help="seeds that are shown")
    parser.add_argument("--max-scans", type=int, metavar="N", help="the first N of each log")
    parser.add_argument(
        "--pairs", type=Path, metavar="FOLDER", help="registrations of logs to share, e.g. "
        "results/freiburg/runs/pairs",
    )  # fmt: skip
    options = parser.parse_args(words)

    def call() -> int:
        backends = options.backends.split(",") if options.backends else BACKENDS
        study = make_study(sharing(make_places(options), options.pairs), backends)
        begin(options.out / "runs", options.fresh)
        return study_all(study, options, command_of(options))

    return guarded(call, options.debug)
