"""Point-to-line ICP against exact truth, other methods, and the logs that csm was measured on."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from rbtm_bench.backends.base import Backend
from rbtm_bench.backends.open3d_gicp import Open3DGeneralizedICP
from rbtm_bench.backends.open3d_p2p import Open3DPointToPoint
from rbtm_bench.backends.open3d_p2plane import Open3DPointToPlane
from rbtm_bench.backends.plicp import CYCLED, PointToLineICP, iterate, turned
from rbtm_bench.contract.scene import ANGLES, ROOM, cast, cloud, planar_scan
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, transform, translation_norm
from rbtm_bench.core.types import Array, RegistrationResult, Scan
from rbtm_bench.datasets.base import beam_points
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.odometry import judge

START, TRUTH = se2(0.3, -0.2, 0.2), se2(0.1, 0.05, 0.05)
PLACES = {"paper": 0.05, "cluttered": 0.15, "l_turn": 0.15}
"""Environments, and the distance (m) between their scans."""


class Pair(NamedTuple):
    source: Scan
    target: Scan
    guess: Array
    truth: Array


def plicp(distance: float = 0.3, **settings: Any) -> PointToLineICP:
    return PointToLineICP(distance, **settings)


def p2p(distance: float = 0.3, **settings: Any) -> PointToLineICP:
    """As configs/backend/plicp_p2p.yaml has it."""
    usual = {"max_iterations": 200, "outliers_refine_multiplier": 0.0}
    return PointToLineICP(distance, metric="point_to_point", **(usual | settings))


def register(method: Backend, source: Scan, target: Scan, guess: Array) -> RegistrationResult:
    return judge.register(method, method.prepare(source), method.prepare(target), guess)


def errors(method: Backend, pairs: list[Pair]) -> tuple[Array, Array, list[RegistrationResult]]:
    """Translation (m) and rotation errors (deg) of each pair, and the results."""
    results = [register(method, *pair[:3]) for pair in pairs]
    off = np.stack(
        [inverse(pair.truth) @ r.T_target_source for pair, r in zip(pairs, results, strict=True)]
    )
    return translation_norm(off), np.degrees(rotation_angle(off)), results


def room_pairs(count: int, noise: float, guess: Array | None = None) -> list[Pair]:
    """Pairs of scans of the contract's room."""
    start = np.eye(4) if guess is None else guess
    return [
        Pair(
            planar_scan(START @ TRUTH, 2 * i, noise), planar_scan(START, 2 * i + 1, noise),
            start, TRUTH,
        )
        for i in range(count)
    ]  # fmt: skip


def simulated_pairs(environment: Any, seed: int) -> list[Pair]:
    """Every other pair of neighbours of a drive, guesses 30 mm and 1 deg (sigma) off."""
    step = PLACES[environment]
    length = {"paper": 1.8, "cluttered": 6.0, "l_turn": 7.5}[environment]
    scans = Corridor(
        environment=environment, scans=round(length / step) + 1, path_length=length, seed=seed
    )
    random, pairs = np.random.default_rng(1000 + seed), []
    for i in range(0, len(scans) - 1, 2):
        target, source = scans[i], scans[i + 1]
        assert target.ground_truth is not None and source.ground_truth is not None
        truth = inverse(target.ground_truth) @ source.ground_truth
        x, y, turn = np.array([0.03, 0.03, np.deg2rad(1.0)]) * random.standard_normal(3)
        pairs.append(Pair(source, target, truth @ se2(x, y, turn), truth))
    return pairs


def test_it_is_at_least_as_near_as_open3d_s_best() -> None:
    pairs = [pair for place in PLACES for seed in range(4) for pair in simulated_pairs(place, seed)]
    others = [Open3DPointToPoint(0.3), Open3DPointToPlane(0.3), Open3DGeneralizedICP(0.3)]
    ours, *theirs = (float(np.median(errors(m, pairs)[0])) for m in (plicp(), *others))
    assert ours <= min(theirs), f"{ours:.5f} m, Open3D {theirs}"
    assert ours < 0.002


