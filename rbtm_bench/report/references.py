"""Rows of a table that are no methods: the same numbers of the truth, and of no motion at all.

Some numbers, those of the quality of a map, look good for wrong reasons too. A run stores them
for other trajectories as well (``core.columns.REFERENCES``), and no table shows the one without
the other: whoever picks columns asks ``accompanied``, and ``render.render`` makes the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.columns import REFERENCES

if TYPE_CHECKING:
    import pandas as pd

STATUS = "reference"
NAMING = ("run", "backend")
"""The columns that name such a row, else the selector, else a column of its own in front."""


def judged(table: pd.DataFrame) -> list[str]:
    """The columns whose numbers the table also has of another trajectory."""
    return [str(c) for c in table if any(f"{c}{end}" in table for end in REFERENCES)]


def accompanied(table: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """The names of columns and of what the rows of references are made of, if they need any."""
    keys = [key for key in judged(table) if key in names]
    if not keys:
        return list(names)
    more = [key + end for key in keys for end in REFERENCES if key + end in table]
    if "data" in table and table["data"].nunique(dropna=False) > 1:
        more.append("data")
    if "settings" in table and table["settings"].map(_of_metrics).any():
        more.append("settings")
    return [*names, *(name for name in more if name not in names)]


def with_references(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the numbers of the truth (where it is known) and of no motion as rows at its
    end, for every data set, instead of as columns. Medians over the rows of the data set; those
    that measured by other settings have references of their own."""
    import pandas as pd

    keys = judged(table)
    if not keys:
        return table
    columns = [c for c in table if not any(c == key + end for key in keys for end in REFERENCES)]
    data = table["data"].astype(object) if "data" in table else pd.Series("", index=table.index)
    words = table["settings"].map(_of_metrics) if "settings" in table else data.map(lambda _: "")
    names = [name for name in (*NAMING, "selector") if name in table][: len(NAMING)]
    label = [name for name in names if name in NAMING] or names or ["row"]
    rows: list[dict[str, Any]] = []
    for (_, word), group in table.groupby([data, words], sort=False, dropna=False):
        for end, name in REFERENCES.items():
            numbers = {key: _median(group[key + end]) for key in keys if key + end in group}
            if all(number is None for number in numbers.values()):
                continue
            of_data = {c: group[c].iloc[0] for c in ("dataset", "data") if c in group}
            naming = {"status": STATUS, "settings": word} | dict.fromkeys(label, f"({name})")
            rows.append(numbers | of_data | naming)
    methods = table[columns].astype(object).to_dict(orient="records")
    if label == ["row"]:
        columns = ["row", *columns]
    return pd.DataFrame([*methods, *rows], columns=columns, dtype=object)


def _of_metrics(settings: Any) -> str:
    """The metrics' own settings among those of a row."""
    words = settings.split() if isinstance(settings, str) else []
    return " ".join(word for word in words if word.startswith("metrics."))


def _median(column: pd.Series[Any]) -> float | None:
    known = column.dropna()
    return None if known.empty else float(known.astype(float).median())
