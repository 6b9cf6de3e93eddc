"""The best setting of every method, of how many, and the notes beside it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.columns import MAIN
from rbtm_bench.report.frame import METHOD
from rbtm_bench.report.render import WINNER, is_empty

if TYPE_CHECKING:
    import pandas as pd

ERRORS = tuple((column.name, column.unit, column.title) for column in MAIN)
"""What methods are compared by: the first of these that the runs on a data set have."""

BEST = (*METHOD, "control", "seeds", "replicates", "status", "coverage")
"""The columns of the table of best settings, before the errors, ms_per_scan and tried."""

NO_METHODS = ("oracle", "shifted_gap")
"""Selectors that win nothing: what sees the truth is a bound, rotations are a test."""

MOST_LISTED = 4
"""Names or sentences of a kind at most, so that a screen holds all."""

SECOND = {column.name: column.beside for column in MAIN}
"""What stands beside an error in the table of best settings: the first of these that it has."""


def main_error(table: pd.DataFrame) -> tuple[str, str, str] | None:
    """Key, unit and name of the first of ``ERRORS`` that a row has."""
    return next((e for e in ERRORS if e[0] in table and table[e[0]].notna().any()), None)


def main_errors(table: pd.DataFrame) -> list[str]:
    """The keys of the main errors of its data sets."""
    errors = (main_error(rows) for _, rows in table.groupby("data", sort=False, dropna=False))
    return list(dict.fromkeys(error[0] for error in errors if error))


def champion(rows: pd.DataFrame, key: str) -> pd.Series[Any] | None:
    """The ``winner`` over all rows of a data set but ``NO_METHODS``; of equal ones one without a
    threshold, which did it for less."""
    rows = rows[~rows["selector"].isin(NO_METHODS)]
    won = winner(rows, key)
    if won is None or "threshold" not in rows:
        return won
    plain = rows[(rows[key] == won[key]) & rows["threshold"].isna()]
    simpler = winner(plain, key)
    return won if simpler is None or simpler["status"] != won["status"] else simpler


def ranked(table: pd.DataFrame) -> pd.DataFrame:
    """The rows of every data set by their main error, the ``champion`` first and marked in
    ``render.WINNER``; those without a number last. Controls that were added have a plus there. A
    table that is marked stays as it is."""
    import pandas as pd

    if WINNER in table:
        return table
    parts = []
    for _, rows in table.groupby("data", sort=False, dropna=False):
        error = main_error(rows)
        won = None if error is None else champion(rows, error[0])
        if error is not None:
            known = rows[error[0]].astype(float)
            rows = rows.loc[known.sort_values(kind="stable", na_position="last").index]
        if won is not None:
            rows = rows.loc[[won.name, *(i for i in rows.index if i != won.name)]]
        marks = ["*" if won is not None and i == won.name else "" for i in rows.index]
        added = rows["control"].notna() if "control" in rows else [False] * len(rows)
        marks = [mark + "+" * bool(control) for mark, control in zip(marks, added, strict=True)]
        parts.append(rows.assign(**{WINNER: marks}))
    return pd.concat(parts)[[WINNER, *table]] if parts else table


def best(table: pd.DataFrame) -> pd.DataFrame:
    """The best setting of every data set, backend and selector, within a backend by error.

    ``table`` has a row a method (medians over seeds). ``tried`` counts the settings that a row is
    the best of: all that were allowed, failed ones too; ``equal`` those with the very same error,
    of which the one with the smallest window, then threshold, stands for all. Where none has an
    error, none is the best: the row names no setting.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for _, on_data in table.groupby("data", sort=False, dropna=False):
        error = main_error(on_data)
        for _, methods in on_data.groupby("backend", sort=False, dropna=False):
            groups = [g for _, g in methods.groupby("selector", sort=False, dropna=False)]
            chosen = [_best_of(group, error[0] if error else None) for group in groups]
            if error:
                chosen.sort(key=lambda r: math.inf if is_empty(r[error[0]]) else r[error[0]])
            rows += chosen
    return pd.DataFrame(rows)


