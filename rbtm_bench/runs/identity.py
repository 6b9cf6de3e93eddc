"""What makes two runs the same, answered once: for grids, resume, tables, labels and shared work.

Settings carry their kind where they are declared (``core.kinds``, ``runs.declared``). What a
chosen plug-in does not use (a similarity that no selector asks for) is *idle* and tells no runs
apart.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from omegaconf import DictConfig, OmegaConf

from rbtm_bench.core.kinds import Kind
from rbtm_bench.runs.declared import (
    ADDED,
    FOR_PAIRS,
    GROUPS,
    PERTURB,
    PERTURBATION,
    PLUGIN_GROUPS,
    kind_of,
)
from rbtm_bench.runs.plugins import class_of, constructor_parameters, is_system

SEPARATE = (Kind.SEED, Kind.OTHER_RUN)
"""Kinds that replicates of one method may differ in."""


_USUAL = {f"perturbation.{key}": value for key, value in PERTURBATION.items()}
_USUAL |= {f"perturb.{key}": value for key, value in PERTURB.items()}
_USUAL |= {"judge_radius": None, "target.voxel_size": None, "selector.window_m": None}
_USUAL |= {"selector.distance_relative": 0.1, "selector.keyframe_distance_relative": 0.1}
_USUAL |= {"deskew": False, "guess_weight": None}
_USUAL |= {"motion_filter.distance": 0.0, "motion_filter.angle_deg": 0.0}


@dataclass(frozen=True)
class Identity:
    """A run's settings by kind, as dotted keys: ``what``, ``data`` and ``seed`` (seeds and other
    runs' folders). ``choices`` names the groups' members; idle groups are not among them."""

    what: dict[str, Any]
    data: dict[str, Any]
    seed: dict[str, Any]
    choices: dict[str, str]

    @classmethod
    def of(
        cls,
        choices: Mapping[str, str],
        config: Mapping[str, Any],
        special: Mapping[str, Kind],
        idle: Sequence[str],
    ) -> Identity:
        """The identity of resolved settings."""
        parts: dict[Kind, dict[str, Any]] = {kind: {} for kind in Kind}
        for key, value in flat(config):
            if key in _USUAL and value == _USUAL[key]:
                continue  # so that runs from before there were these are what they were
            if not any(key == name or key.startswith(f"{name}.") for name in idle):
                parts[special.get(key, kind_of(key))][key] = value
        seeds = {k: v for k, v in parts[Kind.SEED].items() if k in special}
        folders = {k: _last(v) for k, v in parts[Kind.OTHER_RUN].items() if v is not None}
        if config.get("replicate"):  # its draws depend on the run's seed, used or not
            seeds |= {"replicate": [config["replicate"], config.get("seed")]}
        if any(key.startswith("perturb.") for key in parts[Kind.DATA]):
            seeds |= {"perturb": config.get("seed")}
        kept = {g: name for g, name in choices.items() if g not in idle and ADDED.get(g) != name}
        return cls(parts[Kind.WHAT], parts[Kind.DATA], {**seeds, **folders}, kept)

    @cached_property
    def run(self) -> str:
        """Equal for runs that give the same."""
        return _text([self.method, self.seed])

    @cached_property
    def method(self) -> str:
        """Equal for replicates: runs of one method on the same data, whatever their seed."""
        return _text([self.way, self.dataset])

    @cached_property
    def way(self) -> str:
        """Equal for runs of one method, whatever the data and the seed."""
        others = {group: name for group, name in self.choices.items() if group != "dataset"}
        return _text([others, self.what])

    @cached_property
    def dataset(self) -> str:
        """Equal for runs on the same data, whatever their seed."""
        return self.part("dataset")

    def part(self, *groups: str) -> str:
        """Equal for runs that agree in the choice and the settings of these groups; the data set's
        are those of ``perturb`` as well."""
        if "dataset" in groups and self.settings("perturb"):
            groups = (*groups, "perturb")
        if "dataset" in groups and self.data.get("deskew"):
            return _text(["deskew", *self._parts(groups)])
        return _text(self._parts(groups))

    def _parts(self, groups: Sequence[str]) -> list[Any]:
        return [[self.choices.get(group), self.settings(group)] for group in groups]

    def settings(self, group: str) -> dict[str, Any]:
        """The settings of a group without its name; idle ones, seeds and folders left out."""
        start = f"{group}."
        every = {**self.what, **self.data}
        return {k.removeprefix(start): v for k, v in every.items() if k.startswith(start)}

    def without(self, *groups: str) -> str:
        """Equal for runs that differ in nothing but these groups, and in seeds not even that."""
        parts = (self.choices, self.what, self.data, self.seed)
        kept = [{k: v for k, v in p.items() if k.partition(".")[0] not in groups} for p in parts]
        return _text(kept)


def flat(config: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Settings as dotted keys with values; ``_target_`` follows from the choice."""
    for key, value in config.items():
        if key == "_target_":
            continue
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def special_settings(composed: DictConfig, config: Mapping[str, Any]) -> dict[str, Kind]:
    """The plug-ins' parameters that are a seed or another run's folder: annotated so (``Seed``,
    ``OtherRun``), or taking the run's own seed over (``seed: ${seed}`` in ``composed``)."""
    special: dict[str, Kind] = {}
    raw = OmegaConf.to_container(composed, resolve=False)
    assert isinstance(raw, dict)
    for group in PLUGIN_GROUPS:
        node = config.get(group)
        if not isinstance(node, Mapping) or "_target_" not in node:
            continue
        for key, value in flat(raw.get(group) or {}):
            if str(value) == "${seed}":
                special[f"{group}.{key}"] = Kind.SEED
        for key, parameter in constructor_parameters(group, str(node["_target_"])).items():
            for mark in getattr(parameter.annotation, "__metadata__", ()):
                if mark in SEPARATE:
                    special[f"{group}.{key}"] = mark
    return special


