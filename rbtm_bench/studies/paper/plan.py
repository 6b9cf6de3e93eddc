"""What scripts/reproduce_paper.py compares: Table I, the grid of the ratio and the open settings;
and the runs that this takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.wording import shown
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.runs.installed import planar_backends
from rbtm_bench.runs.settings import Settings
from rbtm_bench.studies.campaign import with_value
from rbtm_bench.studies.paper.ways import NOISE_MM, PaperWay, make_ways

PAPER_BACKEND = "open3d_p2p"
"""Point-to-point ICP, the paper's matcher."""
FEWEST_SCANS = 10
FIRST_CHOICE = 100
"""Seeds from this one on choose settings; those from 0 on are shown."""
SHOWN_BEAMS = (681, 676, 686, 671, 691)
CHOICE_BEAMS = (661, 701, 651, 711, 641)
"""Without noise nothing is random, so sensors with other beams take the place of seeds."""

QUICK_BACKENDS = (
    PAPER_BACKEND, "open3d_p2plane", "open3d_gicp", "open3d_symmetric", "kiss_icp", "ndt_2d",
    "psm", "plicp",
)  # fmt: skip

RATIO = ("standard", "circular", "fixed_gap")
"""The rows that the picture of the ratio is made of."""

COMMON = (
    "dataset=corridor",
    # The last motion again: what a robot without odometry has. It depends on the trajectory so
    # far, so runs share few registrations; guesses that they could share are among OPEN below.
    "guess=constant_velocity",
    "overwrite=true",
)


@dataclass(frozen=True)
class Change:
    """One open setting, changed by itself; ``rbtm_only`` where the standard way has no such."""

    what: str
    words: tuple[str, ...]
    quick: bool = False
    rbtm_only: bool = False


UNCHANGED = "nothing"
AHEAD = ("dataset.field_of_view_deg=40", "dataset.range_noise=0.03")
SPARSE = ("dataset.field_of_view_deg=40", "dataset.range_noise=0.05", "dataset.beams=61")
OPEN = (
    Change(UNCHANGED, (), quick=True),
    Change("sensor: 181 beams", ("dataset.beams=181",), quick=True),
    Change("sensor: 180 deg", ("dataset.field_of_view_deg=180",)),
    Change("sensor: 60 deg", ("dataset.field_of_view_deg=60",)),
    Change("sensor: 40 deg", ("dataset.field_of_view_deg=40",), quick=True),
    Change("sensor: range 30 m", ("dataset.max_range=30",)),
    Change("noise: 3 mm", ("dataset.range_noise=0.003",), quick=True),
    Change("noise: 30 mm", ("dataset.range_noise=0.03",), quick=True),
    Change("noise: 50 mm", ("dataset.range_noise=0.05",)),
    Change("noise: 30 mm, sensor: 40 deg", AHEAD, quick=True),
    Change("noise: 50 mm, sensor: 40 deg, 61 beams", SPARSE),
    Change("guess: identity", ("guess=identity",), quick=True),
    Change("guess: chain", ("guess=chain",)),
    Change("guess: odometry", ("guess=odometry",)),
    Change("ICP: 5 iterations", ("backend.max_iterations=5",)),
    Change("ICP: distance 1 m", ("registration.max_correspondence_distance=1.0",)),
    Change("window: 4 scans, as in Fig. 2", ("selector.window=4",), quick=True, rbtm_only=True),
    Change("fallback: best", ("selector.fallback=best",), rbtm_only=True),
    Change("fallback: skip", ("selector.fallback=skip",), rbtm_only=True),
    Change(
        "place: cluttered room", ("dataset.environment=cluttered", "dataset.path_length=1.8"), True
    ),
    Change(
        "place: corridor with a turn", ("dataset.environment=l_turn", "dataset.path_length=1.8")
    ),
)