def _best_of(settings: pd.DataFrame, key: str | None) -> dict[str, Any]:
    """The winner of one selector's settings, and their number."""
    tried = len(settings)
    won = winner(settings, key) if key else None
    if won is not None or tried == 1:
        row = (settings.iloc[0] if won is None else won).to_dict()
        equal = 1 if won is None else int((settings[key] == won[key]).sum())
        return {**row, "tried": tried, "equal": equal}
    row = dict.fromkeys(settings)
    row.update({k: settings[k].iloc[0] for k in ("dataset", "data", "backend", "selector")})
    statuses = set(settings["status"])
    row["status"] = statuses.pop() if len(statuses) == 1 else "failed"
    return {**row, "tried": tried, "equal": 1}


def winner(rows: pd.DataFrame, key: str) -> pd.Series[Any] | None:
    """The row with the smallest error, None if none has one. A setting of which a run failed
    wins only where that holds for all: its median is over fewer seeds."""
    known = rows.dropna(subset=[key])
    whole = known[known["status"] == "done"]
    known = known if whole.empty else whole
    if known.empty:
        return None
    order = [key, *(name for name in ("window", "threshold") if name in known)]
    return known.loc[known[order].astype(float).sort_values(order, kind="stable").index[0]]


def best_columns(table: pd.DataFrame) -> tuple[list[str], list[str]]:
    """The columns to show of a table of best settings; of these the main errors."""
    main: dict[str, None] = {}
    second: dict[str, None] = {}
    for _, on_data in table.groupby("data", sort=False, dropna=False):
        error = main_error(on_data)
        if error:
            main[error[0]] = None
            beside = [k for k in SECOND[error[0]] if k in on_data and on_data[k].notna().any()]
            second.update(dict.fromkeys(beside[:1]))
    errors = [*main, *(key for key in second if key not in main)]
    names = [*BEST, *errors, "ms_per_scan", "tried"]
    return [name for name in names if name in table], list(main)


def chances(best: pd.DataFrame) -> list[str]:
    """The notes beside a table of best settings: best of how many, on which data."""
    if best.empty or best["tried"].max() == 1:
        return []
    lines = ["best of several was chosen on the very data shown: confirm it on other data or seeds"]
    if best["equal"].max() > 1:
        lines.append("of settings with the same error the one with the smallest window is shown")
    return lines + equal_chances(best)


def equal_chances(best: pd.DataFrame) -> list[str]:
    """How many settings each method was the best of, in words; nothing if of one each."""
    if best.empty or best["tried"].max() <= 1:
        return []
    lines: list[str] = []
    places: dict[tuple[tuple[str, int], ...], list[str]] = {}
    many = best["data"].nunique() > 1
    for (data, backend), rows in best.groupby(["data", "backend"], sort=False, dropna=False):
        tries = [(str(s), int(n)) for s, n in zip(rows["selector"], rows["tried"], strict=True)]
        where = f"{data}, {backend}" if many else str(backend)
        places.setdefault(tuple(sorted(tries, key=lambda t: (-t[1], t[0]))), []).append(where)
    if best["tried"].nunique() == 1:
        return [*lines, f"every method had {best['tried'].iloc[0]} settings to choose from"]
    for numbers, names in list(places.items())[:MOST_LISTED]:
        prefix = f"{listed(names)}: " if len(places) > 1 else ""
        unequal = ": not an equal chance" if len({number for _, number in numbers}) > 1 else ""
        lines.append(f"{prefix}{_tries(numbers)}{unequal}")
    more = len(places) - MOST_LISTED
    return [*lines, f"and {more} more such: see the column tried"] if more > 0 else lines


def _tries(tries: Sequence[tuple[str, int]]) -> str:
    """ "rbtm had 70 settings to choose from, keyframe and previous 1 each"."""
    counts: dict[int, list[str]] = {}
    for selector, number in tries:
        counts.setdefault(number, []).append(selector)
    parts = [f"{listed(names)} {n}{' each' * (len(names) > 1)}" for n, names in counts.items()]
    number, first = next(iter(counts.items()))
    each = " each" if len(first) > 1 else ""
    settings = "setting" if number == 1 else "settings"
    return ", ".join([f"{listed(first)} had {number} {settings}{each} to choose from", *parts[1:]])


def listed(names: Sequence[str]) -> str:
    """ "a, b and c"; of many the first ones."""
    if len(names) > MOST_LISTED:
        names = [*names[: MOST_LISTED - 1], f"{len(names) - MOST_LISTED + 1} more"]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
