"""The controls that a grid with rbtm gets by itself: what else would have done as well?

Beside every run of rbtm stand, with its data, backend, guess, check and target, ``previous`` and
``oldest`` of the same window: known before anything runs (``plan``). What has to be matched follows
when rbtm's runs have ended (``resolve``): a ``keyframe`` and a ``fixed_gap`` as far as rbtm reaches
on average, and its own gaps at other times, ``shifted_gap``. All three are pure functions of runs
that repeat to the bit, so that a resumed grid comes to the same ones.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from omegaconf import OmegaConf

from rbtm_bench.core.columns import MAIN
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.wording import shown
from rbtm_bench.runs.grid import Point
from rbtm_bench.runs.identity import idle_settings, node_key, special_settings
from rbtm_bench.runs.plugins import class_of, is_system, unfillable
from rbtm_bench.runs.settings import Settings
from rbtm_bench.runs.stored import Run, is_number, read_run
from rbtm_bench.selection.fixed_gap import FixedGap
from rbtm_bench.selection.keyframe import Keyframe
from rbtm_bench.selection.oldest import Oldest
from rbtm_bench.selection.previous import Previous
from rbtm_bench.selection.random_gap import gaps_by_scan
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.selection.shifted_gap import ShiftedGap, digest, sequence

ROTATIONS = 19
"""Of which the smallest p is 1 / 20."""
CONTENT = (
    "content",
    "keyframe_distance",
    "keyframe_angle_deg",
    "keyframe_distance_relative",
)
WINDOW = ("window", "window_m", *CONTENT)
"""The settings of rbtm that say what it has to choose from."""

Methods = tuple[tuple[Point, ...], ...]
"""Runs of rbtm by method: those of one differ in seeds and replicates alone."""


@dataclass(frozen=True)
class Matched:
    """A control that follows from the best of ``sources``. ``point`` has its name, and settings to
    plan with in place of the matched ones; ``turn`` is which rotation, 0: none."""

    point: Point
    sources: Methods
    turn: int = 0


@dataclass(frozen=True)
class Controls:
    """The points that are known, those that follow, and lines on what was left out."""

    plain: list[Point]
    matched: list[Matched]
    notes: list[str]

    @property
    def planned(self) -> list[Point]:
        """All of them, with the settings that are known."""
        return [*self.plain, *(control.point for control in self.matched)]

    @property
    def names(self) -> list[str]:
        return [point.name for point in self.planned]


@dataclass(frozen=True)
class Resolved:
    """What became of matched controls: points to run, the names of those that there is nothing to
    run for (equal to another run), and why. Of any other the runs of rbtm are not there."""

    points: list[Point]
    idle: dict[str, str]


NONE = Controls([], [], [])


def plan(points: Sequence[Point]) -> Controls:
    """The controls that are missing beside the points; none with ``controls=none``."""
    ours = [p for p in points if _is_rbtm(p.settings)]
    if not ours or ours[0].settings.config.get("controls") != "auto":
        return NONE
    known = {point.settings.identity.run for point in points}
    plain: list[Point] = []
    matched: list[Matched] = []
    notes: dict[str, None] = {}

    def fits(settings: Settings) -> bool:
        too_few = unfillable(settings.config)
        if too_few:
            choices = settings.choices
            target = f"target={choices['target']} needs"
            notes[f"no control {choices['selector']}: it {too_few} that {target}"] = None
        return not too_few

    for point in ours:
        for made in (previous(point), oldest(point)):
            key = made.identity.run
            if key not in known and fits(made):
                known.add(key)
                plain.append(Point(f"{point.name}.{made.choices['selector']}", made))
    for family in _grouped(ours, lambda p: _family(p.settings)):
        sources = _methods(family)
        for point in _first_of_each(family, lambda p: node_key(p.settings.identity.seed)):
            widest = point.settings.config["selector"].get("window", 10) - 1
            for made in (keyframe(point, 0.3), fixed_gap(point, widest)):
                if fits(made) and not _needs_keyframes(made, point):
                    name = f"{point.name}.{made.choices['selector']}"
                    matched.append(Matched(Point(name, made), sources))
    for group in _grouped(ours, _data_and_backend):
        made, sources = shifted_gap(group[0], {"gaps": [1]}), _methods(group)
        matched += [
            Matched(Point(f"{group[0].name}.shifted_gap-{turn:02}", made), sources, turn)
            for turn in range(1, ROTATIONS + 1)
        ]
    return Controls(plain, matched, list(notes))


def resolve(matched: Sequence[Matched], others: Sequence[Point], out: Path) -> Resolved:
    """The settings of matched controls by the finished runs below ``out``; ``others`` are the runs
    that none of them is to repeat."""
    known = {point.settings.identity.run: point.name for point in others}
    points: list[Point] = []
    idle: dict[str, str] = {}
    seen: dict[int, _Source | None] = {}  # by the very object: many share one
    for control in matched:
        if id(control.sources) not in seen:
            seen[id(control.sources)] = _Source.of(control.sources, out)
        source, name = seen[id(control.sources)], control.point.name
        if source is None:
            continue
        made = _made(control, source)
        if isinstance(made, str):
            idle[name] = made
            continue
        key = made.identity.run
        if key in known:
            idle[name] = f"it is the same as {known[key]}"
            continue
        known[key] = name
        points.append(Point(name, made))
    return Resolved(points, idle)


# --- the controls, each made from a run of rbtm


def previous(point: Point) -> Settings:
    return _beside(point, "previous", Previous, {}, "added")


def oldest(point: Point) -> Settings:
    return _beside(point, "oldest", Oldest, _own(point, WINDOW), "added")


def keyframe(point: Point, distance: float) -> Settings:
    """Its turns stay those of the selector: only the distance is matched."""
    node = {"distance": distance, "angle_deg": 15.0}
    return _beside(point, "keyframe", Keyframe, node, f"matched, {distance:g} m")


def fixed_gap(point: Point, gap: float) -> Settings:
    whole = int(gap) if float(gap).is_integer() else gap
    return _beside(point, "fixed_gap", FixedGap, {"gap": whole}, f"matched, {whole:g}")


def shifted_gap(point: Point, gaps: dict[str, Any]) -> Settings:
    node = {**_own(point, WINDOW), "offset": 1, "gaps_from": None, "gaps_sha256": None}
    return _beside(point, "shifted_gap", ShiftedGap, {**node, "gaps": None, **gaps}, "rotated")


def _own(point: Point, keys: Sequence[str]) -> dict[str, Any]:
    node = point.settings.config["selector"]
    return {key: node[key] for key in keys if key in node}


def _beside(point: Point, name: str, made: type, node: dict[str, Any], how: str) -> Settings:
    """The settings of a run with another selector, all else being equal."""
    settings = point.settings
    selector = {"_target_": f"{made.__module__}.{made.__qualname__}", **node}
    config = {**settings.config, "selector": selector}
    special = {k: v for k, v in settings.special.items() if not k.startswith("selector.")}
    alone = {"selector": selector}
    special |= special_settings(OmegaConf.create(alone), alone)
    words = [w for w in settings.overrides if w.lstrip("+").partition("=")[0] != "selector"]
    words = [w for w in words if not w.startswith("selector.")]
    if not any(word.startswith("check=") for word in words):  # rbtm_verified brings its own
        words.append(f"check={settings.choices['check']}")
    values = [f"selector.{key}={shown(value)}" for key, value in node.items() if value is not None]
    return replace(
        settings,
        config=config,
        choices={**settings.choices, "selector": name},
        overrides=(*words, f"selector={name}", *values),
        special=special,
        idle=idle_settings(config),
        control={"how": how, "of": point.name},
    )


def _made(control: Matched, source: _Source) -> Settings | str:
    """The settings of a matched control, or why there is nothing to run."""
    selector = control.point.settings.choices["selector"]
    if selector == "shifted_gap" and source.error is None:
        return "no error to judge by"
    of = source.point if control.turn else replace(control.point, name=source.point.name)
    return like(selector, of, source.run, max(control.turn, 1))


def like(selector: str, of: Point, run: Run, turn: int = 1, hops: float = 1.0) -> Settings | str:
    """The settings of a control that reaches as far back as a finished ``run``, beside the point
    ``of``, which has the control's own seed; or why there is nothing to run. ``selector``: keyframe
    (every so many of its mean distances, ``hops``), fixed_gap (its mean gap), or shifted_gap
    (rotation number ``turn`` of its gaps)."""
    if selector == "shifted_gap":
        return _rotated(turn, of, run)
    if selector == "keyframe":
        distance = _three_digits(hops * mean_hop(run.path))
        return keyframe(of, distance) if distance > 0 else "rbtm does not move between scans"
    made = fixed_gap(of, max(1.0, _three_digits(float(run.metrics["mean_gap"]))))
    return f"it {unfillable(made.config)} of the target" if unfillable(made.config) else made


def _rotated(turn: int, of: Point, run: Run) -> Settings | str:
    """Rotation number ``turn`` of a run's gaps: drawn without repetition."""
    gaps = sequence(run.path)
    if len(set(gaps)) == 1:
        return "all gaps of rbtm are equal: so are their rotations"
    offsets = np.arange(1, len(gaps))
    rng = np.random.default_rng([ROTATIONS, int(of.settings.config["seed"])])
    drawn = rng.choice(offsets, min(ROTATIONS, len(offsets)), replace=False)
    if turn > len(drawn):
        return f"{len(gaps)} gaps have no more rotations"
    offset = int(drawn[turn - 1])
    folder = {"gaps_from": str(run.path), "gaps_sha256": digest(gaps), "gaps": None}
    return shifted_gap(of, {"offset": offset, **folder})


