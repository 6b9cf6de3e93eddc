"""From the words on the command line to checked settings: composed by Hydra, checked by us.

Every ``_target_`` of a composed config is looked up and its values are held against the
constructor's annotations (``int``, ``Literal[...]``, ``Annotated[int, Ge(2)]`` ...): ``plugins``.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hydra import compose, initialize_config_dir, main
from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.kinds import Kind
from rbtm_bench.core.wording import suggestion
from rbtm_bench.datasets.published import PUBLISHED, path_of
from rbtm_bench.runs.declared import FOR_PAIRS, GROUPS, PLUGIN_GROUPS, SHARED, kind_of
from rbtm_bench.runs.identity import Identity, idle_settings, special_settings
from rbtm_bench.runs.plugins import check_node, check_value, is_system, make_importable

OF_RESOLVER = "ConfigError raised while resolving interpolation: "
"""What OmegaConf puts before our own words."""


@dataclass(frozen=True)
class Settings:
    """One run's settings, resolved: ``config`` is plain data, ``choices`` names the members of
    the groups (``{"backend": "open3d_p2p", ...}``), ``overrides`` are the words typed.
    ``special`` and ``idle`` are what ``identity`` has to know: the plug-ins' parameters that are a
    seed or another run's folder, and what does nothing for the chosen plug-ins. ``control``: how
    a grid came to this control by itself, and of which run (``controls``)."""

    config: dict[str, Any]
    choices: dict[str, str]
    overrides: tuple[str, ...] = ()
    special: dict[str, Kind] = field(default_factory=dict)
    idle: tuple[str, ...] = ()
    control: dict[str, str] | None = None

    @property
    def identity(self) -> Identity:
        """What makes the run the same as another."""
        return Identity.of(self.choices, self.config, self.special, self.idle)


def config_dir() -> Path:
    """The folder of the shipped configs: inside the package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


def _add_published() -> None:
    """``dataset=aces`` and its like: carmen, on the files that ``rbtm-bench download`` fetches."""
    OmegaConf.register_new_resolver("published", path_of, replace=True)
    for name in PUBLISHED:
        files = {part: f"${{published:{name},{part}}}" for part in ("log", "relations")}
        node = {"path": files["log"], "relations": files["relations"]}
        ConfigStore.instance().store(
            group="dataset",
            name=name,
            node={"defaults": ["carmen", "_self_"], "dataset": node},
            package="_global_",
        )


_add_published()


def compose_settings(overrides: list[str], extra_dirs: tuple[Path, ...] = ()) -> Settings:
    """Compose and check one run's settings. Raises ``ConfigError`` for anything wrong."""
    with composing(extra_dirs) as words:
        return from_hydra(composed(overrides + words), tuple(overrides))


def composed(overrides: list[str]) -> DictConfig:
    """The composed config with Hydra's own node; mistakes become ``ConfigError``."""
    for override in parsed(overrides):
        group = override.key_or_group
        if group not in GROUPS or override.is_delete() or override.is_sweep_override():
            continue
        several = isinstance(override.value(), list) and group == "metrics"
        if not isinstance(override.value(), str) and not several:
            raise ConfigError(f"{override.input_line}: expected the name of one {group}")
    try:
        return compose("config", overrides=overrides, return_hydra_config=True)
    except Exception as error:  # Hydra's, OmegaConf's, or YAML's of a damaged file
        raise ConfigError(_unknown_key(error, overrides) or explain(error)) from error


def parsed(words: list[str]) -> list[Override]:
    """The words as Hydra reads them. Raises ``ConfigError`` for one that it cannot read."""
    hydra = GlobalHydra.instance()
    loader = hydra.config_loader() if hydra.is_initialized() else None
    try:
        return list(OverridesParser.create(loader).parse_overrides(words))
    except HydraException as error:
        raise ConfigError(explain(error)) from error


