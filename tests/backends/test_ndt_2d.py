"""Biber and Strasser's NDT: its score by hand, its derivatives, its smoothness, its motions."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial import cKDTree

from rbtm_bench.backends.base import Backend
from rbtm_bench.backends.ndt_2d import NDT2D, information, maximise, newton_step, score_terms
from rbtm_bench.backends.ndt_2d_cells import cells_of
from rbtm_bench.backends.open3d_p2p import Open3DPointToPoint
from rbtm_bench.contract.scene import WORLDS, cast, outline
from rbtm_bench.core.errors import BackendError, ConfigError
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, transform, translation_norm, yaw
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import beam_points
from rbtm_bench.odometry import judge

WORLD = WORLDS["2d"]
STILL = np.zeros(3)
PLANE = np.ix_([0, 1, 5], [0, 1, 5])


def flat(*xy: tuple[float, float]) -> Array:
    """Points (N, 3) in z = 0."""
    return np.column_stack([np.array(xy, dtype=float), np.zeros(len(xy))])


def scan(points: Array) -> Scan:
    return Scan(0, 0.0, points, True)


def wall(start: tuple[float, float], end: tuple[float, float], spacing: float) -> Array:
    """Points (N, 3) along a wall, ``spacing`` m apart, half of it from either end."""
    a, b = np.array(start), np.array(end)
    length = float(np.linalg.norm(b - a))
    along = np.arange(spacing / 2, length, spacing) / length
    return np.column_stack([a + along[:, None] * (b - a), np.zeros(len(along))])


# mean (0.25, 0.25), covariance diag(0.005, 0.02), and the whole of it in one half-cell
CROSS = flat((0.15, 0.25), (0.35, 0.25), (0.25, 0.05), (0.25, 0.45))


@pytest.mark.parametrize(
    ("point", "exponent"),
    [
        ((0.25, 0.25), 0.0),
        ((0.35, 0.25), 0.01 / 0.005),
        ((0.25, 0.15), 0.01 / 0.02),
        ((0.30, 0.35), 0.0025 / 0.005 + 0.01 / 0.02),
    ],
)
def test_the_score_of_one_point_by_hand(point: tuple[float, float], exponent: float) -> None:
    """All four cells over the half-cell hold the same points, so each adds the same."""
    cells = cells_of(CROSS, 1.0, 4, 1e-3)
    assert len(cells.normals) == 4
    score = score_terms(flat(point), cells, STILL)[0]
    assert score == pytest.approx(4 * math.exp(-exponent / 2), rel=1e-12)


def test_a_point_is_moved_before_it_is_scored() -> None:
    cells = cells_of(CROSS, 1.0, 4, 1e-3)
    # a quarter turn takes (1, 2) to (-2, 1), and the shift to (0.35, 0.25)
    pose = np.array([2.35, -0.75, math.pi / 2])
    assert score_terms(flat((1, 2)), cells, pose)[0] == pytest.approx(4 * math.exp(-1))


def test_a_point_meets_the_four_cells_over_it() -> None:
    """Cells begin every half metre; the cross lies in [0.5, 1) x [-0.5, 0), at (0.75, -0.25)."""
    cells = cells_of(CROSS + np.array([0.5, -0.5, 0.0]), 1.0, 4, 1e-3)
    over = {(0.75, -0.25): 4, (0.49, -0.25): 2, (1.01, -0.25): 2, (0.75, 0.01): 2, (0.49, 0.01): 1}
    for (x, y), expected in over.items():
        weight = math.exp(-((x - 0.75) ** 2 / 0.005 + (y + 0.25) ** 2 / 0.02) / 2)
        score = score_terms(flat((x, y)), cells, STILL)[0]
        assert score == pytest.approx(expected * weight, rel=1e-9), (x, y)
    for outside in [(0.75, 0.51), (0.75, -1.01)]:
        assert score_terms(flat(outside), cells, STILL)[0] == 0.0


@pytest.mark.parametrize("degrees", [0.0, 30.0, 90.0, 135.0])
def test_a_wall_is_given_a_thickness(degrees: float) -> None:
    """Its smaller eigenvalue is 0.001 of the larger: exp(-1/2) at sqrt(0.001) of its spread."""
    angle = math.radians(degrees)
    along, across = (
        np.array([math.cos(angle), math.sin(angle)]),
        [-math.sin(angle), math.cos(angle)],
    )
    centre = np.array([0.25, 0.25])
    places = [tuple(centre + d * along) for d in (-0.2, -0.1, 0.1, 0.2)]
    cells = cells_of(flat(*places), 1.0, 4, 1e-3)
    deviation = math.sqrt(0.001 * 0.025)  # m, the spread along it being 0.025 m^2
    score = score_terms(flat(tuple(centre + deviation * np.array(across))), cells, STILL)[0]
    assert score == pytest.approx(4 * math.exp(-0.5), rel=1e-9)


def test_a_cell_needs_its_points() -> None:
    assert len(cells_of(CROSS, 1.0, 5, 1e-3).normals) == 0
    assert len(cells_of(np.repeat(CROSS[:1], 9, axis=0), 1.0, 3, 1e-3).normals) == 0  # one place
    # cells from x = 0.5 on hold three of four points when these lie around 0.5
    assert len(cells_of(CROSS + np.array([0.2501, 0, 0]), 1.0, 4, 1e-3).normals) == 2
    assert len(cells_of(CROSS + np.array([0.2501, 0, 0]), 1.0, 3, 1e-3).normals) == 4


def test_far_cells_are_as_good_as_near_ones() -> None:
    """Moments are taken about the cells' centres: nothing cancels a kilometre away."""
    offset = np.array([4096.0, -8192.0, 0.0])
    near = cells_of(CROSS, 1.0, 4, 1e-3).normals
    far = cells_of(CROSS + offset, 1.0, 4, 1e-3).normals
    np.testing.assert_allclose(far[:, :2] - offset[:2], near[:, :2], atol=1e-9)
    np.testing.assert_allclose(far[:, 2:], near[:, 2:], rtol=1e-8)


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0])
def test_gradient_and_hessian_are_the_derivatives_of_the_score(size: float) -> None:
    source, target = WORLD.pair(WORLD.motions["curve"], 0.01)
    cells = cells_of(target.points, size, 3, 1e-3)
    truth = WORLD.motions["curve"].T_target_source
    pose = np.array([truth[0, 3], truth[1, 3], float(yaw(truth))])
    for offset in ([0.0, 0.0, 0.0], [0.003, -0.002, 0.001], [0.05, 0.04, -0.02]):
        at = pose + offset
        terms = score_terms(source.points, cells, at)
        hessian = np.zeros((3, 3))
        hessian[np.tril_indices(3)] = terms[4:]
        hessian[np.triu_indices(3)] = hessian.T[np.triu_indices(3)]
        h = 1e-6
        for i in range(3):
            step = h * np.eye(3)[i]
            ahead, behind = (score_terms(source.points, cells, at + s) for s in (step, -step))
            slope = (ahead[0] - behind[0]) / (2 * h)
            bend = (behind[1:4] - ahead[1:4]) / (2 * h)
            assert slope == pytest.approx(terms[1 + i], rel=1e-5, abs=1e-2)
            scale = np.abs(np.diag(hessian)).max()
            np.testing.assert_allclose(bend, hessian[i], rtol=1e-4, atol=1e-5 * scale)


