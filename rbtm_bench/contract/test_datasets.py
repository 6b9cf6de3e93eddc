"""Every data set that needs no files: the same scans every time, and truthful about them."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import is_rigid
from rbtm_bench.core.types import SCAN_ARRAYS, Scan
from rbtm_bench.datasets.base import Dataset

GROUP = "dataset"
LOOKED_AT = 12
"""Scans at most, spread over the data set."""


@pytest.fixture(scope="module")
def dataset(catalogue: Catalogue, member: Member) -> Dataset:
    """The data set under test, where its settings are complete."""
    try:
        catalogue.node(member)
    except ConfigError as error:
        absent = "is not set" in str(error) or "rbtm-bench download" in str(error)
        if not absent or member in catalogue.only:
            pytest.fail(f"{member}: {error}", pytrace=False)
        pytest.skip(f"{member} needs data: {error} (--override)")
    dataset: Dataset = catalogue.build(member)
    return dataset


@pytest.fixture(scope="module")
def indices(dataset: Dataset) -> list[int]:
    """First and last scan and some between."""
    assert len(dataset) > 0, "a data set without scans: raise DataError instead"
    count = min(LOOKED_AT, len(dataset))
    return sorted({int(i) for i in np.linspace(0, len(dataset) - 1, count).round()})


def content(scan: Scan) -> list[bytes | None]:
    """Everything in a scan, as bytes."""
    arrays = [getattr(scan, name) for name in SCAN_ARRAYS]
    facts = np.array([scan.index, scan.stamp, scan.planar], dtype=np.float64)
    return [facts.tobytes(), *(None if a is None else a.tobytes() for a in arrays)]


def test_indexing_twice_gives_the_same_bits(dataset: Dataset, indices: list[int]) -> None:
    forward = {i: content(dataset[i]) for i in indices}
    backward = {i: content(dataset[i]) for i in reversed(indices)}
    assert forward == backward, "dataset[i] changes from call to call, or with the order of calls"


def test_iterating_is_indexing(dataset: Dataset, indices: list[int]) -> None:
    wanted, count = set(indices[:3]), 0
    for i, scan in enumerate(dataset):
        count += 1
        assert scan.index == i, f"scan {i} has index {scan.index}"
        if i in wanted:
            assert content(scan) == content(dataset[i]), f"scan {i} differs when iterated over"
    assert count == len(dataset), f"{count} scans when iterated over, len() says {len(dataset)}"


def test_scans_are_finite_and_stamped(dataset: Dataset, indices: list[int]) -> None:
    for i in indices:
        scan = dataset[i]
        assert scan.index == i, f"dataset[{i}] has index {scan.index}"
        assert np.isfinite(scan.stamp), f"scan {i}: stamp {scan.stamp}: expected seconds"
        points = scan.points
        assert points.ndim == 2 and points.shape[1] == 3 and points.dtype == np.float64, (
            f"scan {i}: points {points.shape} {points.dtype}: expected (N, 3) float64, in m"
        )
        assert np.isfinite(points).all(), f"scan {i}: some points are not finite: leave them out"


def test_flags_hold_for_every_scan(dataset: Dataset, indices: list[int]) -> None:
    for i in indices:
        scan = dataset[i]
        assert scan.planar == dataset.planar, f"scan {i}: planar is not that of the data set"
        if dataset.planar:
            assert not scan.points[:, 2].any(), f"scan {i} is planar, with points off z = 0"
        pose = scan.odometry
        assert (pose is not None) == dataset.has_odometry, f"scan {i}: has_odometry is untrue"
        assert pose is None or is_rigid(pose), f"scan {i}: odometry is no rigid motion"
        pose = scan.ground_truth
        assert pose is None or dataset.has_ground_truth, f"scan {i}: has_ground_truth is untrue"
        assert pose is None or is_rigid(pose), f"scan {i}: ground truth is no rigid motion"


def test_ground_truth_is_somewhere(dataset: Dataset, indices: list[int]) -> None:
    if not dataset.has_ground_truth or any(dataset[i].ground_truth is not None for i in indices):
        return
    known = any(scan.ground_truth is not None for scan in dataset)
    assert known, "has_ground_truth is True, but no scan has one"


def test_beams_are_what_the_points_come_from(dataset: Dataset, indices: list[int]) -> None:
    for i in indices:
        ranges, angles = dataset[i].ranges, dataset[i].angles
        both = ranges is not None and angles is not None
        assert both == dataset.has_beams, f"scan {i}: has_beams is untrue"
        if ranges is None or angles is None:
            continue
        assert ranges.shape == angles.shape, (
            f"scan {i}: {len(ranges)} ranges and {len(angles)} angles: NaN is for lost beams"
        )
        returns = int(np.isfinite(ranges).sum())
        assert returns == len(dataset[i].points), (
            f"scan {i}: {returns} beams with a range, {len(dataset[i].points)} points"
        )


def test_relations_are_rigid(dataset: Dataset) -> None:
    relations = dataset.relations
    if relations is None:
        pytest.skip("has no relations")
    assert len(relations.start) == len(relations.end) == len(relations.T_start_end), (
        "relations: start, end and T_start_end differ in length"
    )
    assert all(is_rigid(T) for T in relations.T_start_end), "a relation is no rigid motion"


def test_the_fingerprint_tells_data_sets_apart(
    dataset: Dataset, catalogue: Catalogue, member: Member
) -> None:
    mark = dataset.fingerprint()
    assert isinstance(mark, str) and mark.strip(), f"fingerprint() gave {mark!r}: expected text"
    assert mark == dataset.fingerprint(), "fingerprint() changes from call to call"
    again = catalogue.build(member)
    assert mark == again.fingerprint(), "the same settings give another fingerprint"
    if "seed" not in catalogue.node(member):
        return
    other = catalogue.build(member, "dataset.seed=4711")
    assert mark != other.fingerprint(), "another seed gives the same fingerprint"
