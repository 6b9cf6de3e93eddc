"""What the similarities do on the simulated corridor and on a real log: the figures of
docs/similarity.md, with bounds that hold over seeds."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.selection.rbtm import Rbtm
from rbtm_bench.similarity.base import Similarity
from rbtm_bench.similarity.curvature import Curvature
from rbtm_bench.similarity.curvature_circular import CurvatureCircular
from rbtm_bench.similarity.mutual_neighbours import MutualNeighbours
from rbtm_bench.similarity.overlap import Overlap
from rbtm_bench.similarity.points import PointSimilarity
from rbtm_bench.similarity.range_correlation import RangeCorrelation

SEEDS = range(3)
STEP_M = 0.01
"""Between scans of the paper's corridor: a gap of 100 scans is 1 m."""


@cache
def corridor(environment: Any, noise_m: float, seed: int = 0) -> Corridor:
    return Corridor(environment=environment, range_noise=noise_m, seed=seed)


def matrix_of(similarity: Similarity, drive: Corridor, turn_deg: float = 0.0) -> Array:
    """Fig. 1(c), of a sensor that is mounted turned by so much."""
    turn = np.radians(turn_deg)
    scans = [replace(s, angles=s.angles + turn) for s in drive if s.angles is not None]
    return similarity.matrix(np.stack([similarity.describe(s) for s in scans]))


def at_gap(matrix: Array, gap: int) -> float:
    """The mean score of all pairs so many scans apart."""
    return float(np.mean(np.diagonal(matrix, gap)))


def robust(**settings: Any) -> CurvatureCircular:
    """With the half-span of configs/dataset/corridor.yaml."""
    return CurvatureCircular(half_span_deg=5.0, **settings)


def test_the_literal_descriptor_without_noise() -> None:
    """Walls that the sensor meets at exactly 90 deg have phi = +-pi/2 by the last bit of the
    simulation's ranges: that alone costs half. Turned a little, the score is what it should be."""
    drive = corridor("paper", 0.0)
    straight, turned = (matrix_of(Curvature(), drive, turn) for turn in (0.0, 10.0))
    assert 0.50 < at_gap(straight, 1) < 0.58
    assert 0.90 < at_gap(turned, 1) < 0.92
    folded = Curvature().matrix(np.abs(np.stack([Curvature().describe(s) for s in drive])))
    assert 0.94 < at_gap(folded, 1) < 0.97


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(("noise_m", "highest"), [(0.005, 0.40), (0.010, 0.30)])
def test_the_literal_descriptor_drowns_in_noise(noise_m, highest, seed) -> None:
    drive = corridor("paper", noise_m, seed)
    matrix = matrix_of(Curvature(), drive)
    assert abs(at_gap(matrix, 1)) < 0.05
    assert np.nanmax(matrix[np.triu_indices(len(matrix), 1)]) < highest
    selector = Rbtm(window=64, threshold=0.5)
    for scan in range(1, len(drive)):
        models = np.arange(max(0, scan - 63), scan)
        assert selector.order(scan, models, matrix[models, scan]) == [], "RBTM fired"


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize(
    ("half_span_deg", "step", "thirty_steps"),
    [
        (0.4, (0.36, 0.40), (0.13, 0.17)),
        (3, (0.94, 0.96), (0.40, 0.44)),
        (5, (0.97, 0.98), (0.39, 0.43)),
    ],
)
def test_a_wider_difference_survives_10_mm(half_span_deg, step, thirty_steps, seed) -> None:
    matrix = matrix_of(CurvatureCircular(half_span_deg), corridor("paper", 0.010, seed))
    assert step[0] < at_gap(matrix, 1) < step[1]
    assert thirty_steps[0] < at_gap(matrix, 30) < thirty_steps[1]


@pytest.mark.parametrize(
    ("similarity", "noise_m", "environment", "gaps"),
    [
        (Curvature(), 0.0, "paper", [1, 2, 5, 10, 20, 30, 60, 100]),
        (robust(), 0.010, "paper", range(1, 41)),
        (robust(lag_phase="consistent"), 0.010, "paper", range(1, 41)),
        (robust(center=True), 0.010, "paper", [*range(1, 21), 30, 60, 100]),
        (robust(), 0.010, "cluttered", [*range(1, 11), 100]),
        (robust(), 0.010, "l_turn", range(1, 71)),
    ],
    ids=["literal", "circular", "consistent", "center", "cluttered", "l_turn"],
)
def test_similarity_decays_with_distance(similarity, noise_m, environment, gaps) -> None:
    """Fig. 1(c): the score falls as the gap grows."""
    matrix = matrix_of(similarity, corridor(environment, noise_m))
    means = [at_gap(matrix, gap) for gap in gaps]
    assert (np.diff(means) < 0).all()