def test_lines_take_fewer_iterations_than_points() -> None:
    """At the same thresholds and the same trimming, from the same guesses to the same place."""
    pairs = room_pairs(10, 0.005)
    same: dict[str, Any] = {"max_iterations": 300, "outliers_refine_multiplier": 0.0}
    lines, _, of_lines = errors(plicp(0.5, **same), pairs)
    points, _, of_points = errors(p2p(0.5, **same), pairs)
    assert lines.max() < 0.006 and points.max() < 0.006
    taken, others = ([r.iterations or 0 for r in results] for results in (of_lines, of_points))
    assert np.median(others) > 2.5 * np.median(taken), (taken, others)
    assert all(few < many for few, many in zip(taken, others, strict=True))


def test_without_noise_lines_are_met_exactly() -> None:
    """Quadratic convergence (Censi 2008): a handful of iterations to micrometres."""
    same: dict[str, Any] = {"outliers_max_percent": 0.7, "epsilon_xy": 1e-9, "epsilon_theta": 1e-9}
    offs, _, results = errors(plicp(outliers_refine_multiplier=0.0, **same), room_pairs(1, 0.0))
    assert offs[0] < 1e-4 and (results[0].iterations or 99) <= 12
    assert results[0].converged is True


@pytest.mark.parametrize("make", [plicp, p2p])
def test_outliers_are_trimmed(make: Any) -> None:
    clean = room_pairs(1, 0.005)[0]
    points = clean.source.points.copy()
    moved = np.random.default_rng(5).random(len(points)) < 0.25
    points[moved, :2] += [0.25, 0.15]
    pair = clean._replace(source=replace(clean.source, points=points))
    loose: dict[str, Any] = {"outliers_max_percent": 1.0, "outliers_adaptive_multiplier": 1e9}
    off = errors(make(0.5), [pair])[0][0]
    without = errors(make(0.5, outliers_refine_multiplier=0.0, **loose), [pair])[0][0]
    assert off < 0.01 < 0.02 < without, (off, without)
    fitness = errors(make(0.5), [pair])[2][0].library_fitness
    assert fitness is not None and 0.5 < fitness <= 1 - 0.7 * moved.mean()


@pytest.mark.parametrize("make", [plicp, p2p])
def test_doubles_can_be_left_out(make: Any) -> None:
    """Of a source with ten points for each of the target's, a tenth is used."""
    target = planar_scan(START, 1, 0.005)
    angles = np.linspace(ANGLES[0], ANGLES[-1], 10 * len(ANGLES))
    source = Scan(2, 0.0, beam_points(cast(ROOM, START @ TRUTH, angles), angles), True)
    free, single = (
        register(make(0.5, outliers_remove_doubles=remove), source, target, np.eye(4))
        for remove in (False, True)
    )
    assert free.library_fitness is not None and single.library_fitness is not None
    assert free.library_fitness > 0.7 and single.library_fitness < 0.11
    for result in (free, single):
        assert translation_norm(inverse(TRUTH) @ result.T_target_source) < 0.01


def test_dense_beams_need_segments_longer_than_the_noise() -> None:
    """Beams 10 mm apart with 10 mm of noise: neighbours in the scan give no direction."""
    pairs = [pair for seed in range(2) for pair in simulated_pairs("l_turn", seed)]
    long, adjacent = (errors(plicp(min_segment_length=s), pairs)[0] for s in (0.1, 0.0))
    assert np.median(long) < 0.85 * np.median(adjacent)
    assert np.mean(long) < 0.7 * np.mean(adjacent)


def test_limits_are_relaxed_in_the_end_for_precision() -> None:
    pairs = [pair for seed in range(3) for pair in simulated_pairs("l_turn", seed)]
    limits = {"trim_floor": 0.0}  # csm's own
    relaxed, strict = (
        errors(plicp(outliers_refine_multiplier=m, **limits), pairs)[0] for m in (3.0, 0.0)
    )
    assert np.median(relaxed) < 0.9 * np.median(strict)


