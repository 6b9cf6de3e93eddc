"""The runs of a data set as a figure compares them: a panel a backend, a line or point a method."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from rbtm_bench.plots import labels
from rbtm_bench.report import frame
from rbtm_bench.report.replicates import counted, number_of
from rbtm_bench.runs.stored import Run

FEW = 6
"""Methods that lines in one panel can tell apart."""


@dataclass(frozen=True, eq=False)
class Method:
    """A selector with its settings. ``runs`` are those that are done and differ in their seed or
    replicate alone, the lowest first; ``failed`` counts those that are not done."""

    name: str
    selector: str
    runs: list[Run]
    failed: int

    @property
    def counted(self) -> list[Run]:
        """The runs whose errors stand for the method: where there are replicates, those."""
        return counted(self.runs)


@dataclass(frozen=True, eq=False)
class Panel:
    """One backend (with what else tells backends apart) and its methods."""

    name: str
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
    def several(self) -> bool:
        """Whether the panels hold two methods or more to compare."""
        return sum(len(panel.methods) for panel in self.panels) > 1

    def few(self) -> tuple[Data, str]:
        """The same with so few methods that lines in a panel stay distinct, and a note for the
        title: of more than 6, the first setting of every selector (not the best: that would
        be chosen on this very data)."""
        if max(len(panel.methods) for panel in self.panels) <= FEW:
            return self, ""
        first: dict[str, str] = {}
        for run in self.runs:  # in the order of their folders, as for every other choice of one
            for panel in self.panels:
                for method in panel.methods:
                    if run in method.runs:
                        first.setdefault(method.selector, method.name)
        kept = [
            Panel(panel.name, [m for m in panel.methods if first.get(m.selector) == m.name])
            for panel in self.panels
        ]
        note = "of several settings of a selector the first"
        panels = [panel for panel in kept if panel.methods]
        return Data(self.stem, self.name, self.runs, panels, self.guess), note


def repeats(runs: Sequence[Run]) -> str:
    """What runs of one method differ in: "replicates" or "seeds"."""
    return "replicates" if any(map(number_of, runs)) else "seeds"


def by_data(runs: Sequence[Run]) -> list[tuple[str, str, list[Run]]]:
    """File stem, name in words and runs of every data set."""
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(labels.data_key(run), []).append(run)
    words = labels.varying([group[0] for group in groups.values()], "dataset")
    out: list[tuple[str, str, list[Run]]] = []
    for group in groups.values():
        own, name = words[group[0]], labels.data_name(group[0])
        stem = file_name("-".join([labels.choice(group[0], "dataset"), *own]))
        in_name = [word for word in own if f"({word.removeprefix('environment=')})" in name]
        title = ", ".join([name, *(word for word in own if word not in in_name)])
        out.append((unique(stem, [other for other, _, _ in out]), title, group))
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
    """Panels with a method that has a run; methods in one order, rbtm last."""
    settings = labels.varying(runs, "backend")
    names = method_names(runs)
    panels: dict[str, dict[str, list[Run]]] = {}
    for run in runs:
        panels.setdefault(", ".join([labels.choice(run, "backend"), *settings[run]]), {})
    for run in sorted(runs, key=labels.method_order):
        panel = ", ".join([labels.choice(run, "backend"), *settings[run]])
        panels[panel].setdefault(names[run], []).append(run)
    out = []
    for panel, methods in panels.items():
        all_methods = [_method(name, members) for name, members in methods.items()]
        out.append(Panel(panel, [method for method in all_methods if method.runs]))
    return [panel for panel in out if panel.methods]


def _method(name: str, runs: list[Run]) -> Method:
    done = sorted((run for run in runs if run.done), key=labels.seed_order)
    return Method(name, labels.choice(runs[0], "selector"), done, len(runs) - len(done))


def method_names(runs: Sequence[Run]) -> dict[Run, str]:
    """Every run's method, without its backend; equal for runs that differ in their seed alone."""
    names = labels.method_names(runs)
    names.update({run: "whole system" for run in runs if labels.is_system(run)})
    keys: dict[tuple[str, str], set[str]] = {}
    for run in runs:
        place = (names[run], labels.key_of(run, ("backend",)))
        keys.setdefault(place, set()).add(run.method)
    if all(len(variants) == 1 for variants in keys.values()):
        return names
    words = frame.labels(runs)
    return {
        run: ", ".join(filter(None, [name, words[run.path]]))
        if len(keys[name, labels.key_of(run, ("backend",))]) > 1
        else name
        for run, name in names.items()
    }
