"""A progress bar on standard error, only where somebody can see it."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class Bar:
    """A bar of how far things are; does nothing when nobody is watching."""

    def __init__(self, rich_bar: Any = None, task: Any = None) -> None:
        self._bar, self._task = rich_bar, task

    def update_to(self, done: float, total: int | None, note: str = "") -> None:
        """``done`` of ``total`` are ready."""
        if self._bar is not None:
            self._bar.update(self._task, completed=done, total=total, note=note)

    def step(self, note: str = "") -> None:
        """One more is ready."""
        if self._bar is not None:
            self._bar.update(self._task, advance=1, note=note)


class RunBar:
    """The one bar of a sweep or comparison: runs done, reused and failed, and the time left.

    ``total`` is None where nobody knows it; ``reused`` runs were finished before this process
    began. Any thread may report.
    """

    def __init__(
        self,
        bar: Bar,
        total: int | None,
        reused: int = 0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bar, self._total, self.reused = bar, total, reused
        self._clock, self._began = clock, clock()
        self._lock = threading.Lock()
        self._parts: dict[str, float] = {}
        self.done = self.failed = 0
        self._registrations = self._shared = 0.0
        self._show()

    def ended(self, name: str, done: bool, registrations: int = 0, shared: float = 0.0) -> None:
        """A run has ended; ``shared`` is the part of its registrations that it did not compute."""
        with self._lock:
            self._parts.pop(name, None)
            self.done, self.failed = self.done + done, self.failed + (not done)
            self._registrations += registrations
            self._shared += registrations * shared
            self._show()

    def part(self, name: str, scans: int, total: int) -> None:
        """A run that is not over has got through ``scans`` of ``total``."""
        with self._lock:
            self._parts[name] = min(scans / total, 1.0) if total else 0.0
            self._show()

    def text(self) -> str:
        """ "5 done, 3 reused, 1 failed, 62% of registrations shared, 0:42 left"."""
        words = [f"{self.done} done"]
        words += [f"{self.reused} reused"] if self.reused else []
        words += [f"{self.failed} failed"] if self.failed else []
        if self._registrations:
            words.append(f"{self._shared / self._registrations:.0%} of registrations shared")
        left = self._seconds_left()
        if left is not None:
            minutes, seconds = divmod(round(left), 60)
            hours, minutes = divmod(minutes, 60)
            clock = f"{hours}:{minutes:02}:{seconds:02}" if hours else f"{minutes}:{seconds:02}"
            words.append(f"{clock} left")
        return ", ".join(words)

    def _work(self) -> float:
        """Runs that this process has done, parts of runs included."""
        return self.done + self.failed + sum(self._parts.values())

    def _seconds_left(self) -> float | None:
        work = self._work()
        if self._total is None or work <= 0.0:
            return None
        rest = max(self._total - self.reused - work, 0.0)
        return rest * (self._clock() - self._began) / work

    def _show(self) -> None:
        self._bar.update_to(self.reused + self._work(), self._total, self.text())


@contextmanager
def bar(what: str, total: int | None = None) -> Iterator[Bar]:
    """A bar over ``total`` things called ``what``; it goes when it is done."""
    with _shown(_rich(time_left=True), what, total) as shown:
        yield shown


@contextmanager
def run_bar(total: int | None, reused: int = 0) -> Iterator[RunBar]:
    """The bar of a sweep or comparison; it goes when it is done."""
    with _shown(_rich(time_left=False), "runs", total) as shown:
        yield RunBar(shown, total, reused)


@contextmanager
def _shown(rich_bar: Any, what: str, total: int | None) -> Iterator[Bar]:
    if rich_bar is None:
        yield Bar()
        return
    with rich_bar:
        yield Bar(rich_bar, rich_bar.add_task(what, total=total, note=""))


def _rich(time_left: bool) -> Any:
    """Rich's progress display on standard error; None where nobody looks."""
    if sys.stderr is None or not sys.stderr.isatty():
        return None
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn,
    )

    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        *([TimeRemainingColumn()] if time_left else []),
        TextColumn("{task.fields[note]}"),
        console=Console(stderr=True),
        transient=True,
    )
