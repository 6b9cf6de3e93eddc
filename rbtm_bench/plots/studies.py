"""What a sweep shows of a selector's settings: the error over one or two that vary."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rbtm_bench.plots import labels, style
from rbtm_bench.plots.groups import by_data, file_name, unique
from rbtm_bench.report.replicates import counted
from rbtm_bench.runs.stored import Run

FAVOURITES = ("window", "threshold")
"""The settings to look at where both vary; else the first two that do."""
LOG_FROM = 20.0
"""Largest over smallest number from which on a scale is logarithmic."""


@dataclass(frozen=True, eq=False)
class Cell:
    """The runs at one place: the median of those with an error, and their number."""

    median: float
    known: int
    runs: int
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class StudyPanel:
    """One backend (and what else tells its runs apart). ``cells`` are by the settings' values;
    ``control`` is the error of the selector "previous", None if unknown."""

    name: str
    cells: dict[tuple[float, ...], Cell]
    control: float | None

    @property
    def best(self) -> float:
        """NaN if no cell has an error."""
        return min((c.median for c in self.cells.values() if c.known), default=math.nan)


@dataclass(frozen=True, eq=False)
class SettingsStudy:
    """One data set's runs of one selector: their error over the settings ``axes``."""

    stem: str
    data: str
    selector: str
    axes: tuple[str, ...]
    unit: str
    error: str
    panels: list[StudyPanel]

    @property
    def medians(self) -> list[float]:
        return [c.median for p in self.panels for c in p.cells.values() if c.known]

    def values(self, axis: int) -> list[float]:
        """The values of a setting, ascending."""
        return sorted({place[axis] for panel in self.panels for place in panel.cells})

    @property
    def title(self) -> str:
        over = " and ".join(self.axes)
        runs = max(c.runs for p in self.panels for c in p.cells.values())
        each = labels.unbroken(f"({runs} runs each)")
        medians = f", medians over seeds {each}" if runs > 1 else ""
        of = style.names().of("selector", self.selector)
        return f"{self.data}: {self.error} of {of} over {over}{medians}"


def studies(runs: Sequence[Run]) -> list[SettingsStudy]:
    """What can be drawn, by data set and selector."""
    out: list[SettingsStudy] = []
    for file, name, group in by_data(runs):
        main_error = labels.main_error([run for run in group if run.done])
        if main_error is None:
            continue
        group = [run for run in group if not run.record.get("control")] or group
        real = [run for run in group if labels.choice(run, "backend") != "none"] or group
        controls = _controls(real, main_error[0])
        for selector in dict.fromkeys(labels.choice(run, "selector") for run in real):
            chosen = [run for run in real if labels.choice(run, "selector") == selector]
            axes = _axes(chosen)
            if axes:
                stem = file if selector == "rbtm" else file_name(f"{file}-{selector}")
                stem = unique(stem, [study.stem for study in out])
                panels = _panels(chosen, real, axes, main_error[0], controls)
                out.append(
                    SettingsStudy(stem, name, selector, axes, main_error[1], main_error[2], panels)
                )
    return [study for study in out if study.medians]


def _axes(runs: Sequence[Run]) -> tuple[str, ...]:
    """The one or two numeric settings to draw over; none if none varies."""
    numbers = [labels.numbers(run, "selector") for run in runs]
    known = [key for key in numbers[0] if all(key in settings for settings in numbers)]
    varying = [key for key in known if len({settings[key] for settings in numbers}) > 1]
    return FAVOURITES if set(FAVOURITES) <= set(varying) else tuple(varying[:2])


def _base_names(runs: Sequence[Run]) -> dict[Run, str]:
    """The backend, and what else but selector and similarity tells the runs apart."""
    settings = labels.varying(runs, "backend")
    others = labels.distinctions(runs, ("guess", "search", "check", "recovery", "target"))
    return {
        run: ", ".join([labels.word(run, "backend"), *settings[run], *others[run]]) for run in runs
    }


def _controls(runs: Sequence[Run], key: str) -> dict[str, float]:
    """The median error of the selector "previous" by base name."""
    names = _base_names(runs)
    errors: dict[str, list[float]] = {}
    for run in runs:
        number = labels.value(run, key) if run.done else None
        if labels.choice(run, "selector") == "previous" and number is not None:
            errors.setdefault(names[run], []).append(number)
    return {name: float(np.median(numbers)) for name, numbers in errors.items()}


def _panels(
    chosen: Sequence[Run],
    everything: Sequence[Run],
    axes: tuple[str, ...],
    key: str,
    controls: dict[str, float],
) -> list[StudyPanel]:
    base = _base_names(everything)
    own = labels.distinctions(chosen, ("similarity",))
    others = labels.varying(chosen, "selector", skip=(*axes, "gaps", "gaps_from"))
    groups: dict[tuple[str, str], dict[tuple[float, ...], list[Run]]] = {}
    for run in chosen:
        numbers = labels.numbers(run, "selector")
        name = ", ".join([base[run], *own[run], *others[run]])
        place = tuple(numbers[axis] for axis in axes)
        groups.setdefault((name, base[run]), {}).setdefault(place, []).append(run)
    return [
        StudyPanel(
            name, {p: _cell(members, key) for p, members in places.items()}, controls.get(under)
        )
        for (name, under), places in groups.items()
    ]


def _cell(runs: Sequence[Run], key: str) -> Cell:
    errors = [n for r in counted(runs) if r.done and (n := labels.value(r, key)) is not None]
    if not errors:
        return Cell(math.nan, 0, len(runs), math.nan, math.nan)
    return Cell(float(np.median(errors)), len(errors), len(counted(runs)), min(errors), max(errors))
