"""The workbench changes nothing but the time: the same bits, the same rows, true times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from step_helpers import TIMES, assert_same, steps

from rbtm_bench.core.step_columns import STEPS
from rbtm_bench.pairs.store import PairStore
from rbtm_bench.runs import assembly, pictures
from rbtm_bench.runs.settings import compose_settings
from rbtm_bench.runs.workbench import Workbench

SCANS = "dataset.scans=40"

METHODS = {
    "odometry": ["guess=odometry", "selector.window=12", "selector.threshold=0.8"],
    "chain": ["guess=chain", "selector.window=12", "selector.threshold=0.5"],
    "constant_velocity": ["guess=constant_velocity", "selector.window=6"],
    "keyframes": ["guess=odometry", "selector.content=keyframes", "selector.window=4"],
    "local_map": ["guess=odometry", "target=local_map", "selector.window=8"],
    "gated": ["guess=odometry", "check=gated", "check.min_fitness=0.97", "selector.window=8"],
    "literal": ["guess=odometry", "similarity=curvature", "selector.threshold=0.3"],
    "previous": ["guess=odometry", "selector=previous"],
    "kiss_icp": ["guess=odometry", "backend=kiss_icp"],
    "skip": ["guess=odometry", "selector.fallback=skip", "selector.threshold=0.99"],
}


@pytest.mark.parametrize("name", METHODS)
def test_same_bits_plain_first_again_and_from_disk(name: str, tmp_path: Path) -> None:
    settings = compose_settings([SCANS, *METHODS[name]])
    plain = steps(assembly.instantiate(settings))
    with PairStore(tmp_path) as store:
        bench = Workbench(store)
        assert_same(plain, steps(bench.parts(settings)))
        assert_same(plain, steps(bench.parts(settings)))
    with PairStore(tmp_path) as store:  # another process would see the same
        assert_same(plain, steps(Workbench(store).parts(settings)))


def test_the_second_run_reuses_and_says_so(tmp_path: Path) -> None:
    settings = compose_settings([SCANS, *METHODS["odometry"]])
    with PairStore(tmp_path) as store:
        first = steps(Workbench(store).parts(settings))
    with PairStore(tmp_path) as store:
        again = steps(Workbench(store).parts(settings))
    assert [s.record.reused for s in first[1:]] == [False] * 39
    assert [s.record.reused for s in again[1:]] == [True] * 39
    # the time of a reused registration is the one it took, to the bit
    assert [s.record.t_register_s for s in again] == [s.record.t_register_s for s in first]


def test_grid_points_share_registrations() -> None:
    bench = Workbench()
    wide = compose_settings([SCANS, *METHODS["odometry"]])
    narrow = compose_settings([SCANS, "guess=odometry", "selector.window=5"])
    done = {(s.record.model, s.record.scan) for s in steps(bench.parts(wide))[1:]}
    for step in steps(bench.parts(narrow))[1:]:
        pair = (step.record.model, step.record.scan)
        assert step.record.reused is (pair in done)


def test_a_chain_is_registered_once_for_all_points() -> None:
    bench = Workbench()
    first = compose_settings([SCANS, "guess=chain", "selector.window=3"])
    second = compose_settings([SCANS, "guess=chain", "selector.window=20"])
    before = steps(bench.parts(first))
    after = steps(bench.parts(second))
    assert [s.record.t_guess_s for s in before] == [s.record.t_guess_s for s in after]
    assert sum(s.record.t_guess_s for s in after) > 0.0


def test_other_data_other_backend_other_seed_share_nothing(tmp_path: Path) -> None:
    words = [SCANS, "guess=odometry", "selector=previous"]
    with PairStore(tmp_path) as store:
        bench = Workbench(store)
        for change in ([], ["seed=1"], ["backend.max_iterations=49"], ["dataset.beams=341"]):
            run = steps(bench.parts(compose_settings([*words, *change])))
            assert not any(s.record.reused for s in run[1:]), change


def test_a_tiny_memory_changes_no_bit() -> None:
    settings = compose_settings([SCANS, *METHODS["odometry"]])
    plain = steps(assembly.instantiate(settings))
    bench = Workbench(memory_mb=0.05)
    assert_same(plain, steps(bench.parts(settings)))
    assert_same(plain, steps(bench.parts(settings)))


def test_every_time_of_a_step_is_exempt_from_the_comparison() -> None:
    names = {column.name for column in STEPS}
    assert {name for name in names if name.startswith("t_")} == set(TIMES)


def test_matrices_for_pictures_are_the_same_bits() -> None:
    settings = compose_settings([SCANS, *METHODS["odometry"]])
    plain, shared = assembly.instantiate(settings), Workbench().parts(settings)
    scans, expected = pictures.similarity_matrix(plain.dataset, plain.method.similarity)
    _, found = pictures.similarity_matrix(shared.dataset, shared.method.similarity)
    assert len(scans) == 40
    np.testing.assert_array_equal(found, expected)
