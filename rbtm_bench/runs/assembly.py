"""The plug-ins of a run: whether they fit together and with the data, and each built once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from rbtm_bench.backends.base import Backend
from rbtm_bench.backends.system import System
from rbtm_bench.core.errors import (
    ConfigError,
    RbtmBenchError,
)
from rbtm_bench.core.kernels import make_ready
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.in_memory import FirstScan
from rbtm_bench.loops.base import Loops
from rbtm_bench.metrics.base import Metric
from rbtm_bench.odometry.method import Method, MotionFilter, Work
from rbtm_bench.pairs.shared import SharedDataset
from rbtm_bench.pairs.watched import Watch, WatchedWork
from rbtm_bench.runs import first_part, replicate
from rbtm_bench.runs.declared import PLUGIN_GROUPS
from rbtm_bench.runs.plugins import (
    foreign_modules,
    is_system,
    locate,
    unfillable,
)
from rbtm_bench.runs.settings import Settings
from rbtm_bench.selection.thresholded import AUTO

UNSHARED_BYTES = 150e6
"""Remembered of what foreign plug-ins were handed, where no workbench sets its own bound."""
REGISTERING = ("backend", "search")
"""The groups that are one backend to the loop."""
APART = ("dataset", *REGISTERING, "loops")
"""The groups that are no part of what the loop itself asks for."""


@dataclass(frozen=True, eq=False)
class Parts:
    """A run's plug-ins, instantiated. A system is a method by itself. ``work`` is None where the
    plug-ins do all of it themselves."""

    dataset: SharedDataset
    method: Method | System
    metrics: tuple[Metric, ...]
    work: Work | None = None
    determined: first_part.Determined | None = None
    """Settings that followed from the data's first part."""
    loops: Loops | None = None


def instantiate(settings: Settings) -> Parts:
    """The plug-ins of checked settings; opens and validates the data set.

    Raises ``ConfigError`` where parts do not fit together, ``DataError`` for bad data.
    """
    plain = replicate.copy_of(build(settings.config["dataset"]), settings.config)
    check_fit(settings, plain)
    watch = Watch(UNSHARED_BYTES) if foreign_modules(settings.config) else None
    dataset = SharedDataset(plain, 0.0, watch)
    config = settings.config
    if is_system(config):
        config = replicate.with_moved(config, plain)
        return Parts(dataset, build(config["backend"]), build_metrics(config))
    known = first_part.determined(config, dataset, method_of)
    config = replicate.with_moved(first_part.filled(config, known.values), plain)
    method, loops = method_of(config), build(config["loops"])
    work = None if watch is None else WatchedWork(Work(method), watch)
    return Parts(dataset, method, build_metrics(config), work, known, loops)


def method_of(config: Mapping[str, Any], given: Mapping[str, Any] = MappingProxyType({})) -> Method:
    """The method of resolved settings, all of its plug-ins new but for those that are ``given`` by
    group."""
    groups = (group for group in PLUGIN_GROUPS if group not in APART)
    plugins = {g: given[g] if g in given else build(config[g]) for g in groups}
    backend = build_backend(config, given.get("backend"))
    return Method(backend=backend, **plugins, **loop_settings(config))


def method_on(dataset: Dataset, config: Mapping[str, Any], given: Mapping[str, Any]) -> Method:
    """``method_of`` with the settings that follow from the data's first part. Raises
    ``ConfigError`` for a threshold that takes more of the data than the first scan of a stream."""
    if isinstance(dataset, FirstScan) and config["selector"].get("threshold") == AUTO:
        raise ConfigError("selector.threshold=auto looks at the data first: expected a Dataset")
    known = first_part.determined(config, SharedDataset(dataset, 0.0), method_of)
    return method_of(first_part.filled(config, known.values), given)


def loop_settings(config: Mapping[str, Any]) -> dict[str, Any]:
    """The settings of a ``Method`` that are no plug-ins."""
    names = ("guess_along_degenerate", "guess_weight", "judge_points", "judge_radius")
    return {
        **{name: config[name] for name in names},
        "motion_filter": MotionFilter(**config["motion_filter"]),
        "edges_from": build(config["loops"]).covariance_from,
    }


def build_backend(config: Mapping[str, Any], given: Backend | None = None) -> Backend:
    """The backend of resolved settings, or the one that is ``given``, behind their search."""
    plain = build(config["backend"]) if given is None else given
    backend: Backend = build(config["search"]).before(plain)
    return backend


