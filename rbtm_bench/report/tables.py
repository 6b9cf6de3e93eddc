"""Tables of runs as text, CSV, Markdown, LaTeX, HTML and JSON, and the verdict in words."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report.frame import METHOD
from rbtm_bench.report.references import accompanied, judged, with_references

if TYPE_CHECKING:
    import pandas as pd

FORMATS = ("text", "csv", "md", "latex", "html", "json")

ERRORS = (
    ("relations_translation_mean_m", "m", "mean relation error"),
    ("final_translation_error_mm", "mm", "final position error"),
    ("ape_rmse_m", "m", "APE RMSE"),
)
"""What methods are compared by: the first of these that the runs on a data set have."""

BEST = (*METHOD, "seeds", "status", "coverage")
"""The columns of the table of best settings, before the errors, ms_per_scan and tried."""

SHORT = (
    *BEST,
    "final_translation_error_mm",
    "final_along_mm",
    "final_cross_mm",
    "final_rotation_error_deg",
    "ape_rmse_m",
    "relations_translation_mean_m",
    "relations_translation_std_m",
    "relations_rotation_mean_deg",
    "relations_local_translation_mean_m",
    "relations_long_translation_mean_m",
    "registrations",
    "rejected",
    "fallbacks",
    "mean_gap",
    "degenerate",
    "map_entropy_nat",
    "map_variance_mm2",
    "map_cells",
    "ms_per_scan",
)
"""The columns of the table at the end of ``compare``."""

NO_CONTROL = ("rbtm", "rbtm_verified", "oracle")
"""Selectors that rbtm is not held against: itself, and what sees the truth."""

TOLD = 4
"""Names or sentences of a kind at most, so that a screen holds all."""

ALWAYS = ("backend", "selector", "tried")

SECOND = {
    "relations_translation_mean_m": ("relations_rotation_mean_deg",),
    "final_translation_error_mm": ("ape_rmse_m", "final_rotation_error_deg"),
    "ape_rmse_m": ("rpe_translation_rmse_m",),
}
"""What stands beside an error in the table of best settings: the first of these that is there."""


def render(table: pd.DataFrame, fmt: str) -> str:
    """The table in one of ``FORMATS``. Text, Markdown, LaTeX and HTML leave out columns that are
    empty in every row and round to 4 digits; CSV and JSON keep everything. Numbers that say little
    without those of the truth and of no motion have them in rows at the end."""
    table = with_references(table)
    if fmt == "csv":
        return table.to_csv(index=False).rstrip("\n")
    if fmt == "json":
        rows = table.astype(object).to_dict(orient="records")
        return json.dumps(
            [{k: None if _is_empty(v) else v for k, v in row.items()} for row in rows], indent=1
        )
    shown = table[[c for c in table if not all(_is_empty(v) for v in table[c])]]
    words = shown.map(_word)
    numeric = {c for c in shown if all(_is_number(v) or _is_empty(v) for v in shown[c])}
    if fmt == "html":
        return words.to_html(index=False, border=0, na_rep="", justify="left")
    if fmt == "latex":
        style = "".join("r" if c in numeric else "l" for c in shown)
        return str(
            words.style.hide(axis="index")
            .format(escape="latex")
            .format_index(escape="latex", axis=1)
            .to_latex(column_format=style, hrules=True)
        ).rstrip("\n")
    from tabulate import tabulate

    align = ["right" if c in numeric else "left" for c in shown]
    headers = list(shown) if fmt == "md" else [_stacked(str(c)) for c in shown]
    kind = "pipe" if fmt == "md" else "simple"
    if fmt == "md":
        words = words.map(lambda word: word.replace("|", "\\|"))
    return tabulate(
        words.to_numpy().tolist(), headers, tablefmt=kind, colalign=align, disable_numparse=True
    )


def existing_columns(table: pd.DataFrame, names: str) -> list[str]:
    """The columns of a comma list. Raises ``ConfigError`` for one that is not there."""
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    for name in wanted:
        if name not in table:
            raise ConfigError(f"--columns {name}: no such column. Known: {', '.join(table)}")
    return accompanied(table, wanted)


def screen(
    table: pd.DataFrame, columns: Sequence[str] = SHORT, keep: Sequence[str] = ALWAYS
) -> tuple[pd.DataFrame, str]:
    """The columns that fit a screen, and in words those that are the same in every row (unless
    they are to be kept)."""
    shown = table[accompanied(table, [c for c in columns if c in table])]
    if len(table) < 2:
        return shown, ""
    keep = (*keep, *accompanied(shown, judged(shown)))
    same = [c for c in shown if c not in keep and len({_word(v) for v in shown[c]}) == 1]
    words = [f"{c} {_word(shown[c].iloc[0])}" for c in same if _word(shown[c].iloc[0])]
    return shown.drop(columns=same), ", ".join(words)


def main_error(table: pd.DataFrame) -> tuple[str, str, str] | None:
    """Key, unit and name of the first of ``ERRORS`` that a row has."""
    return next((e for e in ERRORS if e[0] in table and table[e[0]].notna().any()), None)


def best(table: pd.DataFrame) -> pd.DataFrame:
    """The best setting of every data set, backend and selector, within a backend by error.

    ``table`` has a row a method (medians over seeds). ``tried`` counts the settings that a row is
    the best of: all that were allowed, failed ones too; ``equal`` those with the very same error,
    of which the one with the smallest window, then threshold, stands for all. Where none has an
    error, there is no best: the row names no setting.
    """
    import pandas as pd

    rows: list[dict[str, Any]] = []
    for _, here in table.groupby("data", sort=False, dropna=False):
        found = main_error(here)
        for _, methods in here.groupby("backend", sort=False, dropna=False):
            groups = [g for _, g in methods.groupby("selector", sort=False, dropna=False)]
            chosen = [_best_of(group, found[0] if found else None) for group in groups]
            if found:
                chosen.sort(key=lambda r: math.inf if _is_empty(r[found[0]]) else r[found[0]])
            rows += chosen
    return pd.DataFrame(rows)


def _best_of(settings: pd.DataFrame, key: str | None) -> dict[str, Any]:
    """The winner of one selector's settings, and how many there were."""
    tried = len(settings)
    won = _winner(settings, key) if key else None
    if won is not None or tried == 1:
        row = (settings.iloc[0] if won is None else won).to_dict()
        equal = 1 if won is None else int((settings[key] == won[key]).sum())
        return {**row, "tried": tried, "equal": equal}
    row = dict.fromkeys(settings)
    row.update({k: settings[k].iloc[0] for k in ("dataset", "data", "backend", "selector")})
    statuses = set(settings["status"])
    row["status"] = statuses.pop() if len(statuses) == 1 else "failed"
    return {**row, "tried": tried, "equal": 1}


