"""The points of a comparison: every chosen plug-in with every setting that it declares.

Plain Hydra refuses ``selector=previous,rbtm selector.window=10`` because "previous" has no
window. Here an override applies to every chosen member that declares its key.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydra.core.override_parser.types import Override, QuotedString, Transformer
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.kinds import Kind
from rbtm_bench.core.wording import shown, suggestion
from rbtm_bench.runs.declared import GROUPS, kind_of
from rbtm_bench.runs.identity import idle_settings
from rbtm_bench.runs.settings import (
    Settings,
    compose_settings,
    composed,
    composing,
    explain,
    from_hydra,
    parsed,
)

LONGEST_NAME = 120
"""Characters of a point's name, which is a folder's: file systems take 255 bytes."""


@dataclass(frozen=True)
class Point:
    """One run of a comparison. ``gaps_of`` names the point whose gaps a random_gap draws."""

    name: str
    settings: Settings
    gaps_of: str | None = None


def make_points(
    words: list[str], extra_dirs: tuple[Path, ...] = ()
) -> tuple[list[Point], list[str]]:
    """The grid of overrides with comma lists, and notes on points that coincide.

    Raises ``ConfigError`` for a key that no chosen member declares, or any bad value.
    """
    words, notes = one_way_to_run(words, extra_dirs)
    used: set[str] = set()
    points: list[tuple[Settings, list[str]]] = []
    with composing(extra_dirs) as extra:
        groups, keys, additions = _sort_overrides(words)
        declared: list[DictConfig] = []
        for combination in itertools.product(*groups.values()):
            chosen = [f"{g}={m}" for g, m in zip(groups, combination, strict=True)]
            base = composed(chosen + additions + extra)
            idle = _idle(base)
            declared.append(OmegaConf.masked_copy(base, [str(k) for k in base if k not in idle]))
            own = {key: values for key, values in keys.items() if _declares(declared[-1], key)}
            used |= own.keys()
            if (
                "selector" not in idle
            ):  # a similarity that no selector reads may be set all the same
                used |= {key for key in keys if _declares(base, key)}
            notes += _note(chosen, groups, keys, own, idle)
            if any(f"{g}={groups[g][0]}" not in chosen for g in groups if g in idle):
                continue  # the same as with the first member of those groups
            for values in itertools.product(*own.values()):
                overrides = [f"{k}={shown(v)}" for k, v in zip(own, values, strict=True)]
                settings = _settings(base, own, values, chosen + additions + overrides)
                points.append((settings, _label(settings, groups, own, values)))
        for key in keys:
            if key not in used:
                raise ConfigError(_nobody_declares(key, declared))
    merged = _merge(points, notes)
    merged.sort(key=lambda point: point[0].config["replicate"])  # a copy of the data at a time
    return _named(merged), list(dict.fromkeys(notes))


def one_way_to_run(
    words: list[str], extra_dirs: tuple[Path, ...] = ()
) -> tuple[list[str], list[str]]:
    """The overrides with one value of every setting that says how runs are executed, and a note
    where there were more: such points give the same. ``replicates=N`` becomes the list of them.
    Raises ``ConfigError`` for several folders, or replicates that are asked for twice."""
    kept, notes = [], []
    for override in parsed(words):
        word, key = str(override.input_line), override.key_or_group
        if kind_of(key) is Kind.HOW and override.is_sweep_override():
            values = [shown(value) for value in _values(override)]
            if key == "out":
                raise ConfigError(f"{word}: a comparison has one value of out")
            notes.append(
                f"merged: {key} is how runs are executed, not what they give: "
                f"its {len(values)} points are one, {key}={values[0]}"
            )
            word = f"{word.partition('=')[0]}={values[0]}"
        kept.append(word)
    return [*_replicates(kept, extra_dirs), *kept], notes


def _replicates(words: list[str], extra_dirs: tuple[Path, ...]) -> list[str]:
    """The word that makes every run and its replicates, if ``words`` or the experiment that they
    add ask for more than one."""
    named = {w.lstrip("+").partition("=")[0]: w.partition("=")[2] for w in words}
    wanted = named.get("replicates", "1")
    experiments = [word for word in words if word.startswith("+experiment")]
    if experiments and "replicates" not in named:
        with composing(extra_dirs) as extra:
            wanted = str(composed([*experiments, *extra]).get("replicates"))
    number = int(wanted) if wanted.isdecimal() else 1  # anything else is refused with its setting
    if number < 2:
        return []
    if "replicate" in named:
        raise ConfigError(
            f"replicate={named['replicate']}: replicates={number} makes all of them; give one"
        )
    return [f"replicate={','.join(map(str, range(number + 1)))}"]


def check_values(words: list[str], extra_dirs: tuple[Path, ...] = ()) -> Settings:
    """Check every value of a sweep's lists by itself, beside the first of all others.

    Returns the sweep's first point. Raises ``ConfigError`` before anything has run.
    """
    return values_beside_first(words, extra_dirs)[0]


def values_beside_first(words: list[str], extra_dirs: tuple[Path, ...] = ()) -> list[Settings]:
    """A sweep's first point, and those that differ from it in one value: every value is among
    them, at the cost of the lists' sum, not of their product.

    Raises ``ConfigError`` for any value that is wrong.
    """
    with composing(extra_dirs):
        overrides = parsed([word for word in words if not word.startswith("hydra")])
        lists = [
            [f"{str(o.input_line).partition('=')[0]}={v}" for v in _listed(o)]
            if o.is_sweep_override()
            else [str(o.input_line)]
            for o in overrides
        ]
    first = [values[0] for values in lists]
    points = [compose_settings(first, extra_dirs)]
    for position, values in enumerate(lists):
        for value in values[1:]:
            one = [*first[:position], value, *first[position + 1 :]]
            points.append(compose_settings(one, extra_dirs))
    return points


def _sort_overrides(
    words: list[str],
) -> tuple[dict[str, list[str]], dict[str, list[Any]], list[str]]:
    """Group choices, key values, and additions or deletions (``+a=1``, ``~a``), in order."""
    groups: dict[str, list[str]] = {}
    keys: dict[str, list[Any]] = {}
    additions: list[str] = []
    for override in parsed(words):
        key = override.key_or_group
        if override.is_add() or override.is_delete() or override.is_force_add():
            if override.is_sweep_override():
                raise ConfigError(f"{override.input_line}: a list of values cannot be added")
            additions.append(str(override.input_line))
        elif key in GROUPS:
            groups[key] = [shown(value) for value in _values(override)]
        else:
            keys[key] = _values(override)
    return groups, keys, additions


def _values(override: Override) -> list[Any]:
    """The values of one override, as plain data."""
    if not override.is_sweep_override():
        return [override.value()]
    return [_unquoted(value) for value in _listed(override, Transformer.identity)]


def _listed(override: Override, transformer: Any = Transformer.str) -> list[Any]:
    """The values of a list, range, choice or glob; an interval has none that can be listed."""
    try:
        return list(override.sweep_iterator(transformer=transformer))
    except HydraException as error:
        raise ConfigError(f"{override.input_line}: {explain(error)}") from error


def _unquoted(value: Any) -> Any:
    """Quoted words as plain text, at any depth."""
    if isinstance(value, QuotedString):
        return value.text
    if isinstance(value, list):
        return [_unquoted(item) for item in value]
    if isinstance(value, dict):
        return {key: _unquoted(item) for key, item in value.items()}
    return value


def _declares(config: DictConfig, key: str) -> bool:
    node: Any = config
    for part in key.split("."):
        if not isinstance(node, DictConfig) or part not in node.keys():  # noqa: SIM118 (also ???)
            return False
        node = node._get_node(part)
    return True


def _idle(config: Any) -> tuple[str, ...]:
    """The groups and settings outside groups that do nothing for the chosen backend or selector."""
    plain = OmegaConf.to_container(config, resolve=False)
    assert isinstance(plain, dict)
    config = {str(key): node for key, node in plain.items() if key != "hydra"}
    return tuple(name for name in idle_settings(config) if "." not in name)


def _settings(
    base: DictConfig, keys: dict[str, list[Any]], values: Iterable[Any], overrides: list[str]
) -> Settings:
    config = base.copy()
    with open_dict(config):
        for key, value in zip(keys, values, strict=True):
            OmegaConf.update(config, key, value, force_add=True)
    return from_hydra(config, tuple(overrides))


def _label(
    settings: Settings,
    groups: dict[str, list[str]],
    keys: dict[str, list[Any]],
    values: Iterable[Any],
) -> list[str]:
    """What tells this point from the others: the words of its name."""
    label = [
        settings.choices[group] for group in ("backend", "selector") if group in settings.config
    ]
    label += [
        settings.choices[group]
        for group, members in groups.items()
        if group not in ("backend", "selector", *settings.idle) and len(members) > 1
    ]
    label += [
        f"{key.rpartition('.')[2]}={shown(value)}"
        for (key, listed), value in zip(keys.items(), values, strict=True)
        if len(listed) > 1
    ]
    return label


def _merge(
    points: list[tuple[Settings, list[str]]], notes: list[str]
) -> list[tuple[Settings, list[str]]]:
    """One of every set of points with the same settings (a seed that nothing uses included)."""
    kept: dict[str, tuple[Settings, list[str]]] = {}
    for settings, label in points:
        key = settings.identity.run
        if key in kept:
            notes.append(
                f"merged: {' '.join(label) or 'a point'} is the same as "
                f"{' '.join(kept[key][1]) or 'another'}"
            )
        else:
            kept[key] = (settings, label)
    return list(kept.values())


def _named(labelled: list[tuple[Settings, list[str]]]) -> list[Point]:
    """Points with unique names; random_gap once for every rbtm point that it can follow."""
    points: dict[str, Point] = {}

    def add(label: list[str], settings: Settings, gaps_of: str | None = None) -> str:
        stem = re.sub(r"[^\w.=+-]+", "_", "-".join(label), flags=re.ASCII)[:LONGEST_NAME] or "run"
        name, count = stem, 2
        while name in points:
            name, count = f"{stem}-{count}", count + 1
        points[name] = Point(name, settings, gaps_of)
        return name

    waiting = []
    sources: dict[str, list[str]] = {}
    for settings, label in labelled:
        selector = settings.config.get("selector") or {}
        if settings.choices["selector"] == "random_gap" and not (
            selector.get("gaps") or selector.get("gaps_from")
        ):
            waiting.append((settings, label))
            continue
        name = add(label, settings)
        if settings.choices["selector"] == "rbtm":
            sources.setdefault(settings.identity.without("selector", "similarity"), []).append(name)
    for settings, label in waiting:
        followed = sources.get(settings.identity.without("selector", "similarity"), [])
        if not followed:
            raise ConfigError(
                "selector=random_gap draws its gaps from another run: add selector=rbtm to the "
                "comparison, or give selector.gaps_from=<run folder>"
            )
        for source in followed:
            add([*label, *([f"of-{source}"] if len(followed) > 1 else [])], settings, source)
    return list(points.values())


def _note(
    chosen: list[str],
    groups: dict[str, list[str]],
    keys: dict[str, list[Any]],
    own: dict[str, list[Any]],
    idle: tuple[str, ...],
) -> list[str]:
    """Say where a list of values does not apply, so that its points became one. ``idle`` groups
    do nothing for the chosen backend (a whole system) or selector."""
    owner = "backend" if "selector" in idle else "selector"
    member = next((word for word in chosen if word.startswith(f"{owner}=")), owner)
    notes = [
        f"merged: {member} needs no {group}: its {len(members)} points are one"
        for group, members in groups.items()
        if group in idle and len(members) > 1
    ]
    for key, values in keys.items():
        group = key.partition(".")[0]
        group = owner if group in idle else group
        if key not in own and len(values) > 1:
            member = next((word for word in chosen if word.startswith(f"{group}=")), group)
            notes.append(f"merged: {member} has no {key}: its {len(values)} points are one")
    return notes


def _nobody_declares(key: str, configs: list[DictConfig]) -> str:
    parent, _, last = key.rpartition(".")
    known: dict[str, None] = {}
    for config in configs:
        node = OmegaConf.select(config, parent) if parent else config
        if isinstance(node, DictConfig):
            known.update(dict.fromkeys(str(k) for k in node if k not in ("_target_", "hydra")))
    return f"{key}: no chosen member has such a setting.{suggestion(last, list(known))}"
