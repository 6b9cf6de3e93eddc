"""From the words on the command line to checked settings: composed by Hydra, checked by us.

Hydra composes; it does not check types or ranges. Every ``_target_`` of a composed config is
looked up here and its values are held against the constructor's annotations (``int``,
``Literal[...]``, ``Annotated[int, Ge(2)]`` ...) by pydantic, third-party plug-ins included.
"""

from __future__ import annotations

import difflib
import importlib
import inspect
import json
import re
import typing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Lt
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, OverrideParseException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict

from rbtm_bench.core.errors import ConfigError

PLUGIN_GROUPS = ("dataset", "backend", "similarity", "selector", "guess", "check", "target")
GROUPS = (*PLUGIN_GROUPS, "metrics")
FOR_PAIRS = ("similarity", "selector", "guess", "check", "target", "guess_along_degenerate")
"""The groups and settings that a backend which is a whole system does without."""
FEEDING = ("registration", "descriptor")
"""Settings that plug-ins take over: once resolved, their values stand there again."""


class Pairs(TypedDict):
    """The settings of ``pairs``."""

    store: Literal["off", "shared", "per_worker"]
    folder: str | None
    memory_mb: Annotated[float, Gt(0)]


SHARED = (
    ("seed", Annotated[int, Ge(0)]),
    ("out", str | None),
    ("overwrite", bool),
    ("pictures", bool),
    ("pairs", Pairs),
    ("pin", bool),
    ("time_limit", Annotated[float, Gt(0)] | None),
    ("map_resolution", Annotated[float, Gt(0)]),
    ("guess_along_degenerate", Annotated[float, Gt(0), Lt(1)] | None),
)
"""The settings outside every group, with their types."""


@dataclass(frozen=True)
class Settings:
    """One run's settings, resolved: ``config`` is plain data, ``choices`` names the members of
    the groups (``{"backend": "open3d_p2p", ...}``), ``overrides`` are the words typed."""

    config: dict[str, Any]
    choices: dict[str, str]
    overrides: tuple[str, ...] = ()


def config_dir() -> Path:
    """The folder of the shipped configs: inside the package, or beside it in a checkout."""
    package = Path(__file__).resolve().parent.parent
    inside = package / "configs"
    return inside if inside.is_dir() else package.parent / "configs"


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
    found = re.search(r"Could not override '([^']+)'", str(error))
    if not found:
        return None
    key = found.group(1)
    others = [word for word in overrides if word.split("=")[0].strip() != key]
    try:
        node: Any = compose("config", overrides=others)
    except Exception:  # something else is wrong as well
        return None
    *parents, last = key.split(".")
    for parent in parents:
        node = node.get(parent) if isinstance(node, DictConfig) else None
    known = [str(k) for k in node if k != "_target_"] if isinstance(node, DictConfig) else []
    return f"{key}: no such setting.{suggestion(last, known)}"


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
                cfg = composed([f"{group}={name}", *words])
                node = OmegaConf.to_container(cfg[group], resolve=False)
                if not isinstance(node, dict):
                    raise ConfigError(f"{group}={name}: expected a mapping with a _target_")
                nodes[name] = {str(k): v for k, v in node.items()}
            except ConfigError as error:
                nodes[name] = error
    return nodes


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
        raise ConfigError(f"{key}{_first_line(error)}") from error
    assert isinstance(config, dict)
    settings = Settings(
        {str(k): v for k, v in config.items()},
        {group: choices[group] for group in GROUPS if group in choices},
        overrides,
    )
    check(settings.config)
    return _of_system(settings) if is_system(settings.config) else settings


def is_system(config: Any) -> bool:
    """Whether the chosen backend is a ``System``, which needs nobody to choose model scans."""
    from rbtm_bench.backends.system import System

    node = config.get("backend") or {}
    if "_target_" not in node:  # said by whoever checks the backend
        return False
    made = locate("backend", str(node["_target_"]))
    made = made if inspect.isclass(made) else getattr(made, "__self__", None)
    return inspect.isclass(made) and issubclass(made, System)


def _of_system(settings: Settings) -> Settings:
    """Without what does nothing for a system: it must not tell runs apart that are the same."""
    config = {k: v for k, v in settings.config.items() if k not in (*FOR_PAIRS, *FEEDING)}
    choices = {g: "none" if g in FOR_PAIRS else name for g, name in settings.choices.items()}
    return replace(settings, config=config, choices=choices)


def check(config: dict[str, Any]) -> None:
    """Hold every ``_target_`` of the config against its constructor. Raises ``ConfigError``."""
    for key, kind in SHARED:
        if key not in config:
            raise ConfigError(f"{key} is not set: it cannot be left out")
        _check_value(key, config[key], kind)
    for group in PLUGIN_GROUPS:
        check_node(group, config.get(group))
    for name, node in (config.get("metrics") or {}).items():
        check_node(f"metrics.{name}", node)