def _winner(rows: pd.DataFrame, key: str) -> pd.Series[Any] | None:
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
    for _, here in table.groupby("data", sort=False, dropna=False):
        found = main_error(here)
        if found:
            main[found[0]] = None
            there = [k for k in SECOND[found[0]] if k in here and here[k].notna().any()]
            second.update(dict.fromkeys(there[:1]))
    errors = [*main, *(key for key in second if key not in main)]
    names = [*BEST, *errors, "ms_per_scan", "tried"]
    return [name for name in names if name in table], list(main)


def chances(best: pd.DataFrame) -> list[str]:
    """What must be said beside a table of best settings: best of how many, on which data."""
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
    for numbers, names in list(places.items())[:TOLD]:
        prefix = f"{_listed(names)}: " if len(places) > 1 else ""
        unequal = ": not an equal chance" if len({number for _, number in numbers}) > 1 else ""
        lines.append(f"{prefix}{_tries(numbers)}{unequal}")
    more = len(places) - TOLD
    return [*lines, f"and {more} more such: see the column tried"] if more > 0 else lines


def _tries(tries: Sequence[tuple[str, int]]) -> str:
    """ "rbtm had 70 settings to choose from, keyframe and previous 1 each"."""
    counts: dict[int, list[str]] = {}
    for selector, number in tries:
        counts.setdefault(number, []).append(selector)
    parts = [f"{_listed(names)} {n}{' each' * (len(names) > 1)}" for n, names in counts.items()]
    number, first = next(iter(counts.items()))
    each = " each" if len(first) > 1 else ""
    settings = "setting" if number == 1 else "settings"
    return ", ".join([f"{_listed(first)} had {number} {settings}{each} to choose from", *parts[1:]])