def wrong_way(values: Array) -> float:
    """How much of its range a line of values goes down before its top, and up behind it."""
    change, top = np.diff(values), int(np.argmax(values))
    back = -np.minimum(change[:top], 0).sum() + np.maximum(change[top:], 0).sum()
    return float(back / np.ptp(values))


@pytest.mark.parametrize("degrees", [0.0, 45.0, 90.0, 135.0])
def test_the_score_is_smooth_where_matches_come_in_steps(degrees: float) -> None:
    """Along a line through the truth the score only rises and falls, in steps of 10 mm over 0.3 m
    to either side; in steps of 0.1 mm it always changes, and steadily, while ICP's share of matched
    points mostly stays as it is and then jumps."""
    known = WORLD.motions["curve"]
    source, target = WORLD.pair(known, 0.01)
    cells, tree = cells_of(target.points, 1.0, 3, 1e-3), cKDTree(target.points)
    x, y, theta = known.T_target_source[0, 3], known.T_target_source[1, 3], math.radians(-8)
    direction = np.array([math.cos(math.radians(degrees)), math.sin(math.radians(degrees)), 0.0])

    def score(shift: float) -> float:
        pose = np.array([x, y, theta]) + shift * direction
        return float(score_terms(source.points, cells, pose)[0])

    def matched(shift: float) -> float:
        moved = transform(se2(*(np.array([x, y, theta]) + shift * direction)), source.points)
        return float((tree.query(moved)[0] < 0.05).mean())

    coarse = np.arange(-0.3, 0.3001, 0.01)
    line = np.array([score(shift) for shift in coarse])
    assert wrong_way(line) < 1e-6
    assert abs(coarse[np.argmax(line)]) < 0.011
    fine = np.arange(0.02, 0.0231, 1e-4)
    change = np.diff([score(shift) for shift in fine])
    jump = np.diff([matched(shift) for shift in fine])
    assert np.median(np.abs(np.diff(change))) < 0.05 * np.abs(change).min()
    assert 0.5 < (jump == 0).mean() < 1.0


