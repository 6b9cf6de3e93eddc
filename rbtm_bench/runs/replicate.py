"""A replicate of a run: its copy of the data, and its nuisance settings.

A setting of 0.3 m stands for about 0.3 m. So that no method wins by a lucky last digit, replicates
move distances and thresholds a little; methods with a setting of the same name get the same draw.
"""

from __future__ import annotations

import typing
from collections.abc import Iterator, Mapping
from typing import Any

from rbtm_bench.core.kinds import Nuisance
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.degraded import Degradation, degraded
from rbtm_bench.datasets.deskewed import deskewed
from rbtm_bench.datasets.perturbed import Amounts, Perturbed, generator
from rbtm_bench.runs.declared import PERTURBATION, PLUGIN_GROUPS, Perturbation
from rbtm_bench.runs.plugins import constructor_parameters


def amounts(config: Mapping[str, Any]) -> Perturbation:
    """How far the run's replicates go."""
    given: Perturbation = config.get("perturbation") or PERTURBATION
    return given


def of_data(config: Mapping[str, Any]) -> Amounts:
    """The part of it that concerns the data."""
    by = amounts(config)
    return Amounts(by["ranges"], by["odometry"], by["start_scans"])


def degradation(config: Mapping[str, Any]) -> Degradation:
    """What the run does to its data."""
    return Degradation(**(config.get("perturb") or {}))


def drawn(config: Mapping[str, Any]) -> list[Any] | None:
    """All that tells the run's copy of a data set from the data set; None: there is no copy."""
    by = degradation(config).changed()
    still = bool(config.get("deskew"))
    if not by and not still and not config.get("replicate"):
        return None
    return [
        by,
        *(["deskew"] if still else []),
        *(config.get(key) for key in ("replicate", "seed", "perturbation")),
    ]


def copy_of(dataset: Dataset, config: Mapping[str, Any]) -> Dataset:
    """The run's copy of a data set: what ``perturb`` makes of it, that without the
    motion within sweeps (``deskew``), and of that the replicate. The
    data set itself for replicate 0 of data as they are."""
    dataset = degraded(dataset, degradation(config), config.get("seed", 0))
    dataset = deskewed(dataset, bool(config.get("deskew")))
    if not config.get("replicate"):
        return dataset
    return Perturbed(dataset, config["seed"], config["replicate"], of_data(config))


def moved_settings(config: Mapping[str, Any], dataset: Dataset) -> dict[str, Any]:
    """The nuisance settings of the run, dotted, that its replicate moves: their values in it."""
    draw = dataset.draw
    if draw is None:
        return {}
    by, moved = amounts(config), {}
    for key, value, nuisance in nuisances(config):
        name = key.rpartition(".")[2]
        rng = generator(draw["of"], draw["seed"], draw["number"], "setting", name)
        at = float(rng.uniform(-1.0, 1.0))
        if nuisance is Nuisance.DISTANCE and by["distances"] > 0:
            moved[key] = value * (1.0 + by["distances"] * at)
        elif nuisance is Nuisance.THRESHOLD and by["thresholds"] > 0:
            lowest = 0.0 if value >= 0 else -1.0  # a share has no sign
            moved[key] = min(max(value + by["thresholds"] * at, lowest), 1.0)
    return moved


def nuisances(config: Mapping[str, Any]) -> Iterator[tuple[str, float, Nuisance]]:
    """The plug-ins' settings that are annotated as a nuisance: dotted key, value and kind."""
    for group in PLUGIN_GROUPS:
        node = config.get(group)
        if group == "dataset" or not isinstance(node, Mapping) or "_target_" not in node:
            continue
        for key, parameter in constructor_parameters(group, str(node["_target_"])).items():
            value, nuisance = node.get(key), _nuisance(parameter.annotation)
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if nuisance is not None and number:
                yield f"{group}.{key}", float(typing.cast(float, value)), nuisance


def _nuisance(annotation: Any) -> Nuisance | None:
    """The mark of an annotation, or of a member of a union."""
    marks = [m for m in getattr(annotation, "__metadata__", ()) if isinstance(m, Nuisance)]
    if marks:
        return marks[0]
    return next(filter(None, map(_nuisance, typing.get_args(annotation))), None)


def with_moved(config: Mapping[str, Any], dataset: Dataset) -> dict[str, Any]:
    """The run's config as its plug-ins are made from it. What is written and compared stays as
    asked for: a replicate is another run of the same way."""
    made = dict(config)
    for key, value in moved_settings(config, dataset).items():
        group, _, name = key.partition(".")
        made[group] = {**made[group], name: value}
    return made
