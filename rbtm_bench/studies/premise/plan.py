"""What scripts/premise.py compares: data, strategies with the settings that each may choose from,
and the runs that this takes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.wording import shown
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.runs.settings import Settings
from rbtm_bench.studies.campaign import with_value
from rbtm_bench.studies.freiburg.plan import LOG_ENDS, LOGS, find_logs

BACKENDS = ("open3d_p2p", "open3d_p2plane", "plicp")
RBTM = ("rbtm", "rbtm_verified", "rbtm_overlap")
"""With the circular curvature, the same with a check, and with the overlap under the guess."""
CHANCE = {
    "random_gap": "rbtm",
    "random_gap_overlap": "rbtm_overlap",
}
"""The gaps of an RBTM's chosen runs in random order; it has that RBTM's setting, and no choice of
its own: so the two differ in what similarity chooses, not in how far back."""
STRATEGIES = ("previous", "keyframe", "fixed_gap", "best", *CHANCE, *RBTM)
"""The methods; each may choose among four settings."""
BOUNDS = ("oracle", "oracle_pose")
"""They see the truth: no methods, and nothing to choose."""
NOTHING = "none"

FIRST_CHOICE = 100
"""Seeds from this one on choose settings; those from 0 on are shown."""
COMMON = ("guess=odometry", "pictures=false", "overwrite=true")
"""With odometry as the guess a registration depends on its pair alone: strategies differ in what
they choose and in nothing else, and share what they have in common."""

OVERLAPS = (0.4, 0.6, 0.75, 0.9)
"""Thresholds that are tried with similarity=overlap."""
CURVATURE = ("dataset=carmen", "similarity=curvature_circular")

Tries = dict[str, tuple[str, tuple[float, ...]]]
"""Of every strategy the setting that it may choose, and its values."""


def tries_of(
    distances: Sequence[float],
    keyframes: Sequence[float],
    gaps: Sequence[float],
    windows: Sequence[float],
    thresholds: Sequence[float],
) -> Tries:
    """Four tries each. The scan before has nothing of its own to choose, so it gets the matcher's
    correspondence distance (m)."""
    threshold = ("selector.threshold", tuple(thresholds))
    return {
        "previous": ("registration.max_correspondence_distance", tuple(distances)),
        "keyframe": ("selector.distance", tuple(keyframes)),
        "fixed_gap": ("selector.gap", tuple(gaps)),
        "best": ("selector.window", tuple(windows)),
        "rbtm": threshold,
        "rbtm_verified": threshold,
        "rbtm_overlap": ("selector.threshold", OVERLAPS),
        "random_gap": threshold,
        "random_gap_overlap": ("selector.threshold", OVERLAPS),
    }


@dataclass(frozen=True)
class Kind:
    """Data sets that choose settings for one another. ``window`` is that of rbtm and of the bounds;
    ``words`` hold for every run. Of ``seeds`` the first choose, the others are shown; none: logs,
    of which each is shown with the settings that the others chose. ``truth``: every scan has a true
    pose, so that a bound exists."""

    name: str
    title: str
    window: int
    tries: Tries
    words: tuple[str, ...]
    truth: bool = True
    seeds: tuple[tuple[int, ...], tuple[int, ...]] | None = None


@dataclass(frozen=True)
class Place:
    """A data set (of a seed, for simulated ones)."""

    kind: Kind
    name: str
    title: str
    words: tuple[str, ...]


SPACING = {"paper": (91, 1.8), "bare": (101, 4.0), "cluttered": (101, 6.0), "l_turn": (127, None)}
"""Scans and length of the path (m; None: all of it): 2 to 6 cm a scan."""
SIMULATED = "simulated"


def corridor_words(environment: str) -> tuple[str, ...]:
    """A simulated environment as overrides of dataset=corridor."""
    scans, length = SPACING[environment]
    words = (f"dataset.environment={environment}", f"dataset.scans={scans}", "dataset.beams=341")
    return (*words, f"dataset.path_length={length:g}") if length else words


def corrected_log(folder: Path, name: str) -> Path:
    """A log with corrected poses, in corrected/ below the folder. Raises ``DataError``."""
    files = [folder / "corrected" / f"{name}-corrected{end}" for end in LOG_ENDS]
    log = next((file for file in files if file.is_file()), None)
    if log is None:
        raise DataError(f"{folder / 'corrected'}: lacks {name}-corrected.log.gz (docs/data.md)")
    return log


def simulated(seeds: int, choosing: int) -> list[Place]:
    """The four simulated environments."""
    kind = Kind(
        SIMULATED,
        "simulated",
        32,
        tries_of(
            (0.1, 0.2, 0.3, 0.5), (0.1, 0.2, 0.4, 0.8), (4, 8, 16, 31), (4, 8, 16, 32),
            (0.3, 0.45, 0.6, 0.75),
        ),
        ("dataset=corridor",),
        seeds=(tuple(range(FIRST_CHOICE, FIRST_CHOICE + choosing)), tuple(range(seeds))),
    )  # fmt: skip
    places = []
    for name in SPACING:
        places.append(Place(kind, name, f"simulated: {name}", corridor_words(name)))
    return places


CORRECTED = {"aces": "ACES", "intel": "Intel", "csail": "MIT CSAIL"}


def corrected(folder: Path, max_scans: int | None) -> list[Place]:
    """The keyframes of the three logs with corrected poses, 0.5 to 0.9 m and 15 to 22 deg apart."""
    kind = Kind(
        "corrected",
        "keyframes of the logs, corrected poses",
        6,
        tries_of(
            (0.2, 0.3, 0.5, 1.0), (1.0, 1.5, 2.0, 3.0), (2, 3, 4, 5), (3, 4, 5, 6),
            (0.3, 0.4, 0.5, 0.6),
        ),
        # they turn by up to 22 deg at a time; these lags were chosen on these very logs
        (*CURVATURE, "similarity.max_lag_deg=30", "similarity.lag_phase=consistent"),
    )  # fmt: skip
    places = []
    for name, title in CORRECTED.items():
        words = [f"dataset.path='{corrected_log(folder, name)}'", *_first(max_scans)]
        places.append(Place(kind, f"{name}-corrected", f"{title}, keyframes", tuple(words)))
    return places


def raw(folder: Path, max_scans: int | None) -> list[Place]:
    """The three raw logs with reference relations: 0.01 to 0.1 m a scan."""
    kind = Kind(
        "raw",
        "raw logs, reference relations",
        21,
        tries_of(
            (0.2, 0.3, 0.5, 1.0), (0.2, 0.3, 0.5, 1.0), (2, 5, 10, 20), (3, 6, 11, 21),
            (0.6, 0.7, 0.8, 0.9),
        ),
        CURVATURE,
        truth=False,
    )  # fmt: skip
    places = []
    for name, (log, relations) in find_logs(folder).items():
        words = [f"dataset.path='{log}'", f"dataset.relations='{relations}'", *_first(max_scans)]
        places.append(Place(kind, name, f"{LOGS[name]}, raw", tuple(words)))
    return places


def _first(max_scans: int | None) -> list[str]:
    return [f"dataset.max_scans={max_scans}"] if max_scans else []


@dataclass(frozen=True)
class Try:
    """A strategy on a place with its ``k``-th setting, as runs without their seed."""

    place: Place
    backend: str
    strategy: str
    k: int
    settings: Settings
    override: str
    source: str | None = None

    @property
    def stem(self) -> str:
        """The name of its runs without the seed."""
        return f"{self.place.name}-{self.backend}-{self.strategy}-{self.k + 1}"


def tries(place: Place, backends: Sequence[str]) -> Iterator[Try]:
    """All of a place's, composed for seed 0."""
    (nothing,) = _compose(place, "backend=none", "selector=previous")
    yield Try(place, NOTHING, NOTHING, 0, nothing.settings, "")
    window = f"selector.window={place.kind.window}"
    for backend in backends:
        for strategy in STRATEGIES:
            yield from _of_strategy(place, backend, strategy, window)
        for by in ("registration", "pose") if place.kind.truth else ():
            words = (f"backend={backend}", "selector=oracle", window, f"selector.by={by}")
            (point,) = _compose(place, *words)
            name = "oracle" if by == "registration" else "oracle_pose"
            yield Try(place, backend, name, 0, point.settings, f"selector.by={by}")