def corridor_scan(x: float, seed: int) -> Scan:
    """240 deg seen 4 m far from a place in a corridor with recesses, with 10 mm of noise."""
    upper = [(9, 1), (6, 1), (6, 1.4), (5, 1.4), (5, 1), (2.5, 1), (2.5, 1.4), (1.5, 1.4), (1.5, 1)]
    upper += [(-2, 1), (-2, 1.4), (-3, 1.4), (-3, 1), (-9, 1)]
    angles = np.deg2rad(np.arange(-120, 120, 0.5))
    ranges = cast(outline((-9, -1), (9, -1), *upper), se2(x, 0, 0), angles)
    ranges += 0.01 * np.random.default_rng(seed).standard_normal(len(angles))
    ranges[ranges > 4] = np.nan
    return Scan(seed, 0.0, beam_points(ranges, angles), True)


def test_it_does_not_stick_in_a_corridor() -> None:
    """Small steps along smooth walls: nearest points stay where they were, cells do not mind."""
    shifts: dict[str, list[float]] = {"ndt": [], "icp": []}
    methods: dict[str, Backend] = {"ndt": NDT2D(0.3), "icp": Open3DPointToPoint(0.3)}
    for pair in range(16):
        start = -1.0 + 0.13 * pair
        scans = corridor_scan(start + 0.01, 2 * pair), corridor_scan(start, 2 * pair + 1)
        for name, method in methods.items():
            source, target = (method.prepare(scan) for scan in scans)
            result = judge.register(method, source, target, np.eye(4))
            shifts[name].append(float(result.T_target_source[0, 3]))
    assert np.mean(shifts["icp"]) < 0.004
    assert 0.006 < np.mean(shifts["ndt"]) < 0.018


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("motion", ["still", "forward", "left", "turn", "curve", "from_far_guess"])
def test_known_motions(motion: str, noise: float) -> None:
    backend, known = NDT2D(0.5), WORLD.motions[motion]
    source, target = (backend.prepare(s) for s in WORLD.pair(known, noise))
    result = judge.register(backend, source, target, known.guess)
    error = inverse(known.T_target_source) @ result.T_target_source
    assert result.converged is True and 1 <= (result.iterations or 0) <= 30
    assert float(translation_norm(error)) < 0.005
    assert math.degrees(float(rotation_angle(error))) < 0.1


def test_coarse_cells_first_reach_farther() -> None:
    guess = se2(0.3, 0.2, 0.1) @ se2(0.4, -0.3, math.radians(20))
    source, target = (
        WORLD.scan(WORLD.start @ T, i, 0.01)
        for i, T in enumerate((se2(0.3, 0.2, 0.1), np.eye(4)), start=1)
    )
    off = {}
    for sizes in ((1.0,), (4.0, 2.0, 1.0)):
        backend = NDT2D(0.5, cell_sizes=sizes)
        result = judge.register(backend, backend.prepare(source), backend.prepare(target), guess)
        off[sizes] = float(translation_norm(inverse(se2(0.3, 0.2, 0.1)) @ result.T_target_source))
    assert off[4.0, 2.0, 1.0] < 0.005 < 0.1 < off[1.0,]


