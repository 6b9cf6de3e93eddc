"""Every recovery gives rigid starts, the same every time, and leaves what it is handed alone."""

from __future__ import annotations

import pytest

from rbtm_bench.backends.base import Backend
from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import WORLDS
from rbtm_bench.core.geometry import rigidity_error, se2
from rbtm_bench.recovery.base import Recovery

GROUP = "recovery"


@pytest.fixture(scope="module")
def recovery(catalogue: Catalogue, member: Member) -> Recovery:
    """The recovery under test."""
    recovery: Recovery = catalogue.build(member)
    return recovery


@pytest.fixture(scope="module")
def backend(catalogue: Catalogue) -> Backend:
    """The baseline: it prepares points as they are."""
    backend: Backend = catalogue.build(Member("backend", "none"))
    return backend


@pytest.mark.parametrize("world", ["2d", "3d"])
def test_starts_are_motions_that_repeat(recovery: Recovery, backend: Backend, world: str) -> None:
    motion = WORLDS[world].motions["curve"]
    source, target = (backend.prepare(scan) for scan in WORLDS[world].pair(motion, 0.005))
    guess, rest = motion.T_target_source.copy(), se2(0.02, 0.0, 0.01)
    before = source.points.tobytes(), target.points.tobytes(), guess.tobytes(), rest.tobytes()
    seen = set()
    for _ in range(2):
        starts = recovery.restarts(source, target, guess, rest)
        for name, T in starts:
            assert name.strip(), "a restart has no name"
            assert rigidity_error(T) < 1e-6, f"{name}: no rigid motion"
        seen.add(tuple((name, T.tobytes()) for name, T in starts))
    assert len(seen) == 1, "restarts() differ from call to call"
    after = source.points.tobytes(), target.points.tobytes(), guess.tobytes(), rest.tobytes()
    assert after == before, "restarts() modified scans or motions"