def mean_hop(run: Path) -> float:
    """Mean distance in m between a registered scan and its model scan, by estimate: what the
    distance of a keyframe rule bounds."""
    position = Trajectory.read_tum(run / "trajectory.tum").T_world_scan[:, :3, 3]
    hops = [(i, i - gap) for i, gap in enumerate(gaps_by_scan(run)) if gap]
    scan, model = np.array(hops).T
    return float(np.linalg.norm(position[scan] - position[model], axis=1).mean())


def _three_digits(value: float) -> float:
    return float(f"{value:.3g}")


# --- the runs of rbtm that they are matched to


@dataclass(frozen=True)
class _Source:
    """The run that is matched: of the best method that of the data as they are and the first seed.
    ``error``: by which column it is the best, None where no run has an error."""

    point: Point
    run: Run
    error: str | None

    @classmethod
    def of(cls, sources: Methods, out: Path) -> _Source | None:
        """None until a run that can be matched is done."""
        methods = [[(p, run) for p in method if (run := _done(out / p.name))] for method in sources]
        runs = [run for method in methods for _, run in method]
        keys = [c.name for c in MAIN if any(is_number(run.metrics.get(c.name)) for run in runs)]
        ranked = []
        for number, (method, planned) in enumerate(zip(methods, sources, strict=True)):
            if method:
                value = _median([run for _, run in method], keys[0]) if keys else 0.0
                ranked.append((len(method) < len(planned), value, number))
        if not ranked:
            return None
        best = methods[min(ranked)[2]]
        point, run = min(best, key=lambda one: one[0].settings.config["replicate"])
        return cls(point, run, keys[0] if keys else None)