def test_similar_is_not_near() -> None:
    """The recesses repeat every 1.6 m, and so does the score: only the window tells them apart."""
    matrix = matrix_of(robust(), corridor("paper", 0.010))
    means = np.array([at_gap(matrix, gap) for gap in range(1, 181)])
    assert 1 + np.argmax(means[100:]) + 100 == round(1.6 / STEP_M)
    assert means[159] > 0.96 and means[99] < 0.4


def above_diagonal(similarity: Similarity, seed: int = 0) -> Array:
    matrix = matrix_of(similarity, corridor("bare", 0.010, seed))
    return matrix[np.triu_indices(len(matrix), 1)]


@pytest.mark.parametrize("phase", ["free", "consistent"])
@pytest.mark.parametrize(("half_span_deg", "least"), [(3, 0.94), (5, 0.98)])
def test_a_bare_corridor_looks_the_same_everywhere(half_span_deg, least, phase) -> None:
    """Without centring and without min_variance, places up to 20 m apart score 0.95 to 0.99."""
    scores = above_diagonal(CurvatureCircular(half_span_deg, lag_phase=phase, min_variance=0.0))
    assert scores.min() > least


@pytest.mark.parametrize("seed", SEEDS)
def test_a_bare_corridor_is_undefined_by_default(seed) -> None:
    """The variance of its walls is noise: 0.01 at a half-span of 5 deg, 0.03 to 0.05 at 3 deg."""
    assert np.isnan(above_diagonal(robust(), seed)).all()
    assert np.isnan(above_diagonal(CurvatureCircular(), seed)).mean() > 0.99
    noisy = corridor("bare", 0.020, seed)
    assert not np.isnan(matrix_of(CurvatureCircular(), noisy)).any(), "a limit: 20 mm, 3 deg"


@pytest.mark.parametrize("phase", ["free", "consistent"])
@pytest.mark.parametrize("half_span_deg", [3, 5])
def test_a_bare_corridor_is_unlike_itself_with_center(half_span_deg, phase) -> None:
    scores = above_diagonal(
        CurvatureCircular(half_span_deg, lag_phase=phase, center=True, min_variance=0.0)
    )
    assert abs(scores.mean()) < 0.07 and scores.max() < 0.3


@pytest.mark.parametrize("environment", ["paper", "cluttered", "l_turn"])
def test_places_with_structure_are_always_defined(environment) -> None:
    assert not np.isnan(matrix_of(robust(), corridor(environment, 0.010))).any()


@pytest.mark.parametrize(("log", "share"), [("aces", 0.01), ("mit-csail", 0.02)])
def test_few_real_scans_are_undefined(data_dir: Path, log, share) -> None:
    similarity = CurvatureCircular()
    scans = Carmen(str(data_dir / "freiburg" / f"{log}.clf.gz"), stride=3)
    blank = [not similarity.describe(scan).any() for scan in scans]
    assert len(blank) > 600 and np.mean(blank) < share


def under(similarity: PointSimilarity, drive: Corridor, gap: int, off: Array) -> float:
    """The mean score of pairs so many scans apart, under a guess that is ``off`` from the truth."""
    scores = []
    for first in range(0, len(drive) - gap, 7):
        model, scan = drive[first], drive[first + gap]
        assert model.ground_truth is not None and scan.ground_truth is not None
        guess = inverse(model.ground_truth) @ scan.ground_truth @ off
        window = similarity.describe(model)[None]
        scores.append(similarity.scores_under(window, similarity.describe(scan), guess[None])[0])
    return float(np.mean(scores))


@pytest.mark.parametrize("seed", SEEDS)
def test_overlap_is_not_fooled_by_recesses_that_repeat(seed) -> None:
    drive = corridor("paper", 0.010, seed)
    true = [under(Overlap(), drive, gap, np.eye(4)) for gap in (1, 30, 60, 100, 160)]
    assert true == sorted(true, reverse=True)
    assert true[0] > 0.99 and 0.54 < true[-1] < 0.60
    ranges = matrix_of(RangeCorrelation(), drive)
    assert at_gap(ranges, 160) > 0.98 > 0.92 > at_gap(ranges, 100)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_an_error_of_the_guess_costs(seed) -> None:
    """At 0.3 m overlap hardly sees 5 deg; at 0.05 m, and with mutual neighbours, it is halved."""
    drive, off = corridor("paper", 0.010, seed), se2(0, 0, np.radians(5))
    cost = {
        name: under(similarity, drive, 10, off) / under(similarity, drive, 10, np.eye(4))
        for name, similarity in [
            ("wide", Overlap()),
            ("narrow", Overlap(0.05)),
            ("mutual", MutualNeighbours()),
        ]
    }
    assert cost["wide"] > 0.98 and cost["narrow"] < 0.6 and cost["mutual"] < 0.45


def test_a_guess_is_believed() -> None:
    """A limit: 1 m too long, where nothing in the scans contradicts it."""
    drive = corridor("bare", 0.010)
    assert under(Overlap(), drive, 1, se2(1, 0, 0)) > 0.75
    assert at_gap(matrix_of(RangeCorrelation(), drive), 160) > 0.99