def _listed(names: Sequence[str]) -> str:
    """ "a, b and c"; of many the first ones."""
    if len(names) > TOLD:
        names = [*names[: TOLD - 1], f"{len(names) - TOLD + 1} more"]
    return " and ".join(filter(None, [", ".join(names[:-1]), names[-1]]))


def verdict(table: pd.DataFrame, say_tries: bool = True) -> list[str]:
    """Sentences, computed from the numbers, on how rbtm compares with its controls.

    ``table`` has a row a method (medians over seeds). A line for every data set and backend that
    has rbtm and at least one control. Not a test of significance: medians are compared. Without
    ``say_tries`` somebody else says of how many settings each is the best.
    """
    lines: list[str] = []
    for (data, backend), methods in table.groupby(["data", "backend"], sort=False):
        here = table[table.data == data]
        found = main_error(here)
        if found is None:
            continue
        key, unit, name = found
        rows = methods.dropna(subset=[key]).astype({key: float})
        ours, controls = rows[rows.selector == "rbtm"], rows[~rows.selector.isin(NO_CONTROL)]
        best, rival = _winner(ours, key), _winner(controls, key)
        if best is None or rival is None or backend == "none":
            continue
        line = (
            f"{data}, {backend}: {name} of {_label(best)} is {three_digits(best[key])} {unit}, "
            f"of the best control, {_label(rival)}, {three_digits(rival[key])} {unit}: "
            f"{_relation(float(best[key]), float(rival[key]))}"
        )
        previous = rows[rows.selector == "previous"]
        if not previous.empty and rival.selector != "previous":
            value = float(previous[key].min())
            line += f"; previous {three_digits(value)} {unit}, {_relation(float(best[key]), value)}"
        line += _without_registration(table, str(data), key, unit, float(best[key]))
        tries = methods.groupby("selector", sort=False).size()
        if say_tries and tries.max() > 1:
            line += ". Best of " + ", ".join(f"{n} x {s}" for s, n in tries.items())
            line += " settings, chosen on this very data"
        lines.append(line + ".")
    return lines


def _without_registration(table: pd.DataFrame, data: str, key: str, unit: str, ours: float) -> str:
    """The baseline that every registration has to beat, where the table has it."""
    rows = table[(table.data == data) & (table.backend == "none")][key].dropna()
    if rows.empty:
        return ""
    value = float(rows.min())
    return f"; no registration {three_digits(value)} {unit}, {_relation(ours, value)}"


def _label(row: pd.Series[Any]) -> str:
    details = [f"{k} {row[k]:g}" for k in ("window", "threshold") if _is_number(row.get(k))]
    extra = row.get("settings")
    details += [str(extra)] if extra else []
    return f"{row['selector']} ({', '.join(details)})" if details else str(row["selector"])


def _relation(ours: float, other: float) -> str:
    if ours == other:
        return "rbtm is equal"
    if min(ours, other) <= 0:
        return "rbtm is better" if ours < other else "rbtm is worse"
    ratio = max(ours, other) / min(ours, other)
    if ratio < 1.05:
        return "rbtm is as good, within 5%"
    return f"rbtm is {ratio:.3g} times {'better' if ours < other else 'worse'}"


def three_digits(value: float) -> str:
    """Three significant digits, without an exponent for everyday numbers."""
    return f"{value:.0f}" if 100 <= abs(value) < 1e6 else f"{value:.3g}"


def _stacked(column: str) -> str:
    """A column's name over several lines, so that tables stay narrow."""
    return column.replace("_", "\n")


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and value == value


def _is_empty(value: Any) -> bool:
    return value is None or value == "" or (isinstance(value, float) and math.isnan(value))


def _word(value: Any) -> str:
    if _is_empty(value):
        return ""
    if isinstance(value, float):
        whole = abs(value) < 1e6 and (abs(value) >= 1e3 or value == round(value))
        return f"{value:.0f}" if whole else f"{value:.4g}"
    return str(value)
