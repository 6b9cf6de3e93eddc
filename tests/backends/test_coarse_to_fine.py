"""Shrinking correspondence distances reach a motion that one small distance does not."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.backends.open3d_gicp import Open3DGeneralizedICP
from rbtm_bench.backends.open3d_icp import Open3DICP
from rbtm_bench.backends.open3d_p2p import Open3DPointToPoint
from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.contract.scene import WORLDS
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2, translation_norm
from rbtm_bench.core.types import RegistrationResult
from rbtm_bench.odometry import judge

METHODS: list[type[Open3DICP]] = [Open3DPointToPoint, Open3DPointToPlane, Open3DGeneralizedICP]
TRUTH = se2(0.35, 0.2, 0.0)


def register(method: Open3DICP) -> RegistrationResult:
    world = WORLDS["2d"]
    source, target = world.scan(world.start @ TRUTH, 1, 0.005), world.scan(world.start, 2, 0.005)
    return judge.register(method, method.prepare(source), method.prepare(target), np.eye(4))


def error(result: RegistrationResult) -> float:
    """m from the truth."""
    return float(translation_norm(inverse(TRUTH) @ result.T_target_source))


@pytest.mark.parametrize("cls", METHODS)
def test_coarse_to_fine_arrives_where_one_distance_does_not(cls: type[Open3DICP]) -> None:
    single, several = register(cls(0.1)), register(cls(0.1, coarse_to_fine=[8, 4, 2, 1]))
    assert error(single) > 0.2
    assert error(several) < 0.02
    assert several.fitness > 0.9 > single.fitness


@pytest.mark.parametrize("cls", METHODS)
def test_fitness_is_that_of_the_last_distance(cls: type[Open3DICP]) -> None:
    """A point 0.2 m off is no inlier at 0.1 m, whatever the coarse steps accept."""
    result = register(cls(0.1, coarse_to_fine=[8, 4, 2, 1]))
    assert result.inlier_rmse < 0.1
    assert result.library_fitness == pytest.approx(result.fitness, abs=0.01)


def test_the_factors_multiply_the_distance() -> None:
    assert Open3DPointToPoint(0.2, coarse_to_fine=[4, 1]).distances == [0.8, 0.2]


def test_no_factor_is_a_mistake() -> None:
    with pytest.raises(ConfigError, match="at least one factor"):
        Open3DPointToPoint(0.2, coarse_to_fine=[])
