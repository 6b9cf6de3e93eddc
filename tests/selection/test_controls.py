"""The strategies that RBTM is compared with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array, Node
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.fixed_gap import FixedGap
from rbtm_bench.selection.keyframe import Keyframe
from rbtm_bench.selection.oldest import Oldest
from rbtm_bench.selection.previous import Previous
from rbtm_bench.selection.random_gap import RandomGap, read_gaps
from rbtm_bench.selection.shifted_gap import ShiftedGap, digest, sequence


def chosen(selector: Selector, poses: list[Array], left_out: set[int] | None = None) -> list[int]:
    """The model scan that each scan of a drive would try first; no scores are known."""
    window, models = selector.window(), []
    for scan, pose in enumerate(poses):
        if len(window):
            unknown = np.full(len(window), np.nan)
            models.append(selector.select(scan, window.scans, unknown).candidates[0].model)
        if scan not in (left_out or set()):
            window.push(Node(scan, 0.0, pose))
    return models


def drive(count: int, step: float = 0.125) -> list[Array]:
    return [se2(step * i, 0, 0) for i in range(count)]


def test_previous() -> None:
    assert chosen(Previous(), drive(6)) == [0, 1, 2, 3, 4]
    assert chosen(Previous(), drive(6), left_out={2, 3}) == [0, 1, 1, 1, 4]


@pytest.mark.parametrize(
    ("gap", "expected"), [(1, [0, 1, 2, 3, 4]), (3, [0, 0, 0, 1, 2]), (100, [0, 0, 0, 0, 0])]
)
def test_fixed_gap_is_clamped_at_the_start(gap, expected) -> None:
    assert chosen(FixedGap(gap), drive(6)) == expected


def test_fixed_gap_takes_the_nearest_where_a_scan_is_missing() -> None:
    """Scan 5 wants 2, which is left out: 1 and 3 are as near, the older one is taken."""
    assert chosen(FixedGap(3), drive(7), left_out={2}) == [0, 0, 0, 1, 1, 3]


def test_fixed_gap_takes_neither_the_oldest_nor_the_newest_where_more_are_missing() -> None:
    """Scan 6 wants 3: of 1, 2 and 5 the nearest is 2; scan 7 wants 4: of 2, 5 and 6 it is 5."""
    assert chosen(FixedGap(3), drive(8), left_out={3, 4}) == [0, 0, 0, 1, 2, 2, 5]


@pytest.mark.parametrize(
    ("gap", "expected"),
    [
        (2.5, [2, 3, 2, 3, 2, 3]),  # floor of 2.5 i: 0 2 5 7 10 12 15
        (3.4, [3, 3, 4, 3, 4, 3, 3, 4, 3, 4]),  # 0 3 6 10 13 17 20 23 27 30 34
        (1.25, [1, 1, 1, 2]),  # 0 1 2 3 5
    ],
)
def test_a_gap_between_whole_numbers_is_dithered(gap, expected) -> None:
    selector = FixedGap(gap)
    models = np.arange(100 - selector.capacity, 100)
    positions = [selector.order(i, models - 100 + i, models)[0][0] for i in range(1, 41)]
    gaps = [selector.capacity - position for position in positions]
    assert gaps[: len(expected)] == expected
    assert abs(np.mean(gaps) - gap) < 1 / 40


def test_a_dithered_gap_is_clamped_at_the_start() -> None:
    assert chosen(FixedGap(2.5), drive(8)) == [0, 0, 1, 1, 3, 3, 5]


# shifted_gap


def shifted(offset: int, gaps: list[int], scans: int = 7, **settings: Any) -> list[int]:
    """The model scan of each scan, -1 for one without a candidate."""
    selector = ShiftedGap(gaps=gaps, offset=offset, **settings)
    window, models = selector.window(), []
    for scan, pose in enumerate(drive(scans)):
        if len(window):
            unknown = np.full(len(window), np.nan)
            found = selector.select(scan, window.scans, unknown).candidates
            models.append(found[0].model if found else -1)
        window.push(Node(scan, 0.0, pose))
    return models


GAPS = [1, 2, 1, 3, 1, 5]


@pytest.mark.parametrize(
    ("offset", "expected"),
    [
        (0, [0, 0, 2, 1, 4, 1]),  # the gaps as they are
        (1, [0, 1, 0, 3, 0, 5]),  # 2 1 3 1 5 1, the first clipped at the start
        (3, [0, 1, 0, 3, 3, 5]),  # 3 1 5 1 2 1, the first and the third clipped
        (6, [0, 0, 2, 1, 4, 1]),  # all the way round
    ],
)
def test_shifted_gaps_by_hand(offset, expected) -> None:
    assert shifted(offset, GAPS) == expected


def test_every_rotation_has_the_same_gaps_as_often() -> None:
    gaps = [1, 2, 1, 3, 1, 2, 2, 1]
    for offset in range(8):
        models = shifted(offset, gaps, scans=25)  # three rounds
        drawn = [scan - model for scan, model in enumerate(models, start=1)][8:]
        assert sorted(drawn) == sorted(gaps * 2)


def test_shifted_gaps_end_where_the_window_does() -> None:
    assert shifted(0, [1, 2, 3, 4, 5, 6], window=4) == [0, 0, 0, 1, 2, 3]


def test_a_scan_that_was_registered_to_nothing_is_again() -> None:
    assert shifted(0, [1, 0, 2, 0]) == [0, -1, 1, -1, 4, -1]
    assert shifted(1, [1, 0, 2, 0]) == [-1, 0, -1, 3, -1, 4]


def test_shifted_gaps_of_keyframes_take_the_nearest_one() -> None:
    """Keyframes 0, 3, 6: scan 5 wants 1, which is none, scan 6 wants 1 as well."""
    settings = {"content": "keyframes", "keyframe_distance": 0.3}
    assert shifted(0, [1, 1, 1, 1, 4, 5], **settings) == [0, 0, 0, 3, 0, 0]


def test_shifted_gaps_are_those_of_the_very_run(tmp_path: Path) -> None:
    """The first scan has no gap; others without one count."""
    write_steps(tmp_path / "steps.parquet", scan=list(range(6)), gap=[None, 1, 2, None, 4, 4])
    assert sequence(tmp_path) == [1, 2, 0, 4, 4]
    known = digest([1, 2, 0, 4, 4])
    assert ShiftedGap(gaps_from=str(tmp_path), gaps_sha256=known).gaps == [1, 2, 0, 4, 4]
    write_steps(tmp_path / "steps.parquet", scan=list(range(6)), gap=[None, 1, 2, None, 4, 3])
    with pytest.raises(DataError, match="the run was made again, by other settings"):
        ShiftedGap(gaps_from=str(tmp_path), gaps_sha256=known)
    write_steps(tmp_path / "steps.parquet", scan=[0, 1], gap=pa.nulls(2, pa.int64()))
    with pytest.raises(DataError, match="no registered scan"):
        ShiftedGap(gaps_from=str(tmp_path))


@pytest.mark.parametrize("settings", [{}, {"gaps": []}, {"gaps": [1], "gaps_from": "somewhere"}])
def test_shifted_gap_wants_gaps_from_one_place(settings: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match=r"shifted_gap: expected either selector\.gaps_from"):
        ShiftedGap(**settings)


def test_oldest_is_the_oldest_of_the_window() -> None:
    assert chosen(Oldest(window=4), drive(7)) == [0, 0, 0, 1, 2, 3]


def test_oldest_keyframe() -> None:
    """Keyframes 0, 3, 6, 9, 12; two fit beside the new scan."""
    selector = Oldest(window=3, content="keyframes", keyframe_distance=0.3)
    assert chosen(selector, drive(14)) == [0] * 6 + [3] * 3 + [6] * 3 + [9]


def test_keyframe_by_distance() -> None:
    """0.375 m is the first multiple of 0.125 m beyond 0.3 m."""
    assert chosen(Keyframe(0.3, 15.0), drive(9)) == [0, 0, 0, 3, 3, 3, 6, 6]


def test_keyframe_at_exactly_the_distance() -> None:
    assert chosen(Keyframe(0.25, 15.0), drive(6)) == [0, 0, 2, 2, 4]


@pytest.mark.parametrize("sense", [1, -1])
def test_keyframe_by_angle(sense) -> None:
    turning = [se2(0, 0, sense * np.radians(6.0 * i)) for i in range(9)]
    assert chosen(Keyframe(0.3, 15.0), turning) == [0, 0, 0, 3, 3, 3, 6, 6]


def test_keyframes_are_judged_against_the_last_one_not_the_path() -> None:
    """Back and forth within 0.3 m never makes a new keyframe."""
    shuttle = [se2(0.2 * (i % 2), 0, 0) for i in range(8)]
    assert chosen(Keyframe(0.3, 15.0), shuttle) == [0] * 7


@pytest.mark.parametrize("selector", [Previous(), FixedGap(3), Oldest(4), Keyframe()])
def test_controls_need_no_scores_and_have_one_way_out(selector) -> None:
    """One candidate, then the newest scan; unknown scores are not called undefined."""
    assert not selector.needs_scores
    selection = selector.select(9, np.arange(6, 9), np.full(3, np.nan))
    assert selection.undefined == 0
    assert len({c.model for c in selection.candidates}) == len(selection.candidates) <= 2
    assert selection.candidates[-1].model == 8 or type(selector) is Keyframe


# random_gap


def random_gaps(count: int = 300, **settings: Any) -> list[int]:
    """The gaps drawn in mid-run."""
    selector = RandomGap(**settings)
    models = chosen(selector, drive(count + selector.capacity))
    return [scan - model for scan, model in enumerate(models, start=1)][selector.capacity :]


def test_random_gap_draws_only_given_gaps() -> None:
    drawn = random_gaps(gaps=[2, 7, 7, 7])
    assert set(drawn) == {2, 7}
    assert 0.65 < np.mean(np.array(drawn) == 7) < 0.85, "as often as they are given"


def test_random_gap_is_clamped_at_the_start() -> None:
    assert chosen(RandomGap(gaps=[50]), drive(6)) == [0] * 5


def test_the_seed_decides() -> None:
    assert random_gaps(gaps=[1, 2, 3], seed=5) == random_gaps(gaps=[1, 2, 3], seed=5)
    assert random_gaps(gaps=[1, 2, 3], seed=5) != random_gaps(gaps=[1, 2, 3], seed=6)


def write_steps(path: Path, **columns: list[Any]) -> None:
    pq.write_table(pa.table(columns), path)


def test_gaps_of_another_run(tmp_path: Path) -> None:
    """Scans without a registration have no gap."""
    write_steps(tmp_path / "steps.parquet", scan=list(range(6)), gap=[None, 1, 2, None, 4, 4])
    assert read_gaps(tmp_path) == read_gaps(tmp_path / "steps.parquet") == [1, 2, 4, 4]
    selector = RandomGap(gaps_from=str(tmp_path))
    assert selector.capacity == 4
    assert set(random_gaps(gaps_from=str(tmp_path))) == {1, 2, 4}


def missing(path: Path) -> None:
    """Write no file."""


def empty(path: Path) -> None:
    path.touch()


def damaged(path: Path) -> None:
    write_steps(path, gap=[1, 2, 3])
    path.write_bytes(path.read_bytes()[:-20])


def nonsense(path: Path) -> None:
    path.write_text("scan,gap\n1,1\n")


def no_column(path: Path) -> None:
    write_steps(path, scan=[1, 2])


def no_rows(path: Path) -> None:
    pq.write_table(pa.table({"gap": pa.array([], pa.int64())}), path)


def no_registration(path: Path) -> None:
    pq.write_table(pa.table({"gap": pa.array([None, None], pa.int64())}), path)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (missing, "no steps.parquet: expected a run folder"),
        (empty, "not readable as a run's steps"),
        (damaged, "not readable as a run's steps"),
        (nonsense, "not readable as a run's steps"),
        (no_column, "not readable as a run's steps"),
        (no_rows, "no registered scan"),
        (no_registration, "no registered scan"),
    ],
)
def test_a_run_without_gaps(tmp_path: Path, spoil, message) -> None:
    spoil(tmp_path / "steps.parquet")
    with pytest.raises(DataError, match=message) as caught:
        RandomGap(gaps_from=str(tmp_path))
    assert str(tmp_path) in str(caught.value)


@pytest.mark.parametrize("settings", [{}, {"gaps": []}, {"gaps": [1], "gaps_from": "somewhere"}])
def test_random_gap_needs_one_source(settings) -> None:
    with pytest.raises(ConfigError, match=r"expected either selector\.gaps_from"):
        RandomGap(**settings)
