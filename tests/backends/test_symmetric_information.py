"""Information is symmetric to its last bit where it is made, not only where it is handed on."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import WORLDS, World

CATALOGUE = Catalogue()


@pytest.mark.parametrize("world", WORLDS.values(), ids=list(WORLDS))
@pytest.mark.parametrize("member", CATALOGUE.members("backend"), ids=lambda m: m.name)
def test_a_method_s_own_matrix_is_symmetric(member: Member, world: World) -> None:
    distance = f"registration.max_correspondence_distance={world.distance}"
    backend = CATALOGUE.build(member, distance, "registration.voxel_size=0.0")
    if world.name not in backend.dimensions:
        pytest.skip(f"{member} is for {', '.join(backend.dimensions)} only")
    source, target = world.pair(world.motions["curve"], 0.01)
    found = backend.align(backend.prepare(source), backend.prepare(target), np.eye(4))
    if found.information is None:
        pytest.skip(f"{member} gives none")
    np.testing.assert_array_equal(found.information, found.information.T)
