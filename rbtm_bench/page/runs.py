"""What a run stored, scan by scan, as packed arrays: poses, model scans, scores, errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError, RbtmBenchError
from rbtm_bench.core.geometry import yaw
from rbtm_bench.core.types import Array
from rbtm_bench.metrics.relation_errors import FILE as RELATIONS
from rbtm_bench.metrics.relation_errors import RelationErrors
from rbtm_bench.page.packing import packed, quantised
from rbtm_bench.plots.folder import Paths, read_paths, read_scene
from rbtm_bench.runs.stored import Run

STORED = 150_000
"""Scans of all runs that a page keeps one by one; further runs keep a thin path."""
THIN = 400
"""Poses of a thin path, at most."""
MAP_POINTS = 15_000
"""Points of a run's own map, which stands in where the scans cannot be read again."""
NAMED = 400
"""Different reasons that a run keeps at most."""
NUMBERS = ("score", "fitness", "inlier_rmse_m")
WORDS = ("status", "reason", "recovered")
FLAT = 1e-6
"""m and rad that a path may leave its plane and still be drawn as planar."""


@dataclass(frozen=True, eq=False)
class Track:
    """A run's poses (N, 4, 4) with its steps as columns, one a scan."""

    run: Run
    paths: Paths
    steps: dict[str, list[Any]]
    planar: bool

    @property
    def T_world_scan(self) -> Array:
        return self.paths.estimate.T_world_scan

    def __len__(self) -> int:
        return len(self.paths.estimate)

    @cached_property
    def models(self) -> NDArray[np.int64]:
        """The model scan of every scan (N,), -1 without."""
        return np.array([-1 if m is None else m for m in self.steps["model"]], dtype=np.int64)


def read_track(run: Run, with_steps: bool = True) -> Track:
    """A run's track. Raises ``DataError`` where it has none, or its files do not agree."""
    paths = read_paths(run) if run.done else None
    if paths is None:
        raise DataError(f"{run.path.name}: has no trajectory")
    T = paths.estimate.T_world_scan
    planar = bool(np.abs(T[:, 2, 3]).max() <= FLAT and np.abs(T[:, 2, :2]).max() <= FLAT)
    return Track(run, paths, _steps(run, len(T)) if with_steps else {}, planar)


def _steps(run: Run, count: int) -> dict[str, list[Any]]:
    import pyarrow as pa
    import pyarrow.parquet as pq

    path = run.path / "steps.parquet"
    wanted = ("scan", "model", *NUMBERS, *WORDS, "rejected", "refused", "restart", "target_scans")
    try:
        names = set(pq.read_schema(path).names)
        table = pq.read_table(path, columns=[name for name in wanted if name in names])
        columns = {name: table[name].to_pylist() for name in table.column_names}
    except (pa.ArrowException, OSError, ValueError) as error:
        raise DataError(f"{path}: not a readable table of steps: {error}") from error
    if columns.get("scan") != list(range(count)) or "model" not in columns:
        raise DataError(f"{path}: {table.num_rows} steps for {count} poses, or not in their order")
    return {name: columns.get(name, [None] * count) for name in wanted}


def detail(track: Track, whole: bool) -> dict[str, Any]:
    """A run for the page: a thin path, or with ``whole`` every scan with how it got its pose."""
    count = len(track)
    kept = np.arange(count)
    if not whole and count > THIN:
        kept = np.unique(np.linspace(0, count - 1, THIN).round().astype(np.int64))
    out: dict[str, Any] = {
        "planar": track.planar,
        "scans": count,
        "whole": whole,
        "kept": None if len(kept) == count else packed(kept, "i32", 1),
        "poses": packed_poses(track.T_world_scan[kept], track.planar),
    }
    if (errors := _errors(track)) is not None:
        out["error"] = packed(errors[kept], "f32")
    if (relations := _relations(track)) is not None:
        out["relations"] = relations
    if whole:
        out |= _columns(track)
    return out


