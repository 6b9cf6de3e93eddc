"""The runs of a data set as a figure compares them: a panel a backend, a line or point a method."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.looks import colours
from rbtm_bench.report import frame
from rbtm_bench.report.best_settings import NO_METHODS
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.replicates import SHIFTED, counted, number_of
from rbtm_bench.runs.stored import Run, is_number

FEW = 6
"""Methods that lines in one panel can tell apart."""


@dataclass(frozen=True, eq=False)
class Method:
    """A selector with its settings. ``runs`` are those that are done and differ in their seed or
    replicate alone, the lowest first; ``failed`` counts those that are not done. ``control``: it
    was added, not asked for."""

    name: str
    selector: str
    runs: list[Run]
    failed: int
    control: bool = False

    @property
    def counted(self) -> list[Run]:
        """The runs whose errors stand for the method: where there are replicates, those."""
        return counted(self.runs)

    def error(self, key: str) -> float | None:
        """The median of an error; None where a run failed, or has none."""
        known = [labels.value(run, key) for run in self.counted]
        values = [value for value in known if value is not None]
        whole = values and len(values) == len(known) and not self.failed
        return float(np.median(values)) if whole else None


@dataclass(frozen=True, eq=False)
class Panel:
    """One backend (``name``: with what else tells backends apart, ``backend``: the member)."""

    name: str
    backend: str
    methods: list[Method]


@dataclass(frozen=True, eq=False)
class Data:
    """One data set. ``stem`` begins its figures' file names; ``guess`` is the run of the lowest
    seed without registration (backend "none"), None without one or without anything else, or if
    they started from different guesses."""

    stem: str
    name: str
    runs: list[Run]
    panels: list[Panel]
    guess: Run | None

    @property
    def methods(self) -> dict[str, str]:
        """The names of all methods and their selectors, in order."""
        return {method.name: method.selector for p in self.panels for method in p.methods}

    @property
    def colours(self) -> dict[str, str]:
        """The colour of every panel."""
        names = [panel.backend for panel in self.panels]
        if len(set(names)) < len(names):  # settings of one backend: a colour each
            return colours(panel.name for panel in self.panels)
        own = colours(names)
        return {panel.name: own[panel.backend] for panel in self.panels}

    @property
    def several(self) -> bool:
        """Whether the panels hold two methods or more to compare."""
        return sum(len(panel.methods) for panel in self.panels) > 1

    @property
    def winner(self) -> Method | None:
        """The method with the least main error; the oracle is none."""
        error = labels.main_error([run for run in self.runs if run.done])
        known: list[tuple[float, Method]] = []
        for method in (method for panel in self.panels for method in panel.methods):
            value = method.error(error[0]) if error else None
            if value is not None and method.selector not in NO_METHODS:
                known.append((value, method))
        return min(known, key=lambda pair: pair[0])[1] if known else None

    def few(self) -> tuple[Data, str]:
        """The same with so few methods that lines in a panel stay distinct, and a note for the
        title: of more than 6, the first setting of every selector (not the best: that would
        be chosen on this very data) and the winner."""
        if max(len(panel.methods) for panel in self.panels) <= FEW:
            return self, ""
        first: dict[str, str] = {}
        asked: dict[bool, dict[str, str]] = {False: {}, True: {}}
        for run in self.runs:  # in the order of their folders, as for every other choice of one
            for panel in self.panels:
                for method in panel.methods:
                    if run in method.runs:
                        asked[method.control].setdefault(method.selector, method.name)
        first = asked[True] | asked[False]
        won = self.winner
        kept = [
            Panel(
                panel.name,
                panel.backend,
                [m for m in panel.methods if first.get(m.selector) == m.name or m is won],
            )
            for panel in self.panels
        ]
        note = "of several settings of a strategy the first, and the best of all"
        panels = [panel for panel in kept if panel.methods]
        return Data(self.stem, self.name, self.runs, panels, self.guess), note


def repeats(runs: Sequence[Run]) -> str:
    """What runs of one method differ in: "replicates" or "seeds"."""
    return "replicates" if any(map(number_of, runs)) else "seeds"


def by_data(runs: Sequence[Run]) -> list[tuple[str, str, list[Run]]]:
    """File stem, name in words and runs of every data set; without rotations of a run's gaps,
    which are a test, unless there is nothing else."""
    runs = [run for run in runs if labels.choice(run, "selector") != SHIFTED] or runs
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(labels.data_key(run), []).append(run)
    firsts = [group[0] for group in groups.values()]
    own = labels.varying(firsts, "dataset")
    words = style.names().data(firsts)
    out: list[tuple[str, str, list[Run]]] = []
    for first, group in zip(firsts, groups.values(), strict=True):
        stem = file_name("-".join([labels.choice(first, "dataset"), *own[first]]))
        stem = unique(stem, [other for other, _, _ in out])
        out.append((stem, words[first.path], group))
    return out


def file_name(text: str) -> str:
    """The text without what a file name should not hold."""
    return re.sub(r"[^\w.=+-]+", "_", text)


def unique(stem: str, taken: Sequence[str]) -> str:
    """The stem, with a number if it is taken."""
    name, count = stem, 2
    while name in taken:
        name, count = f"{stem}-{count}", count + 1
    return name


def data_sets(runs: Sequence[Run]) -> list[Data]:
    """The runs by data set; data sets without a run that is done are left out."""
    out: list[Data] = []
    for stem, name, group in by_data(runs):
        if not any(run.done for run in group):
            continue
        real = [run for run in group if labels.choice(run, "backend") != "none"]
        alone = [r for r in group if r.done and labels.choice(r, "backend") == "none"]
        same = len({labels.key_of(run, ("guess",)) for run in alone}) == 1
        guess = min(alone, key=labels.seed_order) if real and same else None
        out.append(Data(stem, name, group, _panels(real or group), guess))
    return [data for data in out if data.panels]


def _panels(runs: list[Run]) -> list[Panel]:
    """Panels with a method that has a run, methods in one order."""
    names = style.names()
    panels: dict[str, Panel] = {}
    for method in sorted(frame.methods(runs), key=order):
        done = sorted((run for run in method.runs if run.done), key=labels.seed_order)
        if not done:
            continue
        row = as_asked(method)
        name, failed = names.method(row), len(method.runs) - len(done)
        one = Method(name, row["selector"], done, failed, bool(row.get("control")))
        panel = Panel(names.backend(row), row["backend"], [])
        panels.setdefault(panel.name, panel).methods.append(one)
    known = names.order("backend", (panel.backend for panel in panels.values()))
    return sorted(panels.values(), key=lambda panel: known.index(panel.backend))


def as_asked(method: MethodRuns) -> dict[str, Any]:
    """A method's row with the threshold and window of its run on the data as they are: replicates
    have others, whose medians differ from backend to backend."""
    plain = [run for run in method.runs if number_of(run) == 0]
    own = plain[0].section("selector") if plain else {}
    known = {key: own[key] for key in ("window", "threshold") if is_number(own.get(key))}
    return {**method.row, **known}


def order(method: MethodRuns) -> tuple[Any, ...]:
    """For sorting: strategies as the names' file has them, settings by their size."""
    selectors = list(style.names().groups["selector"])
    selector = method.row["selector"]
    place = selectors.index(selector) if selector in selectors else len(selectors)
    settings = method.runs[0].section("selector")
    sizes = [settings.get(key) for key in ("window", "threshold", "gap", "distance")]
    numbers = [float(n) if n is not None and is_number(n) else -math.inf for n in sizes]
    return (place, selector, *numbers)
