"""Runs read back from their folders: the only source of tables and figures."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rbtm_bench.core.errors import DataError

if TYPE_CHECKING:
    import pandas as pd

METHOD = ("data", "backend", "selector", "window", "threshold", "settings")
"""The columns that say what was compared on what."""

FIRST = (
    "run",
    "status",
    "dataset",
    *METHOD,
    "seed",
    "scans",
    "coverage",
    "final_translation_error_mm",
    "final_along_mm",
    "final_cross_mm",
    "final_rotation_error_deg",
    "ape_rmse_m",
    "rpe_translation_rmse_m",
    "rpe_rotation_rmse_deg",
    "relations_used",
    "relations_total",
    "relations_translation_mean_m",
    "relations_translation_std_m",
    "relations_rotation_mean_deg",
    "relations_rotation_std_deg",
    "registrations",
    "rejected",
    "fallbacks",
    "reused",
    "mean_gap",
    "localizability",
    "degenerate",
    "seconds",
    "ms_per_scan",
)
"""The columns of a table, in order; a run's further metrics follow, then the reason of failure."""

SAME_FOR_ALL_SEEDS = ("seed", "gaps_from", "out", "overwrite", "pin")

COSTS = re.compile(r"ms_|real_time_factor|peak_memory|reused")
"""Metrics that depend on the machine's mood, or on what other runs had computed before."""

HOW_NOT_WHAT = ("time_limit", "pictures", "map_resolution", "pairs", "memory_mb")
"""Settings outside every group that change what a run leaves or costs, not its numbers."""


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
        first: [(tag, pattern) for tag, pattern in found if not tag.endswith(":timestamp")]
        for first, found in loader.yaml_implicit_resolvers.items()
    }
    return loader


def find_runs(paths: Iterable[Path]) -> list[Run]:
    """The runs in or below the paths, in the order of their names.

    Raises ``DataError`` for a path without any.
    """
    found: dict[Path, Run] = {}
    for path in paths:
        if not path.exists():
            raise DataError(f"{path}: no such file or folder: expected a run or a folder of runs")
        files = sorted(path.rglob("run.json")) if path.is_dir() else []
        if not files:
            raise DataError(f"{path}: holds no run (no run.json in or below it)")
        for file in files:
            found.setdefault(file.parent.resolve(), read_run(file.parent))
    return list(found.values())


def row(run: Run, varied: str = "", data: str = "") -> dict[str, Any]:
    """A run as one row of a table; what does not exist is None.

    ``varied`` are further words for the column of settings, ``data`` for that of the data.
    """
    selector = run.config.get("selector") or {}
    choices = run.record.get("choices", {})
    values: dict[str, Any] = {
        "run": run.path.resolve().name,
        "status": run.record.get("status"),
        "dataset": choices.get("dataset"),
        "data": " ".join(filter(None, [choices.get("dataset"), data])) or None,
        "backend": choices.get("backend"),
        "selector": choices.get("selector"),
        "window": selector.get("window"),
        "threshold": selector.get("threshold"),
        "settings": " ".join(filter(None, [selector_settings(selector), varied])),
        "seed": run.record.get("seed"),
        "scans": run.record.get("scans"),
        "seconds": run.record.get("seconds"),
        **(run.metrics if run.done else {}),
    }
    ordered = {key: values.get(key) for key in FIRST}
    ordered.update({key: value for key, value in values.items() if key not in ordered})
    ordered["reason"] = run.record.get("reason")
    return ordered


def selector_settings(selector: dict[str, Any]) -> str:
    """The selector's settings that have no column of their own, as overrides."""
    own = ("_target_", "window", "threshold", "seed", "gaps", "gaps_from")
    keyframes_unused = selector.get("content") == "scans"
    parts = []
    for key, value in selector.items():
        if key in own or value is None or (keyframes_unused and key.startswith("keyframe_")):
            continue
        if (key, value) in (("content", "scans"), ("fallback", "previous")):
            continue
        parts.append(f"{key}={_plain(value)}")
    if selector.get("gaps_from"):
        parts.append(f"gaps of {gap_source(Path(selector['gaps_from']))}")
    return " ".join(parts)


def varied_settings(runs: Sequence[Run]) -> dict[Path, str]:
    """For every run the settings that tell it from others of its data set, backend and selector
    and have no column of their own, as overrides ("guess=odometry backend.kernel=huber")."""
    # registration and descriptor only feed the plug-ins, where their values stand again
    omitted = ("dataset", "selector", "registration", "descriptor", *HOW_NOT_WHAT)
    flat = {
        run.path: dict(run.record.get("choices", {}))
        | _flat({k: v for k, v in run.config.items() if k not in omitted})
        for run in runs
    }
    return _differing(runs, flat, ("dataset", "backend", "selector"))


def varied_data(runs: Sequence[Run]) -> dict[Path, str]:
    """For every run the settings of its data set that tell it from others: "path=aces.clf.gz".

    Runs on other data are not to be compared as if they were on the same.
    """
    flat = {run.path: _flat(run.config.get("dataset") or {}) for run in runs}
    for settings in flat.values():
        if "path" in settings:  # what belongs to a path says nothing more
            settings.pop("relations", None)
            settings.pop("poses", None)
    return _differing(runs, flat, ("dataset",))