def _unknown_key(error: Exception, overrides: list[str]) -> str | None:
    """A sentence about the key that Hydra could not override, with the keys that there are."""
    unknown = re.search(r"Could not override '([^']+)'", str(error))
    if not unknown:
        return None
    key = unknown.group(1)
    others = [word for word in overrides if word.split("=")[0].strip() != key]
    try:
        whole = node = compose("config", overrides=others)
    except Exception:  # something else is wrong as well
        return None
    *parents, last = key.split(".")
    for parent in parents:
        node = node.get(parent) if isinstance(node, DictConfig) else None
    known = [str(k) for k in node if k != "_target_"] if isinstance(node, DictConfig) else []
    owners = [str(k) for k in whole if not parents and last in _keys(whole, k)]
    if owners:
        return f"{key}: no such setting. Did you mean {' or '.join(f'{k}.{key}' for k in owners)}?"
    return f"{key}: no such setting.{suggestion(last, known)}"


def _keys(config: DictConfig, name: Any) -> list[Any]:
    node = config._get_node(name)  # ??? is no value to ask for
    return list(node) if isinstance(node, DictConfig) else []


def members(group: str, extra_dirs: tuple[Path, ...] = ()) -> list[str]:
    """The members of a config group, ours and those of ``extra_dirs``, by name."""
    from hydra.core.object_type import ObjectType

    with composing(extra_dirs) as words:
        loader = GlobalHydra.instance().config_loader()
        return sorted(loader.get_group_options(group, ObjectType.CONFIG, "config", words))


class composing:  # noqa: N801 (used as a context manager)
    """Initialise Hydra on our configs and ``extra_dirs``; gives the overrides to add."""

    def __init__(self, extra_dirs: tuple[Path, ...] = ()) -> None:
        for folder in extra_dirs:
            if not folder.is_dir():
                raise ConfigError(f"--config-dir {folder}: no such folder")
        make_importable(extra_dirs)
        self.words = []
        if extra_dirs:
            places = ",".join(f"'file://{folder.resolve()}'" for folder in extra_dirs)
            self.words = [f"hydra.searchpath=[{places}]"]

    def __enter__(self) -> list[str]:
        GlobalHydra.instance().clear()
        initialize_config_dir(str(config_dir()), job_name="rbtm_bench", version_base="1.3")
        return self.words

    def __exit__(self, *_: object) -> None:
        GlobalHydra.instance().clear()


def member_nodes(
    group: str, extra_dirs: tuple[Path, ...] = ()
) -> dict[str, dict[str, Any] | ConfigError]:
    """Every member of a group with its config as written (references and ??? kept), or the
    error that composing it gives."""
    nodes: dict[str, dict[str, Any] | ConfigError] = {}
    names = members(group, extra_dirs)
    with composing(extra_dirs) as words:
        for name in names:
            try:
                node = _written(group, name, extra_dirs)
                if node is None:
                    cfg = composed([f"{group}={name}", *words])
                    node = OmegaConf.select(cfg, group)
                    if isinstance(node, DictConfig):
                        node = OmegaConf.to_container(node, resolve=False)
                if not isinstance(node, dict):
                    raise ConfigError(f"{group}={name}: expected a mapping with a _target_")
                nodes[name] = {str(k): v for k, v in node.items()}
            except ConfigError as error:
                nodes[name] = error
    return nodes


def _written(group: str, name: str, extra_dirs: tuple[Path, ...]) -> Any:
    """A member's config out of its own file, where composing would add nothing to it: a whole
    composition takes 50 ms. None where it has to be composed."""
    files = [folder / group / f"{name}.yaml" for folder in (config_dir(), *extra_dirs)]
    present = [file for file in files if file.is_file()]
    if len(present) != 1:  # nowhere, or one that covers another
        return None
    try:
        text = present[0].read_text(encoding="utf-8")
        cfg = OmegaConf.create(text)
        node = OmegaConf.to_container(cfg, resolve=False)
    except Exception:  # composing says what is wrong
        return None
    if not isinstance(node, dict):
        return None
    package = re.match(r"\s*# @package (\S+)", text)
    is_global = package is not None and package[1] == "_global_"
    inherited = [d for d in node.get("defaults", ()) if not str(d).startswith("{'override /")]
    if inherited or (not is_global and (package or "defaults" in node)):
        return None
    return node.get(group) if is_global else node


