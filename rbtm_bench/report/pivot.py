"""Methods over two axes, as a paper's table: one number a cell, the best and its ties known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from rbtm_bench.core.columns import is_cost, less_is_better
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import answer, better
from rbtm_bench.report.best_settings import champion, main_error, winner
from rbtm_bench.report.frame import MethodRuns, table_of
from rbtm_bench.report.names import Names
from rbtm_bench.report.render import is_numeric_cell
from rbtm_bench.report.replicates import SHIFTED, counted, number_of

METRIC, DATA = "metric", "data"
"""Axes that are no setting: several metrics beside each other; the data sets."""
NOTHING = "none"
"""The backend that does not register."""
ABSENT = "-"
"""The value on an axis of a method that has no such setting."""


@dataclass(frozen=True, eq=False)
class PaperCell:
    """The number of one method: ``value`` None where it failed, ``quartiles`` over replicates;
    ``settings`` that it is the best of. ``tied``: not told apart from the best; ``dead``: a run
    registered under half of its scans."""

    key: str
    method: MethodRuns
    value: float | None
    quartiles: tuple[float, float] | None
    settings: int
    best: bool = False
    tied: bool = False
    dead: bool = False


@dataclass(frozen=True, eq=False)
class Block:
    """One data set: cells by the values on both axes, and the comparisons behind the marks."""

    data: str
    cells: dict[tuple[str, str], PaperCell]
    comparisons: list[better.Comparison]

    @property
    def keys(self) -> list[str]:
        return list(dict.fromkeys(cell.key for cell in self.cells.values()))


@dataclass(frozen=True, eq=False)
class Pivot:
    """The table: the axes and, in order, the values on them."""

    rows: str
    columns: str
    blocks: list[Block]
    names: Names

    def values(self, axis: str, block: Block | None = None) -> list[str]:
        """The values on an axis, in the order of the names' file."""
        blocks = [block] if block else self.blocks
        side = (self.rows, self.columns).index(axis)
        return self.names.order(axis, (place[side] for one in blocks for place in one.cells))

    def words(self, axis: str, value: str) -> str:
        """A value on an axis in words."""
        if axis == METRIC:
            return self.names.titled(value)
        if axis == "settings":
            return ", ".join(map(self.names.setting, value.split()))
        return value if axis == DATA else self.names.of(axis, value)

    @property
    def keys(self) -> list[str]:
        return list(dict.fromkeys(key for block in self.blocks for key in block.keys))

    @property
    def cells(self) -> list[PaperCell]:
        return [cell for block in self.blocks for cell in block.cells.values()]


def pivot(
    methods: Sequence[MethodRuns], rows: str, columns: str, metrics: Sequence[str], names: Names
) -> Pivot:
    """The table of ``methods`` (``frame.methods``, or settings chosen on other data).

    ``rows`` and ``columns`` are groups ("backend"), settings ("selector.window"), columns of a
    table ("settings"), "data" or "metric"; unless one is "data" every data set is a block.
    ``metrics``: these instead of the data's main error; several need an axis "metric". Of several
    settings that meet in a cell the best is shown. Raises ``ConfigError``.
    """
    if rows == columns or (len(metrics) > 1 and METRIC not in (rows, columns)):
        raise ConfigError(
            f"--rows {rows} --columns {columns}: expected two different axes, one of them "
            f"{METRIC} for several metrics"
        )
    methods = [m for m in methods if m.row["selector"] != SHIFTED]
    data = names.data([run for method in methods for run in method.runs])
    groups: dict[str, list[MethodRuns]] = {}
    for method in methods:
        groups.setdefault(data[method.runs[0].path], []).append(method)
    whole: dict[str, Block] = {}
    for name, group in groups.items():
        block = _block(name, group, (rows, columns), metrics)
        one = whole.setdefault("" if DATA in (rows, columns) else name, block)
        if one is not block:
            one.cells.update(block.cells)
            one.comparisons.extend(block.comparisons)
    blocks = [block for block in whole.values() if block.cells]
    if not blocks:
        raise ConfigError(f"--paper: no run has a number of {', '.join(metrics) or 'any error'}")
    return Pivot(rows, columns, blocks, names)