@pytest.mark.parametrize(("floor", "least", "most"), [(0.0, 1000.0, 1800.0), (0.03, 0.0, 20.0)])
def test_nearly_perfect_walls_do_not_trim_the_way_along_them(
    floor: float, least: float, most: float
) -> None:
    """With 1 mm of noise twice the distance of 70 % of the matches is 2 mm: all that tells a step
    of 50 mm along the corridor is trimmed, and the robot stands still (mm of 1800 at the end)."""
    scans = list(Corridor(scans=37, range_noise=0.001))
    method, T, last = plicp(trim_floor=floor), np.eye(4), np.eye(4)
    for target, source in pairwise(scans):
        last = register(method, source, target, last).T_target_source
        T = T @ last
    assert scans[0].ground_truth is not None and scans[-1].ground_truth is not None
    truth = inverse(scans[0].ground_truth) @ scans[-1].ground_truth
    assert least < 1e3 * translation_norm(inverse(truth) @ T) < most


def test_two_walls_are_not_met_half_a_turn_off() -> None:
    """Two lines at a right angle are met as well after half a turn, which noise may favour."""
    walls = np.array([[[-9.0, -1.0], [1.5, -1.0]], [[1.5, -1.0], [1.5, 9.0]]])
    angles = np.deg2rad(np.arange(-80.0, 80.0, 0.5))
    pairs = []
    for seed in range(10):
        scans = []
        for index, pose in enumerate((np.eye(4), se2(0.01, 0.02, 0.02))):
            noise = 0.01 * np.random.default_rng([seed, index]).standard_normal(len(angles))
            ranges = cast(walls, pose, angles)
            ranges[ranges > 4.0] = np.nan
            scans.append(Scan(index, 0.0, beam_points(ranges + noise, angles), True))
        pairs.append(Pair(scans[1], scans[0], np.eye(4), se2(0.01, 0.02, 0.02)))
    metres, degrees, _ = errors(plicp(), pairs)
    assert metres.max() < 0.02 and degrees.max() < 0.5


def test_the_order_of_points_does_not_matter() -> None:
    pair = room_pairs(1, 0.005)[0]
    shuffled = [
        replace(scan, points=np.random.default_rng(i).permutation(scan.points))
        for i, scan in enumerate(pair[:2])
    ]
    plain, other = (register(plicp(), *scans, np.eye(4)) for scans in (pair[:2], shuffled))
    np.testing.assert_allclose(other.T_target_source, plain.T_target_source, atol=1e-12)


def test_a_target_of_scans_that_do_not_quite_agree() -> None:
    """Five scans merged, up to 20 mm off: segments along the walls all the same."""
    method, random = plicp(), np.random.default_rng(3)
    parts = []
    for i in range(5):
        place = se2(0.1 * i, 0.02 * i, 0.05 * i)
        wrong = place @ se2(*(random.uniform(-0.02, 0.02, 2)), 0.003 * random.standard_normal())
        parts.append((method.prepare(planar_scan(START @ place, i, 0.01)), wrong))
    merged = method.merge(parts)
    result = judge.register(
        method, method.prepare(planar_scan(START @ TRUTH, 9, 0.01)), merged, np.eye(4)
    )
    off = inverse(TRUTH) @ result.T_target_source
    assert translation_norm(off) < 0.015 and np.degrees(rotation_angle(off)) < 0.3
    assert result.converged is True


def test_a_pose_that_comes_back_ends_it() -> None:
    """Some matches flip for ever: the best of these poses is taken, long before the last one."""
    method = plicp(0.5, outliers_refine_multiplier=0.0, trim_floor=0.0)
    scans = (planar_scan(START @ TRUTH, 14, 0.01), planar_scan(START, 15, 0.01))
    source, target = (method.prepare(scan) for scan in scans)
    guess = turned(np.eye(4), target.native.turn, -source.native.turn)
    xy = source.native.points.xy
    pose, ending, iterations, _, error = iterate(xy, target.native, guess, method.settings)
    assert ending == CYCLED and iterations < 20
    result = judge.register(method, source, target, np.eye(4))
    assert result.converged is True and result.iterations == iterations
    assert translation_norm(inverse(TRUTH) @ result.T_target_source) < 0.01
    # one more iteration leads away from it, and to no smaller error
    once = method.settings._replace(max_iterations=1)
    after, _, _, _, other = iterate(xy, target.native, pose, once)
    assert np.hypot(*(after - pose)[:2]) > method.settings.epsilon_xy
    assert error <= other


