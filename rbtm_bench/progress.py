"""A progress bar on standard error, only where somebody can see it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Bar:
    """A bar that is told how far things are; does nothing when nobody is watching."""

    def __init__(self, rich_bar: Any = None, task: Any = None) -> None:
        self._bar, self._task = rich_bar, task

    def update_to(self, done: int, total: int) -> None:
        """``done`` of ``total`` are ready."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, total=total)

    def step(self, note: str = "") -> None:
        """One more is ready."""
        if self._bar is not None:
            self._bar.update(self._task, advance=1, note=note)


@contextmanager
def bar(what: str, total: int | None = None) -> Iterator[Bar]:
    """A bar over ``total`` things called ``what``; it goes when it is done."""
    if not sys.stderr.isatty():
        yield Bar()
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        console=Console(stderr=True),
        transient=True,
    ) as rich_bar:
        yield Bar(rich_bar, rich_bar.add_task(what, total=total, note=""))
