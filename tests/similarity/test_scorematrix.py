"""Scores of all pairs in blocks: the same as at once, within a bound, with the guess in between."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.similarity import scorematrix
from rbtm_bench.similarity.base import Descriptor, Similarity
from rbtm_bench.similarity.curvature_circular import CurvatureCircular
from rbtm_bench.similarity.scorematrix import Scores, block_side, compute, refuse_too_large

COUNT = 30


class Motion(Similarity):
    """The x of the guess, and 100 where the new scan is older than its model."""

    needs_guess = True

    def describe(self, scan: Scan) -> Descriptor:
        return np.array([float(scan.index)])

    def scores(self, window: Descriptor, descriptor: Descriptor) -> Array:
        raise AssertionError("scores_under was to be called")

    def scores_under(self, window: Descriptor, descriptor: Descriptor, motions: Array) -> Array:
        return motions[:, 0, 3] + 100.0 * (window[:, 0] > descriptor[0])


@pytest.fixture(scope="module")
def corridor() -> Corridor:
    return Corridor(scans=COUNT)


def described(corridor: Corridor, similarity: Similarity) -> Descriptor:
    return np.stack([similarity.describe(scan) for scan in corridor])


@pytest.mark.parametrize("block", [1, 7, 256])
def test_blocks_change_nothing(
    corridor: Corridor, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scorematrix, "BLOCK", block)
    similarity = CurvatureCircular(half_span_deg=5.0)
    every = described(corridor, similarity)
    matrix = compute(corridor, similarity, None, 100.0)
    assert matrix.scores.dtype == np.float32
    np.testing.assert_array_equal(matrix.scores, similarity.matrix(every).astype(np.float32))
    band = compute(corridor, similarity, 6, 100.0)
    np.testing.assert_array_equal(band.scores, similarity.band(every, 6).astype(np.float32))


def test_the_row_is_the_new_scan_and_its_guess_odometry(corridor: Corridor) -> None:
    matrix = compute(corridor, Motion(), None, 100.0)
    j, k = 12, 5
    T = inverse(corridor[k].odometry) @ corridor[j].odometry
    assert matrix.scores[j, k] == pytest.approx(T[0, 3])
    assert matrix.scores[k, j] == pytest.approx(inverse(T)[0, 3] + 100.0)
    band = compute(corridor, Motion(), 10, 100.0)
    assert band.scores[j, j - k - 1] == matrix.scores[j, k]
    assert np.isnan(band.scores[2, 2:]).all()
    assert matrix.guess.startswith("odometry")


def test_what_goes_with_the_scores(corridor: Corridor) -> None:
    seen: list[tuple[int, int, str]] = []
    band = compute(corridor, Motion(), 4, 100.0, lambda *report: seen.append(report))
    assert seen[-1] == (COUNT, COUNT, "scores") and seen[0] == (1, COUNT, "describing")
    assert band.metres is not None and band.metres[0] == 0.0
    assert band.metres[-1] == pytest.approx(1.8, rel=0.05)
    np.testing.assert_array_equal(band.stamps, [scan.stamp for scan in corridor])
    assert (band.widest, len(band.at_gap(3)), band.undefined_share) == (4, COUNT - 3, 0.0)


def test_undefined_scores_are_counted_among_existing_pairs() -> None:
    scores = np.array([[np.nan, np.nan], [0.5, np.nan], [np.nan, 0.1]], np.float32)
    band = Scores(scores, np.arange(3.0), None, 3)
    assert band.undefined_share == pytest.approx(1 / 3)  # of 1-0, 2-1 and 2-0
    assert band.at_gap(2).tolist() == pytest.approx([0.1])
    matrix = Scores(np.array([[1.0, np.nan], [0.2, 1.0]], np.float32), np.arange(2.0), None, None)
    assert matrix.undefined_share == 0.25 and matrix.at_gap(1).tolist() == pytest.approx([0.2])


def test_what_does_not_fit_is_refused_with_what_does() -> None:
    refuse_too_large(13000, None, 1000.0)
    with pytest.raises(ConfigError, match=r"dataset[.]stride=2$"):  # 676 MB, and 156 of descriptors
        refuse_too_large(13000, None, 1000.0, stride=1, descriptor_bytes=12_000)
    refuse_too_large(6500, None, 1000.0, stride=2, descriptor_bytes=12_000)
    with pytest.raises(
        ConfigError, match=r"use --band selector[.]window=W, or dataset[.]stride=4$"
    ):
        refuse_too_large(20000, None, 1000.0, stride=2)
    with pytest.raises(ConfigError, match=r"use --band selector[.]window=W$"):
        refuse_too_large(20000, None, 1000.0)
    with pytest.raises(ConfigError, match=r"a smaller selector[.]window, or more"):
        refuse_too_large(10**6, 1000, 1000.0)
    with pytest.raises(ConfigError) as refusal:
        refuse_too_large(20000, None, 1000.0)
    wanted = float(str(refusal.value).partition("--memory ")[2].split()[0])
    refuse_too_large(20000, None, wanted + 1)  # what it says is enough


@pytest.mark.parametrize("width", [1, 540, 50_000])
def test_a_block_fits_whatever_a_similarity_makes_of_it(width: int) -> None:
    side = block_side(np.zeros((2, width)), 1000.0)
    assert 1 <= side <= 256
    assert side * side * width * 8 * scorematrix.COPIES <= 250e6 or side == 1


def test_written_and_read(corridor: Corridor, tmp_path: Path) -> None:
    from rbtm_bench.runs.settings import compose_settings

    matrix = compute(corridor, CurvatureCircular(), None, 100.0)
    matrix.write(tmp_path / "s.npz", compose_settings([]).config)
    with np.load(tmp_path / "s.npz") as read:
        assert set(read) == {"scores", "scans", "stamps", "metres", "settings"}
        np.testing.assert_array_equal(read["scores"], matrix.scores)
        assert '"_target_"' in str(read["settings"])
