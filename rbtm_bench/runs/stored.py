"""Runs read back from their folders: the only source of tables, figures and resumed sweeps."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from rbtm_bench.core.bounded import read_json, read_yaml
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
    record = read_json(path / "run.json")
    metrics = read_json(path / "metrics.json") if (path / "metrics.json").exists() else {}
    config = read_yaml(path / "config.yaml")
    if not isinstance(config.get("selector") or {}, dict):
        raise DataError(f"{path / 'config.yaml'}: expected a run's settings")
    record["choices"] = record.get("choices") or {}
    if not isinstance(record["choices"], dict):
        raise DataError(f"{path / 'run.json'}: choices: expected an object")
    return Run(path, record, config, metrics)


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
