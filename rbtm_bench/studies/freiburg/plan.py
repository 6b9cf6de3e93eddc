"""What scripts/freiburg_table.py compares: logs, backends, ways to choose the model scan with the
settings that each may choose from, and the runs that this takes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.wording import shown
from rbtm_bench.runs.grid import Point, make_points
from rbtm_bench.runs.installed import planar_backends
from rbtm_bench.runs.settings import Settings

LOGS = {"aces": "ACES", "intel": "Intel", "mit-csail": "MIT CSAIL"}
"""File names without their end, and what tables call them."""
LOG_ENDS = (".clf.gz", ".clf", ".log.gz", ".log")
SYSTEM = "kiss_icp_system"
NOTHING = "none"
SLOW = {"hsm": "5 to 7 ms a registration: about 35 min of processor time for its 48 runs"}
"""Made last, with what it costs (estimated from the first 300 scans of each log)."""
QUICK_BACKENDS = ("open3d_p2p", "plicp", "small_gicp_gicp")
QUICK_SCANS = 1200
COMMON = (
    *("dataset=carmen", "similarity=curvature_circular", "guess=odometry"),
    *("pictures=false", "overwrite=true"),
)
"""With wheel odometry between the two scans as the guess a registration depends on its pair alone,
so that the tries of a backend share what they have in common."""


@dataclass(frozen=True)
class FreiburgWay:
    """A way to choose the model scan; it may choose among the ``values`` of ``knob``."""

    selector: str
    knob: str
    values: tuple[float, ...]
    words: tuple[str, ...] = ()


TRIES = 4
WINDOW = 21
"""Scans, the new one counted: RBTM may look as far back as the largest fixed gap."""

WAYS = (
    # The scan before has nothing of its own to choose, so it gets the matcher's distance (m).
    FreiburgWay("previous", "registration.max_correspondence_distance", (0.2, 0.3, 0.5, 1.0)),
    FreiburgWay("keyframe", "selector.distance", (0.2, 0.3, 0.5, 1.0)),
    FreiburgWay("fixed_gap", "selector.gap", (2, 5, 10, 20)),
    FreiburgWay("rbtm", "selector.threshold", (0.6, 0.7, 0.8, 0.9), (f"selector.window={WINDOW}",)),
)
OF_SYSTEM = FreiburgWay("", "backend.voxel_size", (0.1, 0.2, 0.5, 1.0))
"""KISS-ICP's whole odometry: it has its own map instead of a model scan."""


@dataclass(frozen=True)
class FreiburgSize:
    """How much is run. ``max_scans`` of each log, None: all."""

    backends: tuple[str, ...]
    max_scans: int | None = None
    left_out: tuple[str, ...] = ()


def make_size(quick: bool, backends: str | None, max_scans: int | None) -> FreiburgSize:
    """A size from the command line. Raises ``ConfigError`` for a backend that is not installed."""
    installed = planar_backends()
    chosen = tuple(backends.split(",")) if backends else QUICK_BACKENDS if quick else installed
    for name in chosen:
        if name not in installed:
            raise ConfigError(
                f"--backends {name}: no installed planar backend. Known: {', '.join(installed)}"
            )
    if max_scans is not None and max_scans < 2:
        raise ConfigError(f"--max-scans {max_scans}: expected at least 2")
    left_out = tuple(name for name in installed if name not in chosen)
    return FreiburgSize(chosen, max_scans or (QUICK_SCANS if quick else None), left_out)


def find_logs(folder: Path | None) -> dict[str, tuple[Path, Path]]:
    """The log and the relations of each of ``LOGS``, in the folder or in freiburg/ below it.

    Raises ``DataError`` that names all that is missing.
    """
    if folder is None:
        raise DataError(
            "no logs: set RBTM_BENCH_DATA to the folder that holds freiburg/, or give --data FOLDER"
        )
    if not folder.is_dir():
        raise DataError(f"--data {folder}: no such folder")
    logs_folder = folder / "freiburg" if (folder / "freiburg").is_dir() else folder
    logs, missing = {}, []
    for name in LOGS:
        log = next((f for end in LOG_ENDS if (f := logs_folder / f"{name}{end}").is_file()), None)
        relations = logs_folder / f"{name}.relations"
        missing += [] if log else [f"{name}.clf.gz"]
        missing += [] if relations.is_file() else [relations.name]
        if log:
            logs[name] = (log, relations)
    if missing:
        raise DataError(
            f"{logs_folder}: lacks {', '.join(missing)} (docs/data.md says where they are)"
        )
    return logs


class FreiburgPlan:
    """The runs of all logs. Settings are composed on the first log only: Hydra takes 0.2 s each."""

    def __init__(self, size: FreiburgSize, logs: dict[str, tuple[Path, Path]]) -> None:
        self.size, self.logs = size, logs
        self._known: dict[str, list[tuple[str, Settings]]] = {}

    def points(self, log: str, backends: Iterable[str]) -> list[Point]:
        """The runs of some backends (and ``NOTHING`` and ``SYSTEM``) on a log. Those that follow
        one another differ in their way, so that workers side by side seldom want the same pair."""
        points = []
        for backend in backends:
            if backend not in self._known:
                self._known[backend] = list(self._compose(backend))
            for stem, settings in self._known[backend]:
                points.append(Point(f"{log}-{stem}", _on(settings, self.logs[log])))
        return points

    def _compose(self, backend: str) -> Iterator[tuple[str, Settings]]:
        if backend == NOTHING:
            yield NOTHING, self._settings("backend=none", "selector=previous")[0]
            return
        ways = (OF_SYSTEM,) if backend == SYSTEM else WAYS
        made = []
        for way in ways:
            selector = [f"selector={way.selector}"] if way.selector else []
            tries = f"{way.knob}={','.join(map(shown, way.values))}"
            made.append(self._settings(f"backend={backend}", *selector, *way.words, tries))
        for k in range(TRIES):
            for way, settings in zip(ways, made, strict=True):
                yield stem_of(backend, way, k), settings[k]

    def _settings(self, *words: str) -> list[Settings]:
        log, relations = next(iter(self.logs.values()))
        data = [f"dataset.path='{log}'", f"dataset.relations='{relations}'"]
        data += [f"dataset.max_scans={self.size.max_scans}"] if self.size.max_scans else []
        return [point.settings for point in make_points([*COMMON, *data, *words])[0]]


def stem_of(backend: str, way: FreiburgWay, k: int) -> str:
    """The name of a run without its log: backend, selector, number of the try."""
    return "-".join(filter(None, [backend, way.selector, str(k + 1)]))


def _on(settings: Settings, files: tuple[Path, Path]) -> Settings:
    """The same settings on another log."""
    named = dict(zip(("path", "relations"), map(str, files), strict=True))
    dataset = {**settings.config["dataset"], **named}
    own = [w for w in settings.overrides if w.partition("=")[0][8:] not in named]
    overrides = (*own, *(f"dataset.{key}='{value}'" for key, value in named.items()))
    return replace(settings, config={**settings.config, "dataset": dataset}, overrides=overrides)