@dataclass(frozen=True)
class PaperSize:
    """How much is run. ``grid_*`` are the axes of the ratio; distances in m."""

    quick: bool
    seeds: int
    choice_seeds: int
    scans: int
    backends: tuple[str, ...]
    grid_scans: tuple[int, ...]
    grid_noise_mm: tuple[float, ...]
    grid_distance: tuple[float, ...]
    grid_seeds: int
    left_out: tuple[str, ...] = ()

    def replicates(self, noise_mm: float, choosing: bool) -> tuple[str, tuple[int, ...]]:
        """What tells data sets of one kind apart, and its values: seeds, or beams without noise."""
        count = self.choice_seeds if choosing else self.seeds
        if noise_mm > 0:
            first = FIRST_CHOICE if choosing else 0
            return "seed", tuple(range(first, first + count))
        return "dataset.beams", (CHOICE_BEAMS if choosing else SHOWN_BEAMS)[:count]


FULL = PaperSize(
    False, 20, 5, 181, (), (19, 37, 91, 181, 361), (0, 3, 10, 30), (0.1, 0.2, 0.3, 0.5, 1.0), 10
)
QUICK = PaperSize(True, 5, 2, 181, QUICK_BACKENDS, (19, 61, 181), (0, 10), (0.1, 0.3, 1.0), 3)


def make_size(
    quick: bool, seeds: int | None, scans: int | None, backends: Sequence[str] | None
) -> PaperSize:
    """A size with what the command line changes of it. Fewer scans bound the ratio's grid too.

    Raises ``ConfigError`` for numbers that are too small, or seeds that choose settings.
    """
    if seeds is not None and not 1 <= seeds <= FIRST_CHOICE:
        raise ConfigError(f"--seeds {seeds}: expected 1 to {FIRST_CHOICE}: later ones choose")
    if scans is not None and scans < FEWEST_SCANS:
        raise ConfigError(f"--scans {scans}: expected at least {FEWEST_SCANS}")
    if backends and PAPER_BACKEND not in backends:
        raise ConfigError(f"--backends {','.join(backends)}: must hold {PAPER_BACKEND}")
    size = QUICK if quick else FULL
    installed = planar_backends(PAPER_BACKEND)
    chosen = tuple(backends or size.backends or installed)
    size = replace(
        size, backends=chosen, left_out=tuple(name for name in installed if name not in chosen)
    )
    if seeds is not None:
        choice, grid = min(size.choice_seeds, seeds), min(size.grid_seeds, seeds)
        size = replace(size, seeds=seeds, choice_seeds=choice, grid_seeds=grid)
    if scans is not None:
        grid_scans = tuple(n for n in size.grid_scans if n < scans)
        size = replace(size, scans=scans, grid_scans=(*grid_scans, scans))
    return size


Replicates = tuple[str, Sequence[int]]
"""A key that tells data sets of one kind apart, and its values."""


@dataclass
class PlannedRuns:
    """The runs to make, by name: one that several figures need is made once."""

    points: dict[str, Point] = field(default_factory=dict)

    def add(self, stem: str, settings: Settings, replicates: Replicates) -> list[str]:
        """Add a run for every replicate; returns their names."""
        key, values = replicates
        names = [f"{stem}-{value}" for value in values]
        for name, value in zip(names, values, strict=True):
            self.points[name] = Point(name, with_value(settings, key, value))
        return names

    def follow(self, stem: str, source: str, settings: Settings, replicates: Replicates) -> None:
        """Add runs that draw the gaps of the runs ``source``."""
        for name, value in zip(self.add(stem, settings, replicates), replicates[1], strict=True):
            self.points[name] = replace(self.points[name], gaps_of=f"{source}-{value}")


def compose(*words: str) -> list[Point]:
    """The grid of overrides, checked, for seed 0."""
    return make_points([*COMMON, *words])[0]