def _done(folder: Path) -> Run | None:
    """A finished run of which some scan was registered to another."""
    try:
        run = read_run(folder)
    except DataError:
        return None
    return run if run.done and run.metrics.get("mean_gap") else None


def _median(runs: Sequence[Run], key: str) -> float:
    """Over replicates where there are some, else over seeds."""
    copies = [run for run in runs if run.config.get("replicate")] or runs
    known = [run.metrics.get(key) for run in copies]
    values = [float(value) for value in known if value is not None and is_number(value)]
    return statistics.median(values) if values else float("inf")


def _is_rbtm(settings: Settings) -> bool:
    """Whether a run registers, and to what a threshold on similarity chooses, oldest first."""
    config = settings.config
    if is_system(config):
        return False
    selector = class_of("selector", config["selector"])
    backend = class_of("backend", config["backend"])
    is_rbtm = selector is not None and issubclass(selector, Rbtm)
    return is_rbtm and not getattr(backend, "is_baseline", False)


def _needs_keyframes(made: Settings, point: Point) -> bool:
    """Whether the target would be made of scans where rbtm's is made of keyframes."""
    needed = getattr(class_of("target", made.config["target"]), "needs_nodes", 1)
    return needed > 1 and point.settings.config["selector"].get("content") == "keyframes"


def _family(settings: Settings) -> str:
    """Equal for runs of rbtm that choose from the same, whatever threshold and similarity."""
    one = settings.identity
    choices = {k: v for k, v in one.choices.items() if k not in ("selector", "similarity")}
    window = {k: v for k, v in one.settings("selector").items() if k in WINDOW}
    others = {
        k: v for k, v in one.what.items() if k.partition(".")[0] not in ("selector", "similarity")
    }
    return node_key(choices, window, others, one.data)


def _data_and_backend(point: Point) -> str:
    return node_key(point.settings.identity.dataset, point.settings.choices["backend"])


def _methods(points: Sequence[Point]) -> Methods:
    return tuple(tuple(g) for g in _grouped(points, lambda p: p.settings.identity.method))


def _grouped(points: Sequence[Point], key: Any) -> Iterator[list[Point]]:
    together: dict[str, list[Point]] = {}
    for point in points:
        together.setdefault(key(point), []).append(point)
    yield from together.values()


def _first_of_each(points: Sequence[Point], key: Any) -> list[Point]:
    return [group[0] for group in _grouped(points, key)]