def _of_strategy(place: Place, backend: str, strategy: str, window: str) -> Iterator[Try]:
    knob, values = place.kind.tries[strategy]
    words = [f"backend={backend}", f"{knob}={','.join(map(shown, values))}"]
    if strategy in ("rbtm", "rbtm_verified"):
        words += [f"selector={strategy}", window]
    elif strategy == "rbtm_overlap":
        words += ["selector=rbtm", "similarity=overlap", window]
    elif strategy in CHANCE:  # composed beside the run that it draws from
        words += ["selector=rbtm,random_gap", window]
        words += ["similarity=overlap"] if CHANCE[strategy] == "rbtm_overlap" else []
    else:
        words += [f"selector={strategy}"]
    points = _compose(place, *words)
    by_name = {point.name: point for point in points}
    for point in points:
        source = by_name.get(point.gaps_of or "")
        if strategy in CHANCE and source is None:
            continue
        overrides = (source or point).settings.overrides
        k = next(i for i, v in enumerate(values) if f"{knob}={shown(v)}" in overrides)
        one = Try(place, backend, strategy, k, point.settings, f"{knob}={shown(values[k])}")
        if source is not None:
            one = replace(one, source=replace(one, strategy=CHANCE[strategy]).stem)
        yield one


def _compose(place: Place, *words: str) -> list[Point]:
    kind = place.kind.words
    if "similarity=overlap" in words:  # the kind's settings are of the curvature
        kind = tuple(word for word in kind if not word.startswith("similarity"))
    return make_points([*kind, *place.words, *COMMON, *words])[0]


def points(one: Try, seeds: Sequence[int]) -> list[Point]:
    """The runs of a try, a seed each; on a log, where only random gaps are random, without any."""
    if not seeds:
        return [Point(one.stem, one.settings, one.source)]
    runs = []
    for seed in seeds:
        source = one.source
        if source and one.place.kind.seeds:  # on a log several draws share the one run
            source = f"{source}-{seed}"
        runs.append(Point(f"{one.stem}-{seed}", with_value(one.settings, "seed", seed), source))
    return runs
