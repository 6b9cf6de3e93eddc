"""What closing loops adds to a run's numbers: counts, time, and the errors once more."""

from __future__ import annotations

from collections.abc import Iterable

from rbtm_bench.core.column import Column, like

LOOPED = "looped_"
"""Begins the keys of errors of the trajectory with its loops closed."""

LOOPS = (
    Column(
        "loops",
        "loops",
        "count",
        "loops that were believed; this and the following only with `loops=` other than none",
        "own",
        screen=True,
        line="loops closed",
    ),
    Column("loops", "loops_candidates", "count", "pairs of keyframes looked at for a loop", "own"),
    Column("loops", "loops_rejected", "count", "of these not believed", "own"),
    Column(
        "loops",
        "loops_off",
        "count",
        "of those believed counting less than half in the end",
        "Agarwal et al. 2013, s < 0.5",
    ),
    Column(
        "loops",
        "loops_seconds",
        "s",
        "looking for loops, registering and optimising, after the last scan",
        "own",
        cost=True,
    ),
    Column(
        "loops",
        "loops_ms_per_scan",
        "ms",
        "the same, over all scans; `ms_per_scan` does not hold it",
        "own",
        screen=True,
        cost=True,
    ),
)


def looped(columns: Iterable[Column]) -> list[Column]:
    """The same numbers of the trajectory with loops closed."""
    return [
        like(
            column,
            family="looped",
            name=LOOPED + column.name,
            about=f"`{column.name}` with loops closed",
            source="as there",
            table=False,
            screen=column.main > 0,
            line=f"{column.line}, looped" if column.main else "",
            short="",
            main=0,
            title="",
            beside=(),
        )
        for column in columns
    ]
