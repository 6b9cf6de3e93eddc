"""Every search gives a start, in the right direction, and leaves what it is handed alone."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from rbtm_bench.backends.base import Backend, Prepared
from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import WORLDS, World
from rbtm_bench.core.geometry import inverse, rigidity_error, rotation_angle, translation_norm
from rbtm_bench.core.types import Array
from rbtm_bench.search.base import Search

GROUP = "search"


@pytest.fixture(scope="module")
def search(catalogue: Catalogue, member: Member) -> Search:
    """The search under test."""
    search: Search = catalogue.build(member)
    return search


@pytest.fixture(scope="module")
def backend(catalogue: Catalogue) -> Backend:
    """The baseline: it registers to where it starts."""
    backend: Backend = catalogue.build(Member("backend", "none"))
    return backend


def prepared(search: Search, backend: Backend) -> Iterator[tuple[World, Prepared, Prepared, Array]]:
    """The worlds that it searches: source, target and the true T_target_source of a pair."""
    for name in search.dimensions:
        world = WORLDS[name]
        motion = world.motions["curve"]
        source, target = (backend.prepare(scan) for scan in world.pair(motion, 0.005))
        yield world, source, target, motion.T_target_source


def test_a_right_guess_is_kept(search: Search, backend: Backend) -> None:
    for world, source, target, truth in prepared(search, backend):
        start = search.start(source, target, truth)
        assert rigidity_error(start.T_target_source) < 1e-6, "start() gives no rigid motion"
        off = inverse(truth) @ start.T_target_source
        metres, degrees = float(translation_norm(off)), float(np.degrees(rotation_angle(off)))
        most = 5 * world.tolerance_m, 5 * world.tolerance_deg
        assert metres <= most[0] and degrees <= most[1], (
            f"{world.name}: from the true motion start() goes {metres:.3f} m and {degrees:.2f} deg"
        )


def test_a_start_repeats_and_changes_nothing(search: Search, backend: Backend) -> None:
    for _, source, target, guess in prepared(search, backend):
        before = source.points.tobytes(), target.points.tobytes(), guess.tobytes()
        starts = {search.start(source, target, guess).T_target_source.tobytes() for _ in range(3)}
        assert len(starts) == 1, "three calls of start() give different motions"
        after = source.points.tobytes(), target.points.tobytes(), guess.tobytes()
        assert after == before, "start() modified scans or guess"


def test_a_backend_starts_where_the_search_ends(search: Search, backend: Backend) -> None:
    for _, source, target, guess in prepared(search, backend):
        start = search.start(source, target, guess)
        alignment = search.before(backend).register(source, target, guess)
        np.testing.assert_allclose(alignment.T_target_source, start.T_target_source, atol=1e-9)