def from_hydra(cfg: DictConfig, overrides: tuple[str, ...] = ()) -> Settings:
    """Checked settings out of a composed config that still has its ``hydra`` node."""
    choices = {str(k): str(v) for k, v in cfg.hydra.runtime.choices.items()}
    plain = OmegaConf.masked_copy(cfg, [str(key) for key in cfg if key != "hydra"])
    try:
        missing = sorted(OmegaConf.missing_keys(plain))
        if missing:
            raise ConfigError(f"{missing[0]} is not set: give it as {missing[0]}=<value>")
        config = OmegaConf.to_container(plain, resolve=True)
    except OmegaConfBaseException as error:
        key = f"{error.full_key}: " if getattr(error, "full_key", None) else ""
        text = _first_line(error).removeprefix(OF_RESOLVER)
        raise ConfigError(f"{key}{text}") from error
    assert isinstance(config, dict)
    settings = Settings(
        {str(k): v for k, v in config.items()},
        {group: choices[group] for group in GROUPS if group in choices},
        overrides,
    )
    try:
        check(settings.config)
    except ConfigError as error:
        raise ConfigError(_as_typed(str(error), overrides)) from error
    if is_system(settings.config):
        settings = _of_system(settings)
    return replace(
        settings,
        special=special_settings(plain, settings.config),
        idle=idle_settings(settings.config),
    )


def _as_typed(text: str, overrides: tuple[str, ...]) -> str:
    """A message about a number as it was typed (1e3), not as Hydra reads it (1000.0)."""
    setting, _, rest = text.partition(": ")
    key, _, value = setting.partition("=")
    for word in overrides:
        name, _, typed = word.partition("=")
        try:
            if name == key and float(typed) == float(value):
                return f"{word}: {rest}"
        except ValueError:
            continue
    return text


def _of_system(settings: Settings) -> Settings:
    """Without what does nothing for a system: it must not tell runs apart that are the same."""
    config = {
        k: v
        for k, v in settings.config.items()
        if k not in FOR_PAIRS and kind_of(k) is not Kind.FEED
    }
    choices = {g: "none" if g in FOR_PAIRS else name for g, name in settings.choices.items()}
    return replace(settings, config=config, choices=choices)


def check(config: dict[str, Any]) -> None:
    """Hold every ``_target_`` of the config against its constructor. Raises ``ConfigError``."""
    for key, setting in SHARED.items():
        if setting.type is None:
            continue
        if key not in config:
            raise ConfigError(f"{key} is not set: it cannot be left out")
        check_value(key, config[key], setting.type)
    for group in PLUGIN_GROUPS:
        check_node(group, config.get(group))
    for name, node in (config.get("metrics") or {}).items():
        check_node(f"metrics.{name}", node)


def explain(error: Exception) -> str:
    """One line out of Hydra's longer ones, naming the offending word."""
    if isinstance(error, OverrideParseException):
        return (
            f"{error.override}: cannot be read as key=value; quote a value with one of = , ( ) [ ] "
            "or a quote in it, inside the shell's own quotes: \"key='a=b'\""
        )
    chain: list[str] = []
    current: BaseException | None = error
    while current is not None:
        chain.append(str(current))
        current = current.__cause__
    text = "\n".join(chain)
    several = re.search(r"Ambiguous value for argument '(.*)'", text)
    if several:
        return (
            f"{several.group(1)}: one value expected here (rbtm-bench compare takes several; "
            "[a,b] is a list, and a value with a comma in it needs quotes: \"key='a,b'\")"
        )
    missing = getattr(error, "missing_cfg_file", None)
    if missing:
        group, _, option = str(missing).rpartition("/")
        options = [str(o) for o in getattr(error, "options", None) or []]
        label = f"{group}={option}" if group else str(missing)
        return f"{label}: no such {group or 'config'}.{suggestion(option, options)}"
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    drop = ("full_key", "object_type", "reference_type", "To append", "Set the environment", "See ")
    kept = [line for line in dict.fromkeys(lines) if not line.startswith(drop)]
    return " | ".join(kept[:3])


def hydra_main(words: list[str], task: Callable[[DictConfig], None]) -> None:
    """Call Hydra with our configs; its errors become ours."""
    argv, before = sys.argv, os.environ.get("HYDRA_FULL_ERROR")
    sys.argv = ["rbtm-bench", *words]
    os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra raises instead of printing and exiting with 1
    try:
        main(config_path=str(config_dir()), config_name="config", version_base="1.3")(task)()
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigError(explain(error)) from error
    finally:
        sys.argv = argv
        if before is None:
            del os.environ["HYDRA_FULL_ERROR"]


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]
