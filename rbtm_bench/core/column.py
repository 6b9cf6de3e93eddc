"""What is declared of a number, once: whatever shows, stores or documents it asks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Column:
    """A number of a run: a key of metrics.json, a column of tables, a row of docs/metrics.md.

    ``family`` is who computes it (a metric, the steps, the cost). Over seeds its median is shown.
    ``table``: always a column of a whole table; ``screen``: shown at the end of a comparison;
    ``line``: its words in the summary of a run. ``main`` ranks what methods are judged by (1 comes
    first, 0: never), ``title`` is that error in words, and ``beside`` what stands next to it.
    ``cost``: depends on the machine's mood, or on what other runs had computed before.
    """

    family: str
    name: str
    unit: str
    about: str
    source: str
    title: str = ""
    table: bool = False
    screen: bool = False
    line: str = ""
    main: int = 0
    beside: tuple[str, ...] = ()
    less_is_better: bool = False
    cost: bool = False
    short: str = ""
    """Its header on a screen; "": its name."""

    @property
    def plain_unit(self) -> str:
        """The unit without remarks: "mm" of "mm, signed"; "" of what is counted or a share."""
        unit = self.unit.partition(",")[0]
        return "" if unit in ("count", "share") else unit

    def __str__(self) -> str:
        return f"{self.unit}; {self.about}; {self.source}"


@dataclass(frozen=True)
class StepColumn:
    """A column of steps.parquet: ``type``: int, float, str, bool or list (of floats)."""

    name: str
    type: str
    unit: str
    about: str
    default: object = None


def by_name(columns: Iterable[Column]) -> dict[str, Column]:
    """The columns by their names, in order."""
    return {column.name: column for column in columns}


def page_rows(columns: Iterable[Column]) -> list[str]:
    """The rows of the table of docs/metrics.md that declares them."""
    cells = ((f"`{c.name}`", c.unit, c.about, c.source) for c in columns)
    return [f"| {' | '.join(cell.replace('|', BAR) for cell in row)} |" for row in cells]


BAR = "\\|"
"""A bar within a cell of a Markdown table."""


def like(column: Column, **changes: object) -> Column:
    """A column as another, but for these fields."""
    values: Mapping[str, object] = {f.name: getattr(column, f.name) for f in fields(Column)}
    return Column(**{**values, **changes})  # type: ignore[arg-type]