def _differing(
    runs: Sequence[Run], flat: dict[Path, dict[str, Any]], same: tuple[str, ...]
) -> dict[Path, str]:
    """For every run its settings that others with the ``same`` choices do not share."""
    groups: dict[tuple[Any, ...], list[Path]] = {}
    for run in runs:
        choices = run.record.get("choices", {})
        groups.setdefault(tuple(choices.get(key) for key in same), []).append(run.path)
    words: dict[Path, str] = {}
    for paths in groups.values():
        keys = dict.fromkeys(key for path in paths for key in flat[path])
        differ = [k for k in keys if len({json.dumps(flat[p].get(k)) for p in paths}) > 1]
        for path in paths:
            mine = flat[path]
            words[path] = " ".join(f"{k}={_plain(mine[k])}" for k in differ if k in mine)
    return words


def _flat(config: dict[str, Any]) -> dict[str, Any]:
    """Settings as one level of keys; seeds and folders left out."""
    found: dict[str, Any] = {}

    def walk(prefix: str, node: Any) -> None:
        if isinstance(node, dict):
            for key, value in node.items():
                if key not in (*SAME_FOR_ALL_SEEDS, "_target_"):
                    walk(f"{prefix}.{key}" if prefix else str(key), value)
        else:
            found[prefix] = node

    walk("", config)
    return found


def _plain(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def frame(runs: Sequence[Run]) -> pd.DataFrame:
    """One row a run."""
    import pandas as pd

    varied, data = varied_settings(runs), varied_data(runs)
    return _last(pd.DataFrame([row(run, varied[run.path], data[run.path]) for run in runs]))


def _last(table: pd.DataFrame) -> pd.DataFrame:
    """The table with the reason of failure after all metrics, whichever run came first."""
    if "reason" not in table:
        return table
    return table[[*(c for c in table if c != "reason"), "reason"]]


@dataclass(frozen=True, eq=False)
class MethodRuns:
    """Runs that differ only in their seed, and ``row``: the medians of their numbers, and in
    ``seeds`` how many they are. Failed ones have no numbers and show in ``status``."""

    row: dict[str, Any]
    runs: list[Run]


def methods(runs: Sequence[Run]) -> list[MethodRuns]:
    """The runs by method; those of a data set and backend follow one another."""
    varied, data = varied_settings(runs), varied_data(runs)
    groups: dict[str, list[Run]] = {}
    for run in runs:
        groups.setdefault(method_key(run), []).append(run)
    found = [
        MethodRuns(
            _median_row([row(run, varied[run.path], data[run.path]) for run in group]), group
        )
        for group in groups.values()
    ]
    order: dict[tuple[Any, Any], int] = {}
    for one in found:
        order.setdefault((one.row["data"], one.row["backend"]), len(order))
    return sorted(found, key=lambda one: order[(one.row["data"], one.row["backend"])])


def over_seeds(runs: Sequence[Run]) -> pd.DataFrame:
    """One row a method, as ``MethodRuns`` says."""
    import pandas as pd

    return _last(pd.DataFrame([method.row for method in methods(runs)]))


def method_key(run: Run) -> str:
    """What two runs share that differ only in their seed."""

    def without_seeds(node: Any) -> Any:
        if not isinstance(node, dict):
            return node
        return {k: without_seeds(v) for k, v in node.items() if k not in SAME_FOR_ALL_SEEDS}

    settings = selector_settings(run.config.get("selector") or {})
    config = {k: v for k, v in run.config.items() if k not in HOW_NOT_WHAT}
    return json.dumps([run.record.get("choices"), without_seeds(config), settings])


def gap_source(path: Path) -> str:
    """The method whose gaps a random_gap run drew, e.g. "rbtm window=64 threshold=0.5"."""
    try:
        changed = (path / "config.yaml").stat().st_mtime_ns
    except OSError:
        return path.name
    return _gap_source(path.resolve(), changed)


@lru_cache(maxsize=10_000)
def _gap_source(path: Path, changed: int) -> str:
    """``changed`` is when its settings were written: many runs name the same source."""
    try:
        source = read_run(path)
    except DataError:
        return path.name
    selector = source.config.get("selector") or {}
    values = [f"{key}={selector[key]:g}" for key in ("window", "threshold") if key in selector]
    name = str(source.record.get("choices", {}).get("selector"))
    return " ".join([name, *values, selector_settings(selector)]).strip()


def _median_row(rows: list[dict[str, Any]]) -> dict[str, Any]:
    import pandas as pd

    table = pd.DataFrame(rows)
    out: dict[str, Any] = {}
    for key in table:
        column = table[key].dropna()
        if key == "seed":
            out["seeds"] = len(rows)
        elif key in ("run", "settings"):
            out[key] = rows[0][key]
        elif key == "status":
            done = int((table[key] == "done").sum())
            out[key] = "done" if done == len(rows) else f"{done} of {len(rows)} done"
        elif column.empty:
            out[key] = None
        elif pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column):
            out[key] = float(column.median())
        else:
            out[key] = column.iloc[0]
    return out


def _json(path: Path) -> dict[str, Any]:
    try:
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise DataError(f"{path}: not readable as JSON: {error}") from error
    if not isinstance(value, dict):
        raise DataError(f"{path}: expected an object")
    return value