def backend_node(config: dict[str, Any]) -> dict[str, Any]:
    """What tells the registrations of ``build_backend`` from others: with a search both nodes."""
    search = locate("search", config["search"]["_target_"])
    node: dict[str, Any] = config["backend"]
    return {g: config[g] for g in REGISTERING} if getattr(search, "searches", True) else node


def build_metrics(config: dict[str, Any]) -> tuple[Metric, ...]:
    """The metrics of resolved settings."""
    return tuple(build(node) for node in (config.get("metrics") or {}).values())


def check_fit(settings: Settings, dataset: Dataset) -> None:
    """Raise ``ConfigError`` if a chosen plug-in cannot work on the data set.

    Loads no backend library: only a backend's class is looked at.
    """
    config = settings.config
    check_dimensions(settings, dataset.planar)
    if is_system(config):
        return
    guess = build(config["guess"])
    guess.check(dataset)
    if all(config["motion_filter"].values()) and not (guess.needs_odometry or guess.needs_backend):
        raise ConfigError(
            f"motion_filter asks the guess whether the sensor moves, which guess="
            f"{settings.choices.get('guess')} does not measure: expected odometry or chain"
        )
    _check_selector(settings, dataset)


def check_dimensions(settings: Settings, planar: bool, backend: Any = None) -> None:
    """Raise ``ConfigError`` if what registers is not for ``planar`` scans, or for others; a
    ``backend`` that is an object stands for the one of the settings."""
    config = settings.config
    needed = "2d" if planar else "3d"
    for group in REGISTERING[:1] if is_system(config) else REGISTERING:
        given = backend if group == "backend" else None
        plugin = given or locate(group, config[group]["_target_"])
        name = f"={settings.choices.get(group)}" if given is None else ""
        dimensions = getattr(plugin, "dimensions", ("2d", "3d"))  # a factory function has none
        if needed not in dimensions:
            raise ConfigError(
                f"{group}{name} is for {', '.join(dimensions)} only; this data set is {needed}"
            )


def _check_selector(settings: Settings, dataset: Dataset) -> None:
    """Raise ``ConfigError`` if the selector lacks scores, truth or a check that it needs."""
    config, choices = settings.config, settings.choices
    name = f"selector={choices.get('selector')}"
    selector = locate("selector", config["selector"]["_target_"])
    loops = locate("loops", config["loops"]["_target_"])
    if getattr(selector, "needs_scores", False) or getattr(loops, "needs_scores", False):
        similarity = build(config["similarity"])
        similarity.check(dataset)
        if getattr(loops, "needs_scores", False) and similarity.needs_guess:
            raise ConfigError(
                f"loops={choices.get('loops')} looks places up by their descriptors, and "
                f"similarity={choices.get('similarity')} compares under a guess: expected another"
            )
    if getattr(selector, "needs_truth", False) and not dataset.has_ground_truth:
        path = config["dataset"].get("path")
        where = f"dataset={choices.get('dataset')}" + (f" ({path})" if path else "")
        raise ConfigError(
            f"{name} chooses by ground truth, and {where} has none: "
            "expected a data set with the true pose of every scan"
        )
    check = locate("check", config["check"]["_target_"])
    if getattr(selector, "needs_check", False) and getattr(check, "accepts_all", False):
        raise ConfigError(
            f"{name} needs a check, and check={choices.get('check')} accepts everything: "
            "expected one that can reject, such as check=gated"
        )
    if too_few := unfillable(config):
        raise ConfigError(f"{name} {too_few} that target={choices.get('target')} needs")


def build(node: dict[str, Any]) -> Any:
    """Instantiate one plug-in by Hydra, ready to be timed; our own errors come out as they are."""
    import hydra.utils
    from hydra.errors import InstantiationException

    try:
        made = hydra.utils.instantiate(node, _convert_="all")
        make_ready()
        return made
    except InstantiationException as error:
        cause: BaseException | None = error
        while cause is not None:
            if isinstance(cause, RbtmBenchError):
                raise cause from None
            if isinstance(cause, ImportError):
                raise ConfigError(
                    f"{node['_target_']} needs a package that is not there: {cause}; "
                    "see rbtm-bench doctor"
                ) from error
            cause = cause.__cause__ or cause.__context__
        lines = [line for line in str(error).splitlines() if not line.startswith("full_key")]
        raise ConfigError(" ".join(lines)) from error