def idle_settings(config: Mapping[str, Any]) -> tuple[str, ...]:
    """The groups and settings that do nothing for the chosen plug-ins.

    A similarity of which neither selector nor loops need scores, and what a plug-in's
    ``idle_settings`` (setting -> (other setting, value), or several such) declares: idle where the
    other has that value; ``...`` stands for any but None.
    """
    if is_system(config):
        return FOR_PAIRS
    idle: list[str] = []
    needs_scores = False
    for group in PLUGIN_GROUPS:
        node = config.get(group)
        made = class_of(group, node) if isinstance(node, Mapping) and "_target_" in node else None
        if made is None or not isinstance(node, Mapping):
            continue
        if group in ("selector", "loops"):
            needs_scores = needs_scores or getattr(made, "needs_scores", group == "selector")
        for key, rule in getattr(made, "idle_settings", {}).items():
            rules = (rule,) if isinstance(rule[0], str) else rule
            if any(_holds(node.get(other), value) for other, value in rules):
                idle.append(f"{group}.{key}")
    return tuple(idle) if needs_scores else ("similarity", *idle)


def _holds(value: Any, expected: Any) -> bool:
    return value is not None if expected is ... else bool(value == expected)


def node_key(*nodes: Any) -> str:
    """Equal for plug-ins made from the same config: what a process may share between runs."""
    return _text(list(nodes))


def differing(
    identities: Sequence[Identity], groups: Sequence[str], skip: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """For every identity what tells it from the others, of these groups and, for "", of the
    settings outside every group: ``{"similarity": "overlap"}`` where the choices differ,
    ``{"backend.kernel": "huber"}`` where runs with the same choice have other values. Keys in
    ``skip`` have columns of their own."""
    labels: list[dict[str, Any]] = [{} for _ in identities]
    for group in groups:
        members: dict[str | None, list[int]] = {}
        for i, one in enumerate(identities):
            members.setdefault(one.choices.get(group), []).append(i)
        if group and len(members) > 1:
            for member, places in members.items():
                for i in places:
                    labels[i] |= {} if member is None else {group: member}
        for places in members.values():
            values = {i: _of_group(identities[i], group) for i in places}
            keys = dict.fromkeys(key for i in places for key in values[i] if key not in skip)
            for key in keys:
                if len({_text(values[i].get(key)) for i in places}) > 1:
                    for i in places:
                        labels[i] |= {key: values[i][key]} if key in values[i] else {}
    return labels


def _of_group(identity: Identity, group: str) -> dict[str, Any]:
    """The settings of a group under their whole keys; of "" those outside every group. What is
    done to the data is the data set's."""
    if group == "dataset":
        return identity.data
    if group:
        return {f"{group}.{key}": value for key, value in identity.settings(group).items()}
    return {k: v for k, v in identity.what.items() if k.partition(".")[0] not in GROUPS}


def _last(path: Any) -> str:
    """A run folder's name, wherever it lies."""
    return str(path).rstrip("/").rpartition("/")[2]


def _text(value: Any) -> str:
    return json.dumps(value, sort_keys=True, default=str)
