"""Every number of a run, declared once, in the order of tables.

metrics.json, tables, the screen, the summary of a run and docs/metrics.md follow from this list; a
new number is computed by its metric and declared in this list.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import groupby

from rbtm_bench.core.column import Column, by_name, like
from rbtm_bench.core.error_columns import ERRORS
from rbtm_bench.core.loop_columns import LOOPS, looped
from rbtm_bench.core.step_columns import COVERAGE, SUMS

REFERENCES = {"_truth": "truth", "_still": "no motion"}
"""Ends of keys that hold the number of another trajectory than the estimate: of the truth, and of
no motion at all. In a table they are rows of their own, not columns."""

DEGENERATE = 0.01
"""A motion that less than this share of the matched points opposes counts as unseen in tables: a
bare corridor with 10 mm noise has 0.00005 along its axis, one with recesses 0.14."""


def _relation_groups(column: Column) -> list[Column]:
    """The same number of local and of long relations."""
    stem = column.name.removeprefix("relations_")
    counted = stem in ("used", "total")
    groups = []
    for group in ("local", "long"):
        about = column.about.replace("relations ", f"{group} relations ")
        groups.append(
            like(
                column,
                name=f"relations_{group}_{stem}",
                about=about if counted else f"{column.about} of the {group} relations",
                source="split: own" if counted else "as above",
                table=False,
                screen=stem == "translation_mean_m",
                short=f"relations_{group}_mean_m" if stem == "translation_mean_m" else "",
                **{"line": "", "main": 0, "title": "", "beside": ()},
            )
        )
    return groups


def _map_references(column: Column) -> list[Column]:
    """The same number of the map of the truth and of no motion."""
    whose = {"_truth": "of the true poses", "_still": "with every scan at the first pose"}
    return [
        like(
            column,
            name=column.name + end,
            about=f"`{column.name}` {words}",
            source="as above",
            screen=False,
        )
        for end, words in whose.items()
    ]


def _with_derived(columns: Iterable[Column]) -> Iterator[Column]:
    """The columns and, behind each family, those that follow from its."""
    derive = {"relations": _relation_groups, "maps": _map_references}
    for _, own in groupby(columns, key=lambda column: column.family):
        together = list(own)
        yield from together
        if together[0].family in derive:
            derived = [derive[together[0].family](column) for column in together]
            yield from (column for group in zip(*derived, strict=True) for column in group)


def _is_reference(column: Column) -> bool:
    return column.name.endswith(tuple(REFERENCES))


COLUMNS = (
    *_with_derived([*COVERAGE, *ERRORS, *SUMS]),
    *LOOPS,
    *looped(column for column in _with_derived(ERRORS) if not _is_reference(column)),
)
KNOWN = by_name(COLUMNS)
MAIN = tuple(sorted((c for c in COLUMNS if c.main), key=lambda column: column.main))
"""What methods are compared by: the first of these that the runs on a data set have."""


def family(name: str) -> dict[str, Column]:
    """The columns of a family by their keys."""
    return by_name(column for column in COLUMNS if column.family == name)


def is_cost(key: str) -> bool:
    """Whether a number depends on the machine, not on the method."""
    return key in KNOWN and KNOWN[key].cost


def less_is_better(key: str) -> bool:
    """Whether a number may be called better or worse; of others only more or less is known."""
    return key in KNOWN and KNOWN[key].less_is_better
