"""What a ``_target_`` names: looked up, and its values held against its annotations.

Hydra does not check types or ranges: pydantic does, third-party plug-ins included.
"""

from __future__ import annotations

import importlib
import inspect
import json
import sys
import typing
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from rbtm_bench.core.errors import ConfigError, one_line
from rbtm_bench.core.wording import shown, suggestion


def make_importable(folders: Iterable[Path]) -> None:
    """Put folders of plug-ins at the end of the import path, where they cover nothing: what lies in
    DIR of ``--config-dir DIR`` can be a ``_target_``, in this process and those that it starts."""
    sys.path += [str(one) for f in folders if str(one := f.resolve()) not in sys.path]


def locate(name: str, target: str) -> Any:
    """What ``_target_`` names: a class, or something in a class that makes one.

    Raises ``ConfigError`` saying why it is not there, whatever its module raises.
    """
    *modules, attribute = target.split(".")
    try:
        thing, rest = _import(modules)
        for part in (*rest, attribute):
            thing = getattr(thing, part)
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # a module may leave by sys.exit
        known = isinstance(error, ImportError | AttributeError)
        text = f"{'' if known else f'{type(error).__name__}: '}{one_line(error)}"
        raise ConfigError(f"{name}: cannot load {target}: {text}") from error
    if not callable(thing):
        raise ConfigError(f"{name}: cannot load {target}: not a class")
    return thing


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


def class_of(name: str, node: Any) -> type | None:
    """The class that a plug-in's config node makes, None for a function that makes who knows what.

    Raises ``ConfigError`` if it is not there.
    """
    made = locate(name, str(node["_target_"]))
    made = made if inspect.isclass(made) else getattr(made, "__self__", None)
    return made if inspect.isclass(made) else None


def foreign_modules(config: Any) -> frozenset[str]:
    """The packages, other than ours, that the ``_target_``s of a config come from."""
    if not isinstance(config, dict):
        return frozenset()
    own = str(config.get("_target_", "rbtm_bench")).partition(".")[0]
    parts = [foreign_modules(node) for node in config.values()]
    return frozenset({own} - {"rbtm_bench"}).union(*parts)


def foreign_plugins(config: dict[str, Any], choices: dict[str, str]) -> str:
    """The plug-ins of a config that are not ours, as chosen ("backend=my_icp"); "" if none."""
    names = []
    for key, node in config.items():
        if not foreign_modules(node):
            continue
        if key in choices:
            names.append(f"{key}={choices[key]}")
        elif isinstance(node, dict):
            names += [f"{key}.{name}" for name, part in node.items() if foreign_modules(part)]
    return ", ".join(names)


def is_system(config: Any) -> bool:
    """Whether the chosen backend is a ``System``, which needs nobody to choose model scans."""
    from rbtm_bench.backends.system import System

    node = config.get("backend") or {}
    if "_target_" not in node:  # reported by whoever checks the backend
        return False
    made = class_of("backend", node)
    return made is not None and issubclass(made, System)


def unfillable(config: Any) -> str:
    """In words a selector's window that cannot hold what the target is made of; "" of any other,
    and of a selector that only makes itself when another run has ended."""
    needed = getattr(locate("target", config["target"]["_target_"]), "needs_nodes", 1)
    node = config["selector"]
    if needed < 2:
        return ""
    try:
        settings = {key: value for key, value in node.items() if not key.startswith("_")}
        holds = int(locate("selector", node["_target_"])(**settings).capacity)
    except Exception:  # whoever makes it for a run says what is wrong
        return ""
    if holds >= needed:
        return ""
    return f"remembers {holds} past scan{'s' * (holds > 1)}: expected at least the {needed}"


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
        node[key] = _whole(value, parameters[key].annotation)
        check_value(f"{name}.{key}", node[key], parameters[key].annotation)
    if node.get("_partial_") or node.get("_args_"):
        return
    for key, parameter in parameters.items():
        required = parameter.default is parameter.empty and parameter.kind not in (
            parameter.VAR_KEYWORD,
            parameter.VAR_POSITIONAL,
        )
        if required and key not in given:
            raise ConfigError(f"{name}.{key} is not set: {node['_target_']} requires it")


def _whole(value: Any, annotation: Any) -> Any:
    """A whole number typed as 00 or 1e3, which Hydra takes for a word or a float, where the
    annotation takes whole numbers alone; anything else as it is."""
    typed = isinstance(value, str) and value.isascii() and value.isdigit() and value[0] == "0"
    if not typed and not (isinstance(value, float) and value.is_integer()):
        return value
    if _fits(value, annotation) or not _fits(int(value), annotation):
        return value
    return int(value)


def _fits(value: Any, annotation: Any) -> bool:
    try:
        check_value("", value, annotation)
    except ConfigError:
        return False
    return True


def check_value(name: str, value: Any, annotation: Any) -> None:
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
