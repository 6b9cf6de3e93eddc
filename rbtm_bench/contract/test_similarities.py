"""Every similarity scores alike scans high, the same way by every road, and admits ignorance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import TinyClouds
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.types import Array, Node, Scan
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.pairs.shared import KnownScores
from rbtm_bench.selection.window import Window
from rbtm_bench.similarity.base import Descriptor, Similarity

GROUP = "similarity"
AGREE = 1e-12


@pytest.fixture(scope="module")
def datasets() -> list[Dataset]:
    """Planar scans with beams, and clouds without: noise-free, from places close together."""
    return [Corridor(scans=12, range_noise=0.0), TinyClouds(scans=8)]


@pytest.fixture(scope="module")
def similarity(catalogue: Catalogue, member: Member) -> Similarity:
    """The similarity under test."""
    similarity: Similarity = catalogue.build(member)
    return similarity


def is_readable(similarity: Similarity, dataset: Dataset) -> bool:
    """Whether ``check`` passes the data set."""
    try:
        similarity.check(dataset)
    except ConfigError:
        return False
    return True


@pytest.fixture(scope="module")
def dataset(similarity: Similarity, datasets: list[Dataset]) -> Dataset:
    """A data set that the similarity can read."""
    readable = [dataset for dataset in datasets if is_readable(similarity, dataset)]
    if not readable:
        pytest.fail(
            "check() refuses a planar data set with beams and 3D clouds without: what is "
            "left to read?"
        )
    return readable[0]


@pytest.fixture(scope="module")
def descriptors(similarity: Similarity, dataset: Dataset) -> Descriptor:
    """Descriptors (N, D) of the whole data set."""
    rows = [similarity.describe(scan) for scan in dataset]
    shapes = {row.shape for row in rows}
    assert len(shapes) == 1 and len(next(iter(shapes))) == 1, (
        f"descriptors of shapes {shapes}: expected 1-D arrays of one length, so that a window of "
        "them is a matrix"
    )
    kinds = {row.dtype for row in rows}
    assert len(kinds) == 1, f"descriptors of types {kinds}: expected one type for a whole data set"
    return np.stack(rows)


def differ(a: Array, b: Array) -> float:
    """The largest difference; infinite where only one is undefined."""
    if a.shape != b.shape or (np.isnan(a) != np.isnan(b)).any():
        return float("inf")
    return float(np.nanmax(np.abs(a - b), initial=0.0))


def test_check_passes_or_says_why_not(similarity: Similarity, datasets: list[Dataset]) -> None:
    for dataset in datasets:
        try:
            similarity.check(dataset)
        except ConfigError as error:
            assert str(error).strip(), "check() raised a ConfigError without a word"
        except Exception as error:
            pytest.fail(f"check() of {type(dataset).__name__}: {error!r}: expected ConfigError")


def test_what_check_passes_can_be_described(
    similarity: Similarity, datasets: list[Dataset]
) -> None:
    for dataset in datasets:
        if is_readable(similarity, dataset):
            assert similarity.describe(dataset[0]).ndim == 1, "descriptor: expected (D,)"


def test_describing_leaves_the_scan_alone_and_repeats(
    similarity: Similarity, dataset: Dataset
) -> None:
    scan = dataset[3]
    before = [None if a is None else a.tobytes() for a in (scan.points, scan.ranges, scan.angles)]
    first, second = similarity.describe(scan), similarity.describe(scan)
    after = [None if a is None else a.tobytes() for a in (scan.points, scan.ranges, scan.angles)]
    assert after == before, "describe() modified the scan"
    assert first.tobytes() == second.tobytes(), "describing a scan twice gives other bits"


def test_scores_have_a_shape_and_a_range(similarity: Similarity, descriptors: Descriptor) -> None:
    before = descriptors.tobytes()
    for window in (1, 2, len(descriptors)):
        scores = similarity.scores(descriptors[:window], descriptors[0])
        assert scores.shape == (window,), f"scores {scores.shape}: expected ({window},)"
        assert scores.dtype == np.float64, f"scores are {scores.dtype}: expected float64"
        known = scores[~np.isnan(scores)]
        assert ((known >= -1) & (known <= 1)).all(), f"scores beyond [-1, 1]: {known}"
    assert descriptors.tobytes() == before, "scores() modified the descriptors"


def test_a_scan_is_most_like_itself(similarity: Similarity, descriptors: Descriptor) -> None:
    matrix = similarity.matrix(descriptors)
    own = np.diag(matrix)
    assert not np.isnan(own).any(), "a scan's score against itself is undefined (NaN)"
    assert own.min() >= 0.999, f"a scan's score against itself is {own.min():.4f}: expected 1"
    best = np.nanmax(matrix, axis=1)
    assert (own >= best - AGREE).all(), "another scan is more like a scan than the scan itself"
    others = matrix[~np.eye(len(matrix), dtype=bool)]
    assert np.nanmin(others) < 0.9999, "every scan is fully like every other: scores say nothing"


def test_all_roads_lead_to_the_same_scores(similarity: Similarity, descriptors: Descriptor) -> None:
    count = len(descriptors)
    matrix = similarity.matrix(descriptors)
    assert matrix.shape == (count, count), f"matrix() {matrix.shape}: expected ({count}, {count})"
    scores = np.stack([similarity.scores(descriptors, d) for d in descriptors], axis=1)
    assert differ(matrix, scores) <= AGREE, "matrix() and scores() differ"
    part = similarity.pairwise(descriptors[:5], descriptors[2:])
    assert differ(part, matrix[:5, 2:]) <= AGREE, "pairwise() and matrix() differ"
    window = 4
    band = similarity.band(descriptors, window)
    assert band.shape == (count, window - 1), f"band() {band.shape}: expected (N, window - 1)"
    expected = np.full(band.shape, np.nan)
    for scan in range(count):
        for gap in range(1, min(window - 1, scan) + 1):
            expected[scan, gap - 1] = matrix[scan - gap, scan]
    assert differ(band, expected) <= AGREE, (
        "band() and matrix() differ: column g - 1 of row j must hold S(j, j - g), NaN for g > j"
    )


def test_scores_do_not_depend_on_the_window(
    similarity: Similarity, descriptors: Descriptor
) -> None:
    new = descriptors[-1]
    whole = similarity.scores(descriptors, new)
    alone = np.concatenate([similarity.scores(row[None], new) for row in descriptors])
    assert differ(whole, alone) <= AGREE, (
        "a score depends on the other members of the window: it must be a function of two scans"
    )


def test_scores_are_symmetric(similarity: Similarity, descriptors: Descriptor) -> None:
    matrix = similarity.matrix(descriptors)
    assert differ(matrix, matrix.T) <= AGREE, "S(j, k) and S(k, j) differ"


def without_returns(scan: Scan) -> Scan:
    """The same reading with nothing in sight."""
    ranges = None if scan.ranges is None else np.full(len(scan.ranges), np.nan)
    return replace(scan, points=np.zeros((0, 3)), ranges=ranges)


def test_a_scan_without_returns_has_no_score(
    similarity: Similarity, dataset: Dataset, descriptors: Descriptor
) -> None:
    nothing = similarity.describe(without_returns(dataset[0]))
    assert nothing.shape == descriptors[0].shape and nothing.dtype == descriptors.dtype, (
        "the descriptor of a scan without returns has another shape or type than the others"
    )
    forward = similarity.scores(descriptors, nothing)
    backward = similarity.scores(np.stack([nothing, nothing]), descriptors[0])
    itself = similarity.scores(nothing[None], nothing)
    assert np.isnan(np.concatenate([forward, backward, itself])).all(), (
        "a scan without any return has a score: what is unknown must be NaN"
    )


def some_motions(count: int) -> Array:
    """Small motions (count, 4, 4) in the plane, all different."""
    steps = np.arange(1.0, count + 1) / count
    return np.stack([se2(0.11 * k, -0.07 * k, 0.09 * k) for k in steps])


def test_scores_are_those_of_no_motion(similarity: Similarity, descriptors: Descriptor) -> None:
    still = np.tile(np.eye(4), (len(descriptors), 1, 1))
    scores = similarity.scores(descriptors, descriptors[1])
    under = similarity.scores_under(descriptors, descriptors[1], still)
    assert differ(scores, under) <= AGREE, "scores() and scores_under() no motion differ"


def test_motions_matter_where_they_are_needed(
    similarity: Similarity, descriptors: Descriptor
) -> None:
    scores = similarity.scores(descriptors, descriptors[0])
    far = np.tile(se2(0.7, 0.5, 0.6), (len(descriptors), 1, 1))
    under = similarity.scores_under(descriptors, descriptors[0], far)
    if not similarity.needs_guess:
        assert under.tobytes() == scores.tobytes(), (
            "a motion changes the scores: say needs_guess = True, or no motion will come"
        )
        return
    assert np.isnan(under[0]) or under[0] < scores[0] - 0.01, (
        f"a scan 0.86 m and 34 deg away from itself scores {under[0]:.4f}, in its place "
        f"{scores[0]:.4f}: a similarity with needs_guess must tell them apart"
    )


def test_scores_under_motions_keep_the_rules(
    similarity: Similarity, descriptors: Descriptor
) -> None:
    motions, new = some_motions(len(descriptors)), descriptors[-1]
    before = descriptors.tobytes(), motions.tobytes()
    scores = similarity.scores_under(descriptors, new, motions)
    again = similarity.scores_under(descriptors, new, motions)
    assert (descriptors.tobytes(), motions.tobytes()) == before, "arguments are modified"
    assert scores.tobytes() == again.tobytes(), "the same question gives other bits"
    assert scores.shape == (len(descriptors),) and scores.dtype == np.float64
    known = scores[~np.isnan(scores)]
    assert ((known >= -1) & (known <= 1)).all(), f"scores beyond [-1, 1]: {known}"
    alone = [
        similarity.scores_under(row[None], new, T[None])
        for row, T in zip(descriptors, motions, strict=True)
    ]
    assert differ(scores, np.concatenate(alone)) <= AGREE, "a score depends on the window"


def test_scores_under_a_motion_are_symmetric(
    similarity: Similarity, descriptors: Descriptor
) -> None:
    motions, new = some_motions(len(descriptors)), descriptors[-1]
    forward = similarity.scores_under(descriptors, new, motions)
    backward = [
        similarity.scores_under(new[None], row, inverse(T)[None])
        for row, T in zip(descriptors, motions, strict=True)
    ]
    assert differ(forward, np.concatenate(backward)) <= AGREE, (
        "S(j, k) under T and S(k, j) under its inverse differ"
    )


def test_a_scan_without_returns_has_no_score_under_any_motion(
    similarity: Similarity, dataset: Dataset, descriptors: Descriptor
) -> None:
    nothing = similarity.describe(without_returns(dataset[0]))
    motions = some_motions(len(descriptors))
    forward = similarity.scores_under(descriptors, nothing, motions)
    backward = similarity.scores_under(nothing[None], descriptors[0], motions[:1])
    assert np.isnan(np.concatenate([forward, backward])).all(), "a score out of nothing"


def test_a_sweep_shares_the_same_bits(
    similarity: Similarity, dataset: Dataset, descriptors: Descriptor
) -> None:
    shared = KnownScores(similarity, dataset)
    shared.widen(3)
    numbers, _ = shared.describe(list(dataset))
    motions = some_motions(len(descriptors))
    new = len(descriptors) - 1
    for first in (0, len(descriptors) - 4):  # beyond the band, and within it
        window = Window(len(descriptors))
        for scan in range(first, new):
            window.push(Node(scan, 0.0, np.eye(4), descriptor=numbers[scan]))
        models = slice(first, new)
        expected = similarity.scores(descriptors[models], descriptors[new])
        scores, _ = shared.scores(window, new)
        assert scores.tobytes() == expected.tobytes(), "shared scores are other bits"
        expected = similarity.scores_under(descriptors[models], descriptors[new], motions[models])
        scores, _ = shared.scores(window, new, motions[models])
        assert scores.tobytes() == expected.tobytes(), "shared scores under a guess: other bits"
