"""The pages of scripts/premise.py: tables, and plain words computed from the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tabulate import tabulate

from rbtm_bench.engine.sweep_folder import versions
from rbtm_bench.report.intervals import FEWEST_UNITS, Interval
from rbtm_bench.studies.premise.plan import BOUNDS, NOTHING, RBTM, STRATEGIES, Place

CONTROL_STRATEGIES = (NOTHING, "previous", "keyframe", "fixed_gap", "random_gap", "best")


@dataclass(frozen=True, eq=False)
class PremiseTables:
    """The tables of ``premise_numbers``; shares to the oracle by registration, and by pose."""

    table: pd.DataFrame
    against: pd.DataFrame
    shares: pd.DataFrame
    pose_shares: pd.DataFrame
    pooled: Mapping[tuple[str, str], Interval]
    """By method and bound, over all simulated places and backends."""

    @property
    def all_shares(self) -> pd.DataFrame:
        return pd.concat([self.shares, self.pose_shares], ignore_index=True)


def number(value: float) -> str:
    """Three digits; nothing for NaN."""
    if value != value:
        return ""
    return f"{value:.0f}" if abs(value) >= 99.95 else f"{float(f'{value:.3g}'):g}"


def markdown(rows: Sequence[Sequence[str]], headers: Sequence[str]) -> str:
    return tabulate(rows, headers, tablefmt="pipe", disable_numparse=True)


def wide(tables: PremiseTables, place: str) -> str:
    """A place's table: a row a strategy, a column a backend, with what was chosen."""
    of_place = tables.table[tables.table["place"] == place]
    backends = [b for b in dict.fromkeys(of_place["backend"]) if b != NOTHING]
    cells = {(r["backend"], r["strategy"]): r for _, r in of_place.iterrows()}
    holds = {
        (r["backend"], r["strategy"]): r["holds"]
        for _, r in tables.against[tables.against["place"] == place].iterrows()
    }
    rows = []
    for strategy in (NOTHING, *STRATEGIES, *BOUNDS):
        row = [strategy]
        for backend in backends:
            own = NOTHING if strategy == NOTHING else backend
            cell = cells.get((own, strategy))
            row.append("" if cell is None else _cell(cell, holds.get((backend, strategy), "")))
        if any(row[1:]):
            rows.append(row)
    unit = of_place["unit"].iloc[0]
    return markdown(rows, ["strategy", *(f"{backend} ({unit})" for backend in backends)])


SIGN = {"better": " (rbtm better)", "worse": " (rbtm worse)", "": ""}


def _cell(row: pd.Series, holds: str) -> str:
    """ "12 [9, 15], threshold=0.6"; in brackets what holds of rbtm against it."""
    text = number(row["error"])
    if row["low"] == row["low"]:
        text += f" [{number(row['low'])}, {number(row['high'])}]"
    if row["failed"]:
        text += f", {row['failed']:.0f} failed"
    knob, _, value = str(row["setting"]).partition("=")
    setting = f"{knob.rpartition('.')[2].removeprefix('max_correspondence_')} {value}"
    setting = "" if row["strategy"] in (*BOUNDS, NOTHING) else f", {setting}"
    return text + setting + SIGN[holds]


def counts(tables: PremiseTables, names: Sequence[str], strategy: str) -> tuple[int, int, int]:
    """On how many places and backends rbtm is better, worse, and neither."""
    rows = tables.against
    rows = rows[rows["place"].isin(list(names)) & (rows["strategy"] == strategy)]
    better, worse = ((rows["holds"] == word).sum() for word in ("better", "worse"))
    return int(better), int(worse), len(rows) - int(better) - int(worse)


def verdicts(tables: PremiseTables, places: Mapping[str, Place]) -> list[str]:
    """A line a kind of data and control."""
    lines = []
    for kind in dict.fromkeys(place.kind.name for place in places.values()):
        group = [place for place in places.values() if place.kind.name == kind]
        names = [place.name for place in group]
        parts = []
        for strategy in (*CONTROL_STRATEGIES, *RBTM[1:]):
            better, worse, neither = counts(tables, names, strategy)
            if better + worse + neither:
                parts.append(f"{strategy} {better} / {worse} / {neither}")
        lines.append(f"- {group[0].kind.title}: {'; '.join(parts)}.")
    return lines


