"""Runs read back from their folders: the only source of tables, figures and resumed sweeps."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.kinds import Kind
from rbtm_bench.runs.identity import Identity, node_key

BEFORE = {
    "dataset.seed": Kind.SEED,
    "selector.seed": Kind.SEED,
    "selector.gaps_from": Kind.OTHER_RUN,
}
"""The special settings of runs that do not record theirs: all that there were."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run folder: ``record`` is run.json, ``config`` the resolved settings, ``metrics`` may be
    empty (a run that failed has none)."""

    path: Path
    record: dict[str, Any]
    config: dict[str, Any]
    metrics: dict[str, Any]

    @property
    def done(self) -> bool:
        return self.record.get("status") == "done"

    @property
    def choices(self) -> dict[str, str]:
        """The members of the groups by name: ``{"backend": "open3d_p2p", ...}``."""
        choices: dict[str, str] = self.record.get("choices") or {}
        return choices

    def section(self, group: str) -> dict[str, Any]:
        """The settings of a group, with what followed from the data (``first_part``); empty if
        there are none."""
        node = self.config.get(group)
        if not isinstance(node, dict):
            return {}
        known = self.record.get("determined") or {}
        return {key: known.get(f"{group}.{key}", value) for key, value in node.items()}

    @cached_property
    def identity(self) -> Identity:
        """What makes it the same as another run."""
        known = self.record.get("special")
        special = BEFORE if known is None else {key: Kind[name] for key, name in known.items()}
        return Identity.of(self.choices, self.config, special, self.record.get("idle") or ())

    @cached_property
    def method(self) -> str:
        """Equal for replicates: runs that differ only in their seed. A run that draws another
        run's gaps is a replicate of those that draw from replicates of that one."""
        return node_key(self.identity.method, self.source and self.source.method)

    @cached_property
    def way(self) -> str:
        """Equal for runs of one method, whatever the data and the seed."""
        return node_key(self.identity.way, self.source and self.source.way)

    @cached_property
    def source(self) -> Run | None:
        """The run whose gaps this one drew, if it is still there."""
        folder = self.section("selector").get("gaps_from")
        return _source(Path(str(folder))) if folder else None


def is_number(value: Any) -> bool:
    """True for a metric that exists."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def read_run(path: Path) -> Run:
    """Read a run folder. Raises ``DataError`` naming the file that is missing or damaged."""
    import yaml

    record = _json(path / "run.json")
    metrics = _json(path / "metrics.json") if (path / "metrics.json").is_file() else {}
    try:
        text = (path / "config.yaml").read_text(encoding="utf-8")
        config = yaml.load(text, _loader())
    except (OSError, ValueError, yaml.YAMLError) as error:
        text = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"{path / 'config.yaml'}: {text}") from error
    if not isinstance(config, dict) or not isinstance(config.get("selector") or {}, dict):
        raise DataError(f"{path / 'config.yaml'}: expected a run's settings")
    record["choices"] = record.get("choices") or {}
    if not isinstance(record["choices"], dict):
        raise DataError(f"{path / 'run.json'}: choices: expected an object")
    return Run(path, record, {str(k): v for k, v in config.items()}, metrics)


def _source(folder: Path) -> Run | None:
    """A run that others drew their gaps from: many name the same."""
    try:
        written = (folder / "config.yaml").stat().st_mtime_ns
        return _read_source(folder.resolve(), written)
    except (OSError, DataError):
        return None


@lru_cache(maxsize=10_000)
def _read_source(folder: Path, written: int) -> Run:
    return read_run(folder)


@cache
def _loader() -> Any:
    """libyaml's safe loader with OmegaConf's own readings: 1e-5 is a number, a date is text.

    OmegaConf's takes 6 ms for a run's settings, this one 0.3 ms.
    """
    import yaml

    fast = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # without libyaml: the slow one
    loader: Any = type("Loader", (fast,), {})
    plain_exponent = re.compile(r"[-+]?[0-9]+\.?[eE][-+]?[0-9]+$")
    loader.add_implicit_resolver("tag:yaml.org,2002:float", plain_exponent, list("-+0123456789"))
    loader.yaml_implicit_resolvers = {
        first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(":timestamp")]
        for first, resolvers in loader.yaml_implicit_resolvers.items()
    }
    return loader


def find_runs(paths: Iterable[Path]) -> list[Run]:
    """The runs in or below the paths, in the order of their names.

    One that cannot be read has the status "unreadable" and says why. Raises ``DataError`` for a
    path without any run, or of which none can be read.
    """
    runs: dict[Path, Run] = {}
    damage: list[DataError] = []
    for path in paths:
        if not path.exists():
            raise DataError(f"{path}: no such file or folder: expected a run or a folder of runs")
        files = sorted(path.rglob("run.json")) if path.is_dir() else []
        if not files:
            raise DataError(f"{path}: holds no run (no run.json in or below it)")
        for file in files:
            place = file.parent.resolve()
            if place in runs:
                continue
            try:
                runs[place] = read_run(file.parent)
            except DataError as error:
                damage.append(error)
                record = {"status": "unreadable", "reason": str(error), "choices": {}}
                runs[place] = Run(file.parent, record, {}, {})
    if damage and len(damage) == len(runs):
        raise damage[0]
    return list(runs.values())


def _json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: not readable as JSON: {error}") from error
    if not isinstance(value, dict):
        raise DataError(f"{path}: expected an object")
    return value
