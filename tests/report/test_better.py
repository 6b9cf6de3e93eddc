"""The rule of "better": exact tests and intervals by hand, Holm, distinctness, words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stat_helpers import MM, make_replicates, make_run, make_seeds, shown

from rbtm_bench.plots import cost, groups
from rbtm_bench.plots import methods as plot_methods
from rbtm_bench.report import better, frame, intervals, margin, paired, screen, verdict
from rbtm_bench.report.better import REPLICATES, Comparison, adjusted, exact_p, needed
from rbtm_bench.report.margin import DEFAULT, Margin, margin_of
from rbtm_bench.report.replicates import counted, spread
from rbtm_bench.runs import stored

TEN = [10.0, 11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0, 18.0, 19.0]


def methods(folder: Path) -> dict[str, frame.MethodRuns]:
    return {m.row["selector"]: m for m in frame.methods(stored.find_runs([folder]))}


def comparison(folder: Path, ours: str = "rbtm", other: str = "previous", by: Margin = DEFAULT):
    of = methods(folder)
    one = better.compare(of[ours], of[other], MM, by)
    assert one is not None
    return adjusted([one])[0]


# --- tests


def test_exact_p_by_hand() -> None:
    # all ten signs alike: 2 of 1024 ways are as far out
    assert exact_p(TEN, [2 * v for v in TEN]) == pytest.approx(2 / 1024)
    # log ratios 1, 2, -4 in units of log 2: sums of sign flips +-7 +-5 +-3 +-1, |-1| is the least
    assert exact_p([2, 4, 1], [1, 1, 16]) == pytest.approx(1.0)
    # 1, 2, 4: only +++ and --- reach 7
    assert exact_p([2, 4, 16], [1, 1, 1]) == pytest.approx(2 / 8)
    # 1, -2, 4: 3 is reached by +-7, +-5, +-3
    assert exact_p([2, 1, 16], [1, 4, 1]) == pytest.approx(6 / 8)


def test_no_difference_is_no_test_and_zeros_are_compared_as_they_are() -> None:
    assert exact_p([1.0, 2.0], [1.0, 2.0]) is None and exact_p([1.0], [2.0]) is None
    assert exact_p([0.0] * 8, TEN[:8]) == pytest.approx(2 / 256)


def test_of_more_pairs_than_twelve_the_signed_rank_test_is_exact() -> None:
    many = np.arange(1.0, 17.0)
    assert exact_p(many, many * np.linspace(1.1, 2.0, 16)) == pytest.approx(2 / 2**16)


@pytest.mark.parametrize(("tests", "pairs"), [(1, 6), (2, 7), (12, 9), (25, 10), (26, 11)])
def test_how_many_replicates_a_table_needs(tests: int, pairs: int) -> None:
    assert needed(tests) == pairs
    assert tests * 2.0 ** (1 - pairs) < 0.05 <= tests * 2.0 ** (2 - pairs)


def test_ratio_of_medians_by_hand() -> None:
    over = intervals.ratio_interval(np.array(TEN), 4 * np.array(TEN))
    assert over is not None and (over.value, over.low, over.high) == (0.25, 0.25, 0.25)
    assert intervals.ratio_interval(np.zeros(4), np.ones(4)) is None
    assert intervals.ratio_interval(np.ones(2), np.ones(2)).low is None  # type: ignore[union-attr]


# --- the rule


def test_better_takes_all_three(tmp_path: Path) -> None:
    make_replicates(tmp_path, "previous", TEN)
    make_replicates(tmp_path, "rbtm", [v / 4 for v in TEN])
    one = comparison(tmp_path)
    assert one.holds == "better" and one.shortfalls == [] and one.p == pytest.approx(2 / 1024)
    words = "rbtm is 4 times better on this log, under these perturbations ([4, 4], p 0.002, "
    assert one.words("rbtm") == words + "10 replicates)"
    assert comparison(tmp_path, "previous", "rbtm").holds == "worse"
    beyond = comparison(tmp_path, by=Margin(5.0, "a placebo"))
    assert beyond.holds == "" and "not beyond 5, what placebos reach" in beyond.words("rbtm")
    assert "rbtm is 4 times lower, not called better" in beyond.words("rbtm")
    (many, *_) = adjusted([one] * 30)
    assert many.holds == "" and "10 pairs cannot hold of 30: 11 replicates needed" in str(
        many.shortfalls
    )


def test_seven_trajectories_are_too_few_and_equal_ones_count_once(tmp_path: Path) -> None:
    make_replicates(tmp_path, "previous", TEN)
    make_replicates(tmp_path, "rbtm", [v / 4 for v in TEN], same=[3, 4, 5, 6])
    one = comparison(tmp_path)
    assert one.distinct == 7 and one.n == 10 and one.holds == ""
    assert "7 distinct trajectories of 8" in one.words("rbtm")
    rbtm = methods(tmp_path)["rbtm"]
    assert len(counted(rbtm.runs)) == 7 == rbtm.row["replicates"]
    assert rbtm.row[MM] == pytest.approx(np.median([2.5, 2.75, 3.0, 4.0, 4.25, 4.5, 4.75]))


def test_who_failed_on_a_replicate_is_not_called_better(tmp_path: Path) -> None:
    make_replicates(tmp_path, "previous", TEN)
    make_replicates(tmp_path, "rbtm", [*(v / 4 for v in TEN[:9]), None])
    one = comparison(tmp_path)
    assert one.n == 9 and one.holds == "" and one.shortfalls == ["a run of it failed"]
    assert comparison(tmp_path, "previous", "rbtm").holds == ""


def test_trajectories_that_are_the_same_are_called_equal(tmp_path: Path) -> None:
    for selector in ("previous", "rbtm"):
        make_replicates(tmp_path, selector, TEN, prefix="both")
    assert comparison(tmp_path).words("rbtm") == "rbtm is equal, trajectory by trajectory"


def test_one_run_is_only_lower_on_this_run(tmp_path: Path) -> None:
    for selector, error in (("previous", 20.0), ("rbtm", 5.0)):
        make_run(tmp_path / selector, selector, {MM: error}, fingerprint="log")
    one = comparison(tmp_path)
    assert one.words("rbtm") == "rbtm is 4 times lower on this run" and one.p is None
    text = screen.of_runs(tmp_path, screen.tables_of([tmp_path]))
    assert "rbtm is 4 times lower on this run" in text and "better" not in text


def test_over_data_sets_with_six_or_more(tmp_path: Path) -> None:
    make_seeds(tmp_path / "6", "previous", TEN[:6])
    make_seeds(tmp_path / "6", "rbtm", [v / 1.5 for v in TEN[:6]])
    one = comparison(tmp_path / "6")
    assert one.words("rbtm").startswith("rbtm is 1.5 times better over 6 data sets ([1.5, 1.5], p")
    make_seeds(tmp_path / "5", "previous", TEN[:5])
    make_seeds(tmp_path / "5", "rbtm", [v / 10 for v in TEN[:5]])
    assert comparison(tmp_path / "5").words("rbtm") == "rbtm is 10 times lower on these 5 runs"


def test_replicates_of_one_log_are_not_several_logs(tmp_path: Path) -> None:
    make_replicates(tmp_path, "previous", TEN)
    make_replicates(tmp_path, "rbtm", [v / 4 for v in TEN])
    table = paired.against(stored.find_runs([tmp_path]), "previous")
    (row,) = table.to_dict("records")
    assert (row["unit"], row["holds"], row["difference_n"]) == (REPLICATES, "better", 10)
    assert (row["ratio"], row["margin"]) == (0.25, DEFAULT.factor)
    assert row["difference"] == pytest.approx(-0.75 * 14.5) and row["p"] == pytest.approx(2 / 1024)
    assert "under these perturbations" in " ".join(paired.difference_notes(table))


# --- the margin


def neighbours(folder: Path, medians: list[float], first: float = 0.44) -> list[Any]:
    target = "rbtm_bench.selection.keyframe.Keyframe"
    for i, value in enumerate(medians):
        distance = round(first + 0.02 * i, 3)
        more = {"_target_": target, "distance": distance}
        make_replicates(folder, "keyframe", [value] * 3, name=f"k{i}", **more)
    return frame.methods(stored.find_runs([folder]))


def test_the_margin_is_what_neighbours_reach(tmp_path: Path) -> None:
    made = neighbours(tmp_path / "7", [1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 3.0])
    of_log = margin_of(made, MM)  # 6 of 21 pairs have a ratio of 3
    assert of_log.factor == pytest.approx(3.0) and "21 pairs" in of_log.source
    few = neighbours(tmp_path / "4", [1.0, 9.0, 1.0, 9.0])
    assert margin_of(few, MM) is DEFAULT
    far = neighbours(tmp_path / "far", [1.0] * 7, first=0.02)  # .02 to .14 m: no neighbours
    assert margin_of(far, MM) is DEFAULT
    assert DEFAULT.factor > 1 and "placebo.py" in DEFAULT.source and 0.9 < margin.QUANTILE < 1


# --- what is shown


def test_a_comparison_says_what_its_better_took(tmp_path: Path, capsys: Any) -> None:
    make_replicates(tmp_path, "previous", TEN, unperturbed=14.0)
    make_replicates(tmp_path, "rbtm", [v / 4 for v in TEN], unperturbed=9.0)
    text = screen.of_runs(tmp_path, screen.tables_of([tmp_path]))
    assert "rbtm is 4 times better on this log, under these perturbations" in text
    assert f"after Holm over 1 comparisons, a ratio beyond {DEFAULT.factor:.3g}" in text
    assert "outside its replicates:\n  p2p rbtm: 9, replicates 2.5 to 4.75" in text
    assert "12.2 - 16.8" in text and "repeat" not in text and "the data differ" not in text
    out, _ = shown(capsys, str(tmp_path), "--over-seeds", "-f", "csv")
    ends = ("_q1", "_q3", "_worst", "_unperturbed")
    assert all(f"{MM}{end}" in out.splitlines()[0] for end in ends)
    out, _ = shown(capsys, str(tmp_path), "--intervals")
    assert "(10)" in out and "over its replicates" in out


def test_tables_of_replicates_fit_and_say_what_tells_rows_apart(
    tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    for guess, factor in {"odometry": 1.0, "odometry_chained": 0.5}.items():
        errors = [factor * v for v in TEN]
        make_replicates(tmp_path, "rbtm", errors, name=guess, guess=guess)
    for options in ([], ["--intervals"], ["--against", "guess=odometry"]):
        out, _ = shown(capsys, str(tmp_path), *options)
        lines = [line for line in out.splitlines() if not line.startswith("next:")]  # a path
        assert max(map(len, lines)) <= 100
        assert "guess=odometry_chained" in out and "odometry-3" not in out  # a row a method
    assert "0.5 [0.5, 0.5] (10)" in out  # the ratio of this method to the reference
    every, _ = shown(capsys, str(tmp_path), "-f", "csv")
    assert len(every.splitlines()) == 21  # a row a run


def test_figures_show_replicates_and_not_the_run_beside_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cost, "TIME", MM)
    make_replicates(tmp_path, "rbtm", TEN, unperturbed=500.0, same=[9, 10])
    make_replicates(tmp_path, "previous", [2 * v for v in TEN], unperturbed=500.0)
    runs = stored.find_runs([tmp_path])
    (part,) = plot_methods.data_parts(runs)
    assert sorted(map(len, part.cells.values())) == [9, 10] and max(part.values) == 38.0
    (data,) = groups.data_sets(runs)
    points = {point.method: point for point in cost.read(data, MM)}
    assert points["Previous"].error == 29.0 and points["Previous"].quartiles == (24.5, 33.5)
    assert groups.repeats(runs) == "replicates" and points["RBTM"].scaled(0.5).error == 7.0


def test_the_spread_of_a_method(tmp_path: Path) -> None:
    make_replicates(tmp_path, "rbtm", TEN, unperturbed=14.0)
    over = spread(methods(tmp_path)["rbtm"].runs, MM)
    assert over is not None
    assert (over.q1, over.median, over.q3, over.worst) == (12.25, 14.5, 16.75, 19.0)
    assert (over.unperturbed, over.outside, over.distinct) == (14.0, False, 10)
    make_run(tmp_path / "lone" / "a", "rbtm", {MM: 3.0}, fingerprint="log")
    assert spread(methods(tmp_path / "lone")["rbtm"].runs, MM) is None


def test_a_verdict_pays_for_every_setting_and_control(tmp_path: Path) -> None:
    for i in range(6):
        make_replicates(tmp_path, "rbtm", [v / 4 for v in TEN], name=f"r{i}", window=i + 2)
    for i in range(5):
        make_replicates(tmp_path, "keyframe", TEN, name=f"k{i}", distance=float(i + 1))
    made = frame.methods(stored.find_runs([tmp_path]))
    line, rule = verdict.verdict(frame.table_of(made), made)
    assert "better" not in line.replace("not called better", "")
    assert "10 pairs cannot hold of 30" in line and "Holm over 30 comparisons" in rule
    six = Comparison(np.ones((2, 10)), REPLICATES, DEFAULT, p=0.001)
    assert [one.tests for one in adjusted([six, six])] == [2, 2]