def relative_table(tables: PremiseTables, places: Mapping[str, Place]) -> str:
    """Errors over those of the previous scan: a row a strategy, a column a kind of data, geometric
    means over its places and backends."""
    errors = tables.table[tables.table["backend"] != NOTHING].pivot_table(
        index=["place", "backend"], columns="strategy", values="error"
    )
    ratios = errors.div(errors["previous"], axis=0)
    kinds = ratios.index.get_level_values("place").map(lambda name: places[name].kind.title)
    means = np.exp(np.log(ratios).groupby(kinds).mean())
    titles = list(dict.fromkeys(place.kind.title for place in places.values()))
    rows = [
        [name, *(number(means.loc[title, name]) for title in titles)]
        for name in (*STRATEGIES, *BOUNDS)
        if name in means
    ]
    return markdown(rows, ["strategy", *titles])


def share_table(tables: PremiseTables, bound: str, places: Mapping[str, Place]) -> str:
    """A row a place and method; then those of all simulated places together."""
    shares = tables.all_shares[tables.all_shares["bound"] == bound]
    backends = list(dict.fromkeys(shares["backend"]))
    rows = []
    for (place, strategy), group in shares.groupby(["place", "strategy"], sort=False):
        cells = {str(r["backend"]): _share(r) for _, r in group.iterrows()}
        rows.append(
            [places[str(place)].title, str(strategy), *(cells.get(b, "") for b in backends)]
        )
    for (strategy, name), over in tables.pooled.items():
        if name == bound and over.n:
            text = _share({"share": over.value, "low": over.low, "high": over.high, "n": over.n})
            empty = [""] * (len(backends) - 1)
            rows.append(["all simulated, of logarithms", strategy, f"{text} all backends", *empty])
    return markdown(rows, ["data", "method", *backends])


def _share(row: Any) -> str:
    if row["n"] < FEWEST_UNITS:
        return "too few"
    if row["share"] != row["share"]:
        return "no way to cover"
    if row["low"] is None:
        return f"{row['share']:.2f}"
    return f"{row['share']:.2f} [{row['low']:.2f}, {row['high']:.2f}]"


def share_words(shares: pd.DataFrame, ours: str = "rbtm") -> str:
    """How many intervals lie above 0, below 0, or hold it."""
    rows = shares[(shares["strategy"] == ours) & (shares["n"] >= FEWEST_UNITS)]
    known = rows[rows["share"].notna()]
    above, below = int((known["low"] > 0).sum()), int((known["high"] < 0).sum())
    return (
        f"of {len(rows)} pairs of data and backend {len(rows) - len(known)} leave no way to cover "
        f"(the bound is not surely better than a random gap); of the other {len(known)} {ours} is "
        f"above chance in {above}, below it in {below}, and neither in {len(known) - above - below}"
    )


def why(tables: PremiseTables, places: Mapping[str, Place]) -> list[str]:
    """What the gaps and the fallbacks say of where RBTM stands, a line a place."""
    lines = []
    for name, place in places.items():
        rows = tables.table[tables.table["place"] == name]
        ours = rows[rows["strategy"] == "rbtm"].set_index("backend")
        if ours.empty:
            continue
        gaps = ours["mean_gap"]
        words = [f"mean gap {number(gaps.min())} to {number(gaps.max())} scans"]
        scans = _scans(place)
        if scans:
            share = ours["fallbacks"] / scans
            words.append(
                f"fell back on {100 * share.min():.0f} to {100 * share.max():.0f}% of them"
            )
        winners = []
        for backend in ours.index:
            own = rows[(rows["backend"] == backend) & rows["strategy"].isin(STRATEGIES)]
            if own["error"].notna().any():
                winners.append(f"{own.loc[own['error'].idxmin(), 'strategy']} ({backend})")
        words.append(f"least error: {', '.join(winners)}")
        lines.append(f"- {place.title}: RBTM's {'; '.join(words)}.")
    return lines


def _scans(place: Place) -> int | None:
    word = next((w for w in place.words if w.startswith("dataset.scans=")), None)
    return int(word.partition("=")[2]) - 1 if word else None


def final_lines(tables: PremiseTables) -> list[str]:
    """The end of what is printed."""
    lines = ["share of the way from a random gap (rbtm's own gaps) to the oracle, rbtm:"]
    rows = tables.shares[tables.shares["strategy"] == "rbtm"]
    for _, row in rows.iterrows():
        lines.append(f"  {row['place']:16} {row['backend']:15} {_share(row)}")
    for (strategy, bound), over in tables.pooled.items():
        if bound == "oracle" and over.n:
            text = _share({"share": over.value, "low": over.low, "high": over.high, "n": over.n})
            lines.append(f"  all simulated places and backends, of logarithms, {strategy}: {text}")
    return [*lines, share_words(tables.shares)]