def _block(
    data: str, group: list[MethodRuns], axes: tuple[str, str], metrics: Sequence[str]
) -> Block:
    """The cells of one data set. Raises ``ConfigError`` for an axis that none of it has."""
    for axis in axes:
        if axis not in (METRIC, DATA) and all(_value(m, axis) == ABSENT for m in group):
            raise ConfigError(f"{axis}: no axis; expected a group, GROUP.SETTING, settings, data "
                              f"or {METRIC}")  # fmt: skip
    error = main_error(table_of(group))
    keys = list(metrics) or ([error[0]] if error else [])
    cells: dict[tuple[str, str], PaperCell] = {}
    comparisons: list[better.Comparison] = []
    places: dict[tuple[str, str], list[MethodRuns]] = {}
    for method in group:  # who is the best of a place is the same for all metrics
        rows, columns = (data if axis == DATA else _value(method, axis) for axis in axes)
        places.setdefault((rows, columns), []).append(method)
    best = {place: _best_of(members, keys[0]) for place, members in places.items() if keys}
    for key in keys:
        chosen = {
            tuple(key if axis == METRIC else v for axis, v in zip(axes, place, strict=True)):
            _cell(best[place], key, len(members)) for place, members in places.items()
        }  # fmt: skip
        if any(cell.value is not None for cell in chosen.values()):
            marked, compared = _marked(list(chosen.values()), group, key)
            cells |= {(p[0], p[1]): cell for p, cell in zip(chosen, marked, strict=True)}
            comparisons += compared
    return Block(data, cells, comparisons)


def _value(method: MethodRuns, axis: str) -> str:
    """A method's value on an axis."""
    group, _, key = axis.partition(".")
    run = method.runs[0]
    value = run.section(group).get(key) if key else run.choices.get(axis, method.row.get(axis))
    if value is None or value == "":
        return ABSENT
    return f"{value:g}" if isinstance(value, float) else str(value)


def _best_of(members: list[MethodRuns], key: str) -> MethodRuns:
    """Of the methods that meet in a cell the best by a number of which less is better, else the
    first."""
    table = table_of(members)
    won = winner(table, key) if key in table and less_is_better(key) else None
    return members[0 if won is None else table.index.get_loc(won.name)]


def _cell(method: MethodRuns, key: str, settings: int) -> PaperCell:
    value = method.row.get(key)
    known = float(value) if value is not None and is_numeric_cell(value) else None
    q1, q3 = (method.row.get(f"{key}_{end}") for end in ("q1", "q3"))
    quartiles = None if q1 is None or q3 is None else (float(q1), float(q3))
    dead = any(map(answer.is_dead, method.runs))
    return PaperCell(key, method, known, quartiles, settings, dead=dead)


def _marked(
    cells: list[PaperCell], group: list[MethodRuns], key: str
) -> tuple[list[PaperCell], list[better.Comparison]]:
    """The cells with the best marked and what is not told apart from it (``better.beside_best``,
    adjusted for all methods of the data set, shown or not)."""
    if not less_is_better(key):
        return cells, []
    table = table_of([cell.method for cell in cells])
    won = champion(table, key)
    if won is None:
        return cells, []
    best = cells[table.index.get_loc(won.name)]
    pairs = better.beside_best(best.method, group, key)
    # of runs nothing is proven; copies without registration do not differ: they cannot be tested
    proven = [(m, one) for m, one in pairs if one.unit != better.RUNS and not is_cost(key)]
    pairs = [(m, one) for m, one in proven if m.row["backend"] != NOTHING]
    tied = {id(m) for m, one in pairs if one.holds != "better"}
    marked = [replace(c, best=c is best, tied=id(c.method) in tied) for c in cells]
    return marked, [one for _, one in pairs]


def repeats(cells: Sequence[PaperCell]) -> tuple[str, int, int]:
    """What the numbers are medians of ("replicates", "seeds"), the fewest and most in a cell of a
    method that registers."""
    known = [cell for cell in cells if cell.value is not None]
    real = [cell for cell in known if cell.method.row["backend"] != NOTHING] or known
    copied = any(number_of(run) for cell in real for run in cell.method.runs)
    counts = [sum(run.done for run in counted(cell.method.runs)) for cell in real]
    return "replicates" if copied else "seeds", min(counts), max(counts)