def packed_poses(T: Array, planar: bool) -> dict[str, Any]:
    """Poses (N, 4, 4) column by column: x, y, heading (m, rad), or x, y, z and a quaternion."""
    if planar:
        return packed(np.stack([T[:, 0, 3], T[:, 1, 3], yaw(T)]), "f32")
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(T[:, :3, :3]).as_quat(canonical=True)
    return packed(np.concatenate([T[:, :3, 3], turned], axis=1).T, "f32")


def truth(track: Track) -> dict[str, Any]:
    """The true poses, thinned, moved so that the first ones agree, and how far (m) the true path
    has come at every scan; nothing where there is none."""
    G = track.paths.truth_from_start
    if G is None:
        return {}
    steps = np.linalg.norm(np.diff(G[:, :3, 3], axis=0), axis=1)
    metres = np.concatenate([[0.0], np.nancumsum(steps)])
    thin = packed_poses(G[:: 1 + len(G) // (10 * THIN)], track.planar)
    return {"truth": thin, "metres": packed(metres, "f32")}


def _errors(track: Track) -> Array | None:
    """The distance (N,) m from the true positions, first poses made equal, NaN where unknown."""
    G = track.paths.truth_from_start
    if G is None:
        return None
    off: Array = np.linalg.norm(G[:, :3, 3] - track.T_world_scan[:, :3, 3], axis=1)
    return off


def _relations(track: Track) -> dict[str, Any] | None:
    """The errors of relations (m), at the scan nearest to their later end."""
    path = track.run.path / RELATIONS
    if not path.is_file():
        return None
    errors = RelationErrors.read(path)
    used = errors.used
    stamps = track.paths.estimate.stamps
    order = np.argsort(stamps, kind="stable")
    later = np.maximum(errors.start, errors.end)[used]
    at = np.clip(np.searchsorted(stamps[order], later - 1e-4), 0, len(order) - 1)
    by_scan = np.argsort(order[at], kind="stable")
    return {
        "scan": packed(order[at][by_scan], "i32", 1),
        "error": packed(errors.translation_m[used][by_scan], "f32"),
        "long": packed(~errors.local[used][by_scan], "u8"),
    }


def _columns(track: Track) -> dict[str, Any]:
    steps, scans = track.steps, np.arange(len(track))
    models = track.models
    words = {name: _coded(steps[name]) for name in WORDS}
    numbers = {
        name: packed(np.array([np.nan if v is None else v for v in steps[name]]), "f32")
        for name in NUMBERS
    }
    refused = {str(i): text for i, text in enumerate(steps["refused"]) if text}
    return {
        "gap": packed(np.where(models < 0, 0, scans - models), "i32"),
        "rejected": packed(np.clip([n or 0 for n in steps["rejected"]], 0, 255), "u8"),
        "targets": packed(np.clip([n or 0 for n in steps["target_scans"]], 0, 32767), "i16"),
        "restart": [i for i, again in enumerate(steps["restart"]) if again],
        "refused": dict(list(refused.items())[: 10 * NAMED]),
        **words,
        **numbers,
    }


def _coded(words: Sequence[Any]) -> dict[str, Any]:
    """Words as numbers and their list; of very many different ones the first."""
    known: dict[str, int] = {}
    codes = []
    for word in words:
        text = str(word or "")
        if text not in known and len(known) >= NAMED:
            text = "(one of many reasons)"
        codes.append(known.setdefault(text, len(known)))
    return {"words": list(known), "codes": packed(codes, "i16")}


def own_map(run: Run) -> dict[str, Any] | None:
    """A run's map from above (m) as it was stored, thinned."""
    try:
        scene = read_scene(run)
    except RbtmBenchError:
        return None
    if scene is None or not len(scene.points):
        return None
    count = len(scene.points)
    points = scene.points[:: 1 + count // MAP_POINTS].astype(np.float64)
    scale = max(float(np.abs(points).max()), 1e-3) / 32767
    note = f"{len(points)} of {count} points of its map"
    return {"xy": packed(quantised(points, scale), "i16", 2), "scale": scale, "note": note}