def table_page(tables: PremiseTables, command: str) -> str:
    """All numbers as Markdown."""
    rows = []
    for _, r in tables.table.iterrows():
        rows.append(
            [
                r["data"], r["backend"], r["strategy"], r["setting"], str(r["tried"]),
                r["chosen_on"], f"{number(r['error'])} {r['unit']}",
                f"{number(r['low'])} to {number(r['high'])}" if r["low"] == r["low"] else "",
                str(r["n"]), str(r["failed"]), number(r["mean_gap"]), number(r["rejected"]),
            ]
        )  # fmt: skip
    headers = ["data", "backend", "strategy", "setting", "tried", "chosen on", "error"]
    headers += ["95% interval", "n", "failed", "mean gap", "rejected"]
    return f"# All rows\n\nMade by `{command}`.\n\n{markdown(rows, headers)}\n"


CAVEATS = (
    "Errors: final position (mm), median over seeds, on simulated places; on keyframes the "
    "translation error (m) over the next 10 m of the true way, mean; on raw logs that of the "
    "reference relations (m), mean. Brackets: 95 % bootstrap intervals over seeds, or over "
    "clusters of place and time. On logs nothing is tested: of twenty such intervals one "
    "misses by chance, and those of keyframes are somewhat short, as segments of 10 m cross "
    "the borders of their blocks of 20 m. Raw logs have no true pose a scan, so no bound. On "
    "keyframes the similarity searches turns of 30 deg, a setting that was chosen on these "
    "very logs before (docs/similarity.md): that favours RBTM. In `bare` the similarity is "
    "undefined everywhere (two straight walls), so RBTM always falls back to the scan before."
)


def readme(
    tables: PremiseTables, places: Mapping[str, Place], command: str, figures: Sequence[Path]
) -> str:
    """The page."""
    parts = [
        "# Does similarity choose the model scan better than chance at the same gap?",
        f"Made by `{command}`. Every strategy had four settings to choose from: on seeds that are "
        "not shown, or, for logs, on the other two logs. The guess is odometry for all. "
        "`random_gap` and `random_gap_overlap` draw their gaps from `rbtm` and `rbtm_overlap`: as "
        "far back, without similarity. `oracle` registers the whole "
        "window and keeps the registration nearest to the truth, `oracle_pose` the one whose pose "
        "ends nearest: bounds, no methods. `none` is the guess alone. `rbtm` reads the circular "
        "curvature, `rbtm_overlap` the overlap of the two scans under the guess; `rbtm_verified` "
        "adds `check=gated`.",
        *_in_short(tables, places),
        "## Where RBTM stands, and why",
        "\n".join(why(tables, places)),
        "What the gap alone does: a longer gap means fewer registrations in a chain, whatever "
        "chose it. Compare `rbtm` with `random_gap` for what similarity adds to that, and with "
        "`fixed_gap` and `keyframe` for what it costs nothing to know.",
        *_shares_of_the_way(tables, places),
    ]
    for name, place in places.items():
        parts += [f"## {place.title}", wide(tables, name)]
    parts += [
        "## What to know",
        CAVEATS,
        "## Pictures",
        "\n\n".join(f"![{file.stem}]({file.name})" for file in figures),
        "Made with " + ", ".join(f"{name} {v}" for name, v in versions().items() if v) + ".",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _in_short(tables: PremiseTables, places: Mapping[str, Place]) -> list[str]:
    return [
        "## In short",
        f"- Between chance and truth (oracle): {share_words(tables.shares)}."
        if len(tables.shares)
        else "- No data with a true pose for every scan: no bound.",
        "- The same for RBTM with the overlap under the guess, and its own gaps: "
        f"{share_words(tables.shares, 'rbtm_overlap')}."
        if len(tables.shares)
        else "",
        "- RBTM against each other strategy, in how many pairs of data and backend it is surely "
        "better / surely worse / neither (paired intervals; over seeds also the signed-rank test, "
        "Holm):",
        "\n".join("  " + line for line in verdicts(tables, places)),
        "- Errors over those of matching to the previous scan, geometric means over places and "
        "backends:",
        relative_table(tables, places),
    ]


def _shares_of_the_way(tables: PremiseTables, places: Mapping[str, Place]) -> list[str]:
    if not len(tables.shares):
        return []
    return [
        "## The share of the way from a random gap to the oracle",
        "(random gap - method) / (random gap - oracle), the method's own gaps in random order "
        "(for `rbtm_verified` those of `rbtm`), of medians over seeds or means over a log "
        "[95 % bootstrap interval over seeds or place-time clusters]. 0 is chance, 1 the "
        "oracle, below 0 worse than chance.",
        share_table(tables, "oracle", places),
        "The same to `oracle_pose`:",
        share_table(tables, "oracle_pose", places),
    ]