class TableOne:
    """The runs of Table I, composed once for the seeds that choose and those that are shown."""

    def __init__(self, size: PaperSize) -> None:
        self.size, self.ways = size, make_ways(size.scans)
        self._settings: dict[tuple[str, int, str], Settings] = {}
        for way in self.ways.values():
            words = [f"backend={','.join(size.backends)}", *data_words(size.scans, way.noise_mm)]
            tries = f"{way.knob}={','.join(map(shown, way.values))}"
            points = {p.name: p for p in compose(*words, "pictures=false", *way.words, tries)}
            for point in points.values():
                source = points.get(point.gaps_of or "")
                if way.key == "random_gap" and source is None:
                    continue  # the RBTM run that it draws from: composed as "circular"
                overrides = (source or point).settings.overrides
                k = next(k for k in range(len(way.values)) if way.tried(k) in overrides)
                backend = point.settings.choices["backend"]
                self._settings[way.key, k, backend] = point.settings

    def settings(self, way: str, k: int, backend: str) -> Settings:
        """Of a row's ``k``-th try, for seed 0."""
        return self._settings[way, k, backend]

    def add(self, runs: PlannedRuns, way: str, k: int, backend: str, choosing: bool) -> list[str]:
        """Add the runs of a row's ``k``-th try; returns their names."""
        replicates = self.size.replicates(self.ways[way].noise_mm, choosing)
        stem = stem_of(way, k, backend)
        names = runs.add(stem, self._settings[way, k, backend], replicates)
        if way == "random_gap":
            self.add(runs, "circular", k, backend, choosing)
            source = stem_of("circular", k, backend)
            runs.follow(stem, source, self._settings[way, k, backend], replicates)
        return names


def stem_of(way: str, k: int, backend: str) -> str:
    """The name of a run of Table I without its seed: way, number of the try, backend."""
    return f"{way}-{k + 1}-{backend}"


def data_words(scans: int, noise_mm: float) -> list[str]:
    return [f"dataset.scans={scans}", f"dataset.range_noise={noise_mm / 1000:g}"]


def add_ratio(
    runs: PlannedRuns, size: PaperSize, chosen: Mapping[str, int]
) -> list[dict[str, Any]]:
    """Add the runs of the ratio's grid; returns its cells with the runs' names by way.

    Standard, RBTM and the fixed gap with the paper's ICP; the latter two with the settings that
    Table I chose (``chosen``: number of the try by way), as lengths.
    """
    few = replace(size, seeds=size.grid_seeds)
    cells: list[dict[str, Any]] = []
    for scans, noise in product(size.grid_scans, size.grid_noise_mm):
        group: list[dict[str, Any]] = [
            {"scans": scans, "noise_mm": noise, "distance_m": distance}
            for distance in size.grid_distance
        ]
        distances = ",".join(f"{distance:g}" for distance in size.grid_distance)
        for way in RATIO:
            words = [*data_words(scans, noise), *chosen_words(make_ways(scans)[way], chosen)]
            key = "registration.max_correspondence_distance"
            points = compose(*words, "pictures=false", f"{key}={distances}")
            for cell, point in zip(group, points, strict=True):
                stem = f"ratio-{way}-{scans}-{noise:g}mm-{cell['distance_m']:g}m"
                cell[way] = runs.add(stem, point.settings, few.replicates(noise, choosing=False))
        cells += group
    return cells


def add_open(runs: PlannedRuns, size: PaperSize, chosen: Mapping[str, int]) -> list[dict[str, Any]]:
    """Add the runs with one open setting changed; returns the changes with the runs' names.

    The distance is 0.3 m, as in all rows of Table I but the standard ICP's, which chose its own.
    """
    rows = []
    for change in OPEN:
        if size.quick and not change.quick:
            continue
        row: dict[str, Any] = {"change": change.what}
        keys = [word.partition("=")[0] for word in change.words]
        for way in ("circular",) if change.rbtm_only else ("standard", "circular"):
            words = data_words(size.scans, NOISE_MM)
            words += chosen_words(make_ways(size.scans)[way], chosen)
            words = [word for word in words if word.partition("=")[0] not in keys]
            (point,) = compose(*words, "pictures=false", *change.words)
            stem = f"open-{way}-" + "".join(c if c.isalnum() else "_" for c in change.what)
            row[way] = runs.add(stem, point.settings, size.replicates(NOISE_MM, choosing=False))
        rows.append(row)
    return rows


def chosen_words(way: PaperWay, chosen: Mapping[str, int]) -> list[str]:
    """A row's overrides with the paper's ICP; of its choice what the model scan depends on."""
    own = [] if way.key.startswith("standard") else [way.tried(chosen[way.key])]
    return [f"backend={PAPER_BACKEND}", *way.words, *own]