def test_it_says_when_it_did_not_converge() -> None:
    pair = room_pairs(1, 0.005)[0]
    short = register(plicp(max_iterations=2), *pair[:3])
    assert short.converged is False and short.iterations == 2
    most = register(plicp(fail_percent=1.0, outliers_max_percent=0.5), *pair[:3])
    assert most.converged is False, "half of the points are not all"
    away = replace(pair.target, points=pair.target.points + np.array([90.0, 0.0, 0.0]))
    lost = register(plicp(), pair.source, away, np.eye(4))
    assert lost.converged is False and lost.iterations == 0 and lost.information is None
    easy = register(plicp(max_iterations=1), pair.target, pair.target, np.eye(4))
    assert easy.converged is True and easy.iterations == 1


def test_what_it_says_of_its_matches() -> None:
    """A scan moved by 2 cm across one wall: what is left of it and how far."""
    along = np.linspace(-3, 3, 61)
    walls = np.concatenate(
        [np.stack([along, 0 * along - 2], 1), np.stack([0 * along + 4, along], 1)]
    )
    points = np.column_stack([walls, np.zeros(len(walls))])
    scan = Scan(0, 0.0, points, True)
    result = register(plicp(), scan, scan, se2(0.02, -0.03, 0.0))
    np.testing.assert_allclose(result.T_target_source, np.eye(4), atol=1e-9)
    assert result.library_fitness == 1.0
    assert result.library_rmse is not None and result.library_rmse < 1e-9


def test_clouds_are_refused() -> None:
    with pytest.raises(BackendError, match="planar"):
        plicp().prepare(cloud(np.eye(4)))


def test_far_frames_cost_no_precision() -> None:
    """The same pair a kilometre from the target's origin."""
    pair, far = room_pairs(1, 0.005)[0], se2(1000.0, -500.0, 2.0)
    near = register(plicp(), *pair[:3])
    moved = replace(pair.target, points=transform(far, pair.target.points))
    result = register(plicp(), pair.source, moved, far)
    np.testing.assert_allclose(result.T_target_source, far @ near.T_target_source, atol=1e-6)


CSM = {
    # mean error in m and deg of csm's two forms, trimmed alike, distance 1 m (Censi's own code)
    ("intel", "point_to_line"): (0.029, 0.47),
    ("intel", "point_to_point"): (0.030, 0.47),
    ("csail", "point_to_line"): (0.068, 1.69),
    ("csail", "point_to_point"): (0.042, 0.82),
}


@pytest.mark.slow
@pytest.mark.parametrize("log", ["intel", "csail"])
def test_on_real_logs_it_is_as_near_as_csm(data_dir: Path, log: str) -> None:
    """Keyframes to the one before, from raw odometry; within 10 % of csm."""
    scans = list(Carmen(str(data_dir / "corrected" / f"{log}-corrected.log.gz")))
    pairs = []
    for target, source in pairwise(scans):
        assert target.odometry is not None and source.odometry is not None
        assert target.ground_truth is not None and source.ground_truth is not None
        truth = inverse(target.ground_truth) @ source.ground_truth
        pairs.append(Pair(source, target, inverse(target.odometry) @ source.odometry, truth))
    for method, metric in ((plicp(1.0), "point_to_line"), (p2p(1.0), "point_to_point")):
        metres, degrees, _ = errors(method, pairs)
        of_csm = CSM[log, metric]
        assert metres.mean() <= 1.1 * of_csm[0], f"{metric}: {metres.mean():.4f} m"
        assert degrees.mean() <= 1.1 * of_csm[1], f"{metric}: {degrees.mean():.2f} deg"
