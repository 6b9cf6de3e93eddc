"""The runs of a study: every try of every way on every draw of every data set."""

from __future__ import annotations

import contextlib
import copy
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.wording import shown
from rbtm_bench.runs import controls
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.runs.settings import Settings, check, parsed
from rbtm_bench.runs.stored import Run, read_run
from rbtm_bench.studies.study_file import Study

HOPS = 2.0
"""Scans are half a keyframe distance from their keyframe on average: so mean gaps are equal."""
ALWAYS = ("pictures=false", "overwrite=true", "controls=none")


class Method(NamedTuple):
    """A way with a backend on a data set (of a cell of the axes)."""

    data: str
    backend: str
    way: str


@dataclass(frozen=True)
class Draw:
    """A seed, or a replicate: key and number."""

    key: str
    number: int


@dataclass
class Plan:
    """``known``: the settings of every try of the ways that need no other run. ``points`` gains
    those that follow when their source has ended."""

    study: Study
    known: dict[tuple[Method, int], Settings]
    names: dict[tuple[Method, int, Draw], str]
    points: dict[str, Point]

    @classmethod
    def of(cls, study: Study) -> Plan:
        """Compose everything. Raises ``ConfigError`` for a setting that does not exist."""
        plan = cls(study, {}, {}, {})
        composed: dict[Any, dict[str, list[Settings]]] = {}
        for data, _, _, words in study.cells():
            for backend in study.backends:
                # cells that differ in numbers of the data set alone are composed once
                like = (
                    backend,
                    *(w.partition("=")[0] if "." in w.partition("=")[0] else w for w in words),
                )
                if like not in composed:
                    composed[like] = _composed(study, backend, words)
                for way, tries in composed[like].items():
                    for k, settings in enumerate(tries):
                        plan.known[Method(data, backend, way), k] = _moved(settings, words)
        for (method, k), settings in plan.known.items():
            for draw in plan.draws:
                plan._add(method, k, draw, _drawn(settings, draw))
        return plan

    @property
    def choosing(self) -> list[Draw]:
        """Those that choose: seeds, or on the other data sets the ones that are shown."""
        on = self.study.chosen_on
        return [Draw("seed", seed) for seed in on] if isinstance(on, list) else self.shown

    @property
    def shown(self) -> list[Draw]:
        if self.study.shown is not None:
            return [Draw("seed", seed) for seed in self.study.shown]
        return [Draw("replicate", r + 1) for r in range(self.study.replicates or 0)]

    @property
    def draws(self) -> list[Draw]:
        return list(dict.fromkeys([*self.choosing, *self.shown]))

    def methods(self, *ways: str) -> Iterator[Method]:
        """Every method of these ways (none named: of all), cell by cell."""
        for data, _, _, _ in self.study.cells():
            for backend in self.study.backends:
                yield from (Method(data, backend, way) for way in ways or self.study.ways)

    def follow(self, out: Path) -> list[Point]:
        """The points as far back as finished runs below ``out``: every try of every way that is
        like another, rotations of gaps aside."""
        likes = {n: w for n, w in self.study.ways.items() if w.like and w.selector != "shifted_gap"}
        return [
            point
            for (source, k, draw) in list(self.names)
            for way, one in likes.items()
            if one.like == source.way
            for point in self._like(source, way, k, draw, out)
        ]

    def rotate(self, chosen: Mapping[Method, int], out: Path) -> list[Point]:
        """The points with the gaps of chosen tries, on the draws that are shown, at other times."""
        rotations = [n for n, w in self.study.ways.items() if w.selector == "shifted_gap"]
        return [
            point
            for method in self.methods(*rotations)
            for draw in self.shown
            for source in [method._replace(way=str(self.study.ways[method.way].like))]
            for point in self._like(source, method.way, chosen[source], draw, out)
        ]

    def _like(self, source: Method, way: str, k: int, draw: Draw, out: Path) -> list[Point]:
        """The point like a run. Where it would be that run again, to the bit, it is that run."""
        method, name = source._replace(way=way), self.names[source, k, draw]
        run = read(out / name)
        if run is None or not run.done or not run.metrics.get("mean_gap"):
            return []
        selector = str(self.study.ways[way].selector)
        settings = controls.like(selector, self.points[name], run, hops=HOPS)
        if isinstance(settings, str):
            self.names[method, k, draw] = name
            return []
        return [self._add(method, k, draw, settings)]

    def _add(self, method: Method, k: int, draw: Draw, settings: Settings) -> Point:
        stem = "-".join([*method, str(k + 1), f"{draw.key[:4]}{draw.number}"]).replace(" ", ",")
        self.names[method, k, draw] = stem
        self.points[stem] = Point(stem, settings)
        return self.points[stem]


def _composed(study: Study, backend: str, data: list[str]) -> dict[str, list[Settings]]:
    """Of every way that needs no other run the settings of its tries."""
    ways = {}
    for name, way in ((n, w) for n, w in study.ways.items() if w.like is None):
        tries = study.tries(way)
        lists = {key: ",".join(shown(one[key]) for one in tries) for key in tries[0]}
        lists = {k: ",".join(dict.fromkeys(v.split(","))) for k, v in lists.items()}
        words = [*ALWAYS, *data, *study.words, f"backend={backend}", *way.words]
        words = [word for word in words if word.partition("=")[0] not in lists]
        points, _ = make_points([*words, *(f"{k}={v}" for k, v in lists.items())])
        if len(points) != len(tries):
            raise ConfigError(
                f"ways.{name}: {len(tries)} tries, of which {len(points)} differ with "
                f"backend={backend}: expected settings that it reads"
            )
        ways[name] = [point.settings for point in points]
    return ways


def _moved(settings: Settings, words: list[str]) -> Settings:
    """The settings with other values of the data set's keys. Raises ``ConfigError``."""
    config = copy.deepcopy(settings.config)
    keyed = {o.key_or_group: o for o in parsed(words) if "." in o.key_or_group}
    for key, override in keyed.items():
        *parents, last = key.split(".")
        node = config
        for parent in parents:
            node = node[parent]
        node[last] = override.value()
    check(config)
    others = [word for word in settings.overrides if word.partition("=")[0] not in keyed]
    values = [f"{key}={shown(override.value())}" for key, override in keyed.items()]
    return replace(settings, config=config, overrides=(*others, *values))


def _drawn(settings: Settings, draw: Draw) -> Settings:
    """The settings with a seed, wherever that goes, or the number of a replicate. (Composing takes
    Hydra 0.1 s, and the thousands of runs of a study differ in this number alone.)"""

    def changed(node: Any) -> Any:
        if isinstance(node, dict):
            return {k: draw.number if k == draw.key else changed(v) for k, v in node.items()}
        return node

    words = (*settings.overrides, f"{draw.key}={draw.number}")
    return replace(settings, config=changed(settings.config), overrides=words)


def read(folder: Path) -> Run | None:
    """A run, None where there is none that can be read."""
    with contextlib.suppress(DataError):
        return read_run(folder)
    return None