@pytest.mark.parametrize("seed", range(20))
def test_a_step_always_climbs(seed: int) -> None:
    """Whatever the Hessian: at a maximum, at a saddle, or flat along a corridor."""
    random = np.random.default_rng(seed)
    basis = np.linalg.qr(random.standard_normal((3, 3)))[0]
    eigenvalues = random.choice([-1e4, -1.0, 0.0, 1.0, 1e4], size=3)
    H = basis @ np.diag(eigenvalues) @ basis.T
    gradient = random.standard_normal(3)
    terms = np.concatenate([[1.0], gradient, H[np.tril_indices(3)]])
    assert newton_step(terms, 3.0) @ gradient > 0.0
    positive = H + (1.0 - eigenvalues.min()) * np.eye(3)
    terms[4:] = positive[np.tril_indices(3)]
    np.testing.assert_allclose(
        newton_step(terms, 3.0), np.linalg.solve(positive, gradient), rtol=1e-6, atol=1e-9
    )


def test_no_step_lowers_the_score() -> None:
    source, target = WORLD.pair(WORLD.motions["turn"], 0.01)
    cells = cells_of(target.points, 1.0, 3, 1e-3)
    settings = NDT2D(0.5, max_iterations=1).settings
    pose, score = STILL, 0.0
    for _ in range(25):
        pose, terms, _, converged = maximise(source.points, cells, pose, settings)
        assert terms[0] >= score
        score = terms[0]
    assert converged


def test_it_says_when_it_has_not_converged() -> None:
    known = WORLD.motions["curve"]
    source, target = WORLD.pair(known, 0.01)
    for backend, guess in ((NDT2D(0.5, max_iterations=2), np.eye(4)), (NDT2D(0.5), se2(50, 0, 0))):
        result = judge.register(backend, backend.prepare(source), backend.prepare(target), guess)
        assert result.converged is False
    assert result.iterations == 0  # no point lies in a cell
    assert result.information is None


def test_the_information_is_the_bend_of_the_score_in_the_source_s_frame() -> None:
    known = WORLD.motions["from_far_guess"]
    backend = NDT2D(0.5)
    source, target = (backend.prepare(s) for s in WORLD.pair(known, 0.01))
    result = judge.register(backend, source, target, known.guess)
    assert result.information is not None
    T, h = result.T_target_source, 1e-5
    cells = target.native[0]

    def score(d: Array) -> float:
        moved = T @ se2(*d)
        return score_terms(source.points, cells, np.array([*moved[:2, 3], float(yaw(moved))]))[0]

    eye = h * np.eye(3)
    bend = [
        [-(score(a + b) - score(a - b) - score(b - a) + score(-a - b)) / (4 * h * h) for b in eye]
        for a in eye
    ]
    held = result.information[PLANE]
    np.testing.assert_allclose(bend, held, rtol=1e-3, atol=1e-3 * np.abs(held).max())


def test_points_spread_like_their_cell_carry_fisher_s_information() -> None:
    """n / sigma^2, with no factor of our own."""
    random = np.random.default_rng(3)
    spread = np.array([0.02, 0.04])
    target, source = (0.25 + spread * random.standard_normal((4000, 2)) for _ in range(2))
    cells = cells_of(target, 1.0, 3, 1e-3)
    terms = score_terms(source, cells, STILL)
    np.testing.assert_allclose([terms[4], terms[6]], 4000 / spread**2, rtol=0.1)


def test_a_corridor_is_weak_along_its_axis() -> None:
    heading = math.radians(25)
    walls = [wall((-6, y), (6, y), 0.05) for y in (-1, 1)]
    points = transform(se2(0, 0, heading), np.concatenate(walls))
    points[:, :2] += 0.005 * np.random.default_rng(1).standard_normal((len(points), 2))
    backend = NDT2D(0.5)
    prepared = backend.prepare(scan(points))
    result = judge.register(backend, prepared, prepared, np.eye(4))
    assert result.information is not None
    values, vectors = np.linalg.eigh(result.information[:2, :2])
    assert values[0] < 0.01 * values[1]
    assert abs(vectors[:, 0] @ [math.cos(heading), math.sin(heading)]) > 0.99


def test_no_information_where_there_is_no_maximum() -> None:
    saddle = np.array([1.0, 0, 0, 0, 5.0, 0, -1.0, 0, 0, 2.0])
    assert information(saddle, 0.3) is None


def test_what_it_refuses() -> None:
    with pytest.raises(ConfigError, match="at least one size"):
        NDT2D(cell_sizes=[])
    with pytest.raises(BackendError, match="planar scans only"):
        NDT2D().prepare(Scan(0, 0.0, CROSS.repeat(2, axis=0)))
