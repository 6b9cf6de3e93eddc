"""The scans behind runs, read again for the page: points and descriptors, once a data set."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.page.packing import INT16, packed, quantised
from rbtm_bench.runs import assembly, first_part, replicate
from rbtm_bench.runs.stored import Run
from rbtm_bench.similarity.base import Descriptor, Similarity

POINTS = 1_400_000
"""Points of all data sets of a page, at most."""
LEAST = 60
"""Points of a scan below which scans are left out rather than points."""
LARGEST = 1500
"""Points of one scan at most."""
CURVES = 700_000
"""Values of all descriptors of a similarity, at most."""
BEAMS = 256
"""Values of one descriptor at most."""
OURS = "rbtm_bench."


def settings_of(run: Run, trust: bool) -> dict[str, Any]:
    """A run's settings with what its data determined. Raises ``DataError`` if they name code
    outside this package and nobody trusts it: a result folder may come from anywhere."""
    foreign = sorted(t for t in _targets(run.config) if not t.startswith(OURS))
    if foreign and not trust:
        raise DataError(f"{foreign[0]} is no part of rbtm_bench: report --trust runs it")
    return first_part.filled(run.config, run.record.get("determined") or {})


def _targets(node: Any) -> set[str]:
    if isinstance(node, list | tuple):
        return {target for item in node for target in _targets(item)}
    if not isinstance(node, Mapping):
        return set()
    own = {str(node["_target_"])} if "_target_" in node else set()
    return own | {target for item in node.values() for target in _targets(item)}


@dataclass(eq=False)
class Scans:
    """The scans of a data set that are kept: ``every`` says which, ``points`` in the sensor's
    frame; ``light`` are all scans with odometry and stamp alone."""

    dataset: Dataset
    every: int
    light: list[Scan]
    points: list[Array]
    thinned: str
    described: dict[str, tuple[Descriptor, dict[str, Any] | None]] = field(default_factory=dict)

    @property
    def kept(self) -> range:
        return range(0, len(self.dataset), self.every)


def open_scans(run: Run, trust: bool, budget: int) -> Scans:
    """The scans of a run, read again, of them at most ``budget`` points. Raises ``DataError`` where
    they are not there, or are not what the run saw."""
    config = settings_of(run, trust)
    plain = assembly.build(config["dataset"])
    if not isinstance(plain, Dataset):
        raise DataError(f"{run.path.name}: {config['dataset'].get('_target_')} is no data set")
    dataset = replicate.copy_of(plain, config)
    if dataset.fingerprint() != run.record.get("dataset_fingerprint"):
        raise DataError("the data are not what they were when the run was made")
    count = len(dataset)
    share = max(budget // max(count, 1), LEAST)
    every = 1 + (count * LEAST - 1) // budget
    light, points, left_out = [], [], 0
    for i, scan in enumerate(dataset):
        light.append(Scan(i, scan.stamp, np.zeros((0, 3)), scan.planar, odometry=scan.odometry))
        if i % every:
            continue
        own = scan.points[np.isfinite(scan.points).all(axis=1)]
        chosen = spread(len(own), min(share, LARGEST))
        left_out += len(own) - len(chosen)
        points.append(own[chosen])
    words = [f"every {every}th scan"] if every > 1 else []
    total = sum(map(len, points))
    words += [f"{100 * total / (total + left_out):.0f}% of the points"] if left_out else []
    return Scans(dataset, every, light, points, " and ".join(words))


def spread(count: int, most: int) -> NDArray[np.int64]:
    """Positions of at most so many of ``count``, evenly."""
    if count <= most:
        return np.arange(count)
    return np.linspace(0, count - 1, most).round().astype(np.int64)


def packed_points(scans: Scans) -> dict[str, Any]:
    """The kept points as 16-bit integers, scan after scan, and where each scan ends."""
    axes = 2 if scans.dataset.planar else 3
    every = np.concatenate([p[:, :axes] for p in scans.points] or [np.zeros((0, axes))])
    scale = max(float(np.abs(every).max(initial=0.0)), 1e-3) / INT16
    return {
        "every": scans.every,
        "axes": axes,
        "scale": scale,
        "ends": packed(np.cumsum([len(p) for p in scans.points]), "i32", 1),
        "xyz": packed(quantised(every, scale), "i16", axes),
        "thinned": scans.thinned,
    }


def described(scans: Scans, similarity: Similarity, key: str) -> Descriptor:
    """The descriptors (N, D) of all scans, computed once a similarity; with them what of them can
    be drawn."""
    if key not in scans.described:
        similarity.check(scans.dataset)
        rows = [similarity.describe(scan.without_truth()) for scan in scans.dataset]
        scans.described[key] = np.stack(rows), _curves(similarity, rows, scans)
    return scans.described[key][0]


def _curves(similarity: Similarity, rows: list[Descriptor], scans: Scans) -> dict[str, Any] | None:
    if similarity.curve(rows[0]) is None:
        return None
    most = max(min(CURVES // len(scans.kept), BEAMS), 16)
    values: list[Array] = []
    name, width = "", 0
    for i in scans.kept:
        drawn = similarity.curve(rows[i])
        assert drawn is not None
        name, width = drawn[0], len(drawn[1])
        values.append(drawn[1][spread(width, most)])
    table = np.stack(values)
    scale = max(float(np.nanmax(np.abs(table), initial=0.0)), 1e-3) / INT16
    return {
        "name": name,
        "of": width,
        "columns": table.shape[1],
        "scale": scale,
        "values": packed(quantised(table, scale), "i16", table.shape[1]),
    }