def check_node(name: str, node: Any) -> None:
    """Check one plug-in's node: its class exists, it knows every key, and every value fits."""
    if not isinstance(node, dict) or "_target_" not in node:
        raise ConfigError(f"{name}: expected a config with a _target_, got {node!r}")
    parameters = constructor_parameters(name, str(node["_target_"]))
    given = {str(k): v for k, v in node.items() if not str(k).startswith("_")}
    accepts_any = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for key, value in given.items():
        if key not in parameters:
            if accepts_any:
                continue
            known = [k for k, p in parameters.items() if p.kind is not p.VAR_KEYWORD]
            raise ConfigError(f"{name}.{key}: no such setting.{suggestion(key, known)}")
        _check_value(f"{name}.{key}", value, parameters[key].annotation)
    if node.get("_partial_") or node.get("_args_"):
        return
    for key, parameter in parameters.items():
        required = parameter.default is parameter.empty and parameter.kind not in (
            parameter.VAR_KEYWORD,
            parameter.VAR_POSITIONAL,
        )
        if required and key not in given:
            raise ConfigError(f"{name}.{key} is not set: {node['_target_']} requires it")


def locate(name: str, target: str) -> Any:
    """What ``_target_`` names: a class, or something in a class that makes one.

    Raises ``ConfigError`` saying why it is not there, whatever its module raises.
    """
    *modules, attribute = target.split(".")
    try:
        found, rest = _import(modules)
        for part in (*rest, attribute):
            found = getattr(found, part)
    except Exception as error:
        known = isinstance(error, ImportError | AttributeError)
        text = " ".join([*([] if known else [f"{type(error).__name__}:"]), *str(error).split()])
        raise ConfigError(f"{name}: cannot load {target}: {text}") from error
    if not callable(found):
        raise ConfigError(f"{name}: cannot load {target}: not a class")
    return found


def _import(parts: list[str]) -> tuple[Any, list[str]]:
    """The module that the longest possible start of a dotted name stands for, and the rest."""
    if not parts:
        raise ImportError("expected a dotted name such as package.module.Class")
    for count in range(len(parts), 0, -1):
        name = ".".join(parts[:count])
        try:
            return importlib.import_module(name), parts[count:]
        except ModuleNotFoundError as error:
            if count == 1 or error.name != name:
                raise
    raise AssertionError("a name of no parts")


def constructor_parameters(name: str, target: str) -> dict[str, inspect.Parameter]:
    """The constructor's parameters with evaluated annotations."""
    cls = locate(name, target)
    try:
        signature = inspect.signature(cls)
    except ValueError:  # written in C: it does not say what it takes
        return {"kwargs": inspect.Parameter("kwargs", inspect.Parameter.VAR_KEYWORD)}
    init = cls.__init__ if inspect.isclass(cls) else cls
    try:
        hints = typing.get_type_hints(init, include_extras=True)
    except Exception:  # an annotation that only a type checker can look up
        hints = {}
    return {
        key: parameter.replace(annotation=hints.get(key, Any))
        for key, parameter in signature.parameters.items()
    }


def suggestion(word: str, known: list[str]) -> str:
    """ " Did you mean x? Known: ..." for a mistyped word."""
    close = difflib.get_close_matches(word, known, n=1, cutoff=0.5)
    meant = f" Did you mean {close[0]}?" if close else ""
    return f"{meant} Known: {', '.join(known) if known else '(none)'}"


def shown(value: Any) -> str:
    """A value as one would type it."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{','.join(map(shown, value))}]"
    return str(value)


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


def _first_line(error: Exception) -> str:
    return str(error).splitlines()[0]


def _check_value(name: str, value: Any, annotation: Any) -> None:
    """One value against one annotation: no word or truth value may stand for a number.

    Held against it as JSON, so that a list may stand for a tuple and a word for a path.
    """
    if isinstance(value, dict) and "_target_" in value:
        check_node(name, value)
        return
    if annotation is Any or annotation is inspect.Parameter.empty:
        return
    if isinstance(value, float) and value != value:
        raise ConfigError(f"{name}={value}: input should be a number")
    try:
        adapter: TypeAdapter[Any] = TypeAdapter(annotation)
    except Exception:  # an annotation that pydantic has no schema for: nothing to check against
        return
    try:
        adapter.validate_json(json.dumps(value, default=str), strict=True)
    except ValidationError as error:
        problems = dict.fromkeys(p["msg"][:1].lower() + p["msg"][1:] for p in error.errors())
        text = " or ".join(list(problems)[:3])
        if "valid string" in text:
            text += f"; quote it: \"{name}='{shown(value)}'\""
        raise ConfigError(f"{name}={shown(value)}: {text}") from error
