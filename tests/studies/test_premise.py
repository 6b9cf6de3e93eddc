"""scripts/premise.py end to end, very small, and the pieces that its numbers hang on."""

from __future__ import annotations

import contextlib
import io
import math
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.types import Array
from rbtm_bench.runs.stored import read_run
from rbtm_bench.studies.premise import areas as similarity_areas
from rbtm_bench.studies.premise import command, numbers, plan


def call(*words: str) -> tuple[int, str, str]:
    """Exit code, standard output and standard error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = command.main(list(words))
    return code, out.getvalue(), err.getvalue()


def seeds(values: list[float]) -> numbers.Errors:
    n = len(values)
    return numbers.Errors(np.array(values), np.arange(n), np.zeros(n, bool), median=True)


# --- numbers


def test_the_setting_with_the_least_mean_logarithm_is_chosen() -> None:
    # 1 and 100 (geometric mean 10) against 20 and 20, although the mean of the latter is less
    assert numbers.choose({("a", 0): 20, ("b", 0): 20, ("a", 1): 1, ("b", 1): 100}) == 1
    assert numbers.choose({("a", 0): 5.0, ("a", 1): 5.0}) == 0
    # one that failed somewhere is chosen only where all have
    assert numbers.choose({("a", 0): math.nan, ("b", 0): 1, ("a", 1): 9, ("b", 1): 9}) == 1
    assert numbers.choose({("a", 0): math.nan, ("a", 1): math.nan}) == 0


def test_the_share_of_the_way_to_the_bound() -> None:
    chance = seeds([10.0, 11.0, 12.0, 9.0, 10.0, 10.0])
    bound = seeds([2.0, 2.0, 3.0, 2.0, 1.0, 2.0])
    half = numbers.share(chance, seeds([6.0] * 6), bound)
    assert half.value == pytest.approx(0.5)
    assert half.low < 0.5 < half.high or half.low <= 0.5 <= half.high
    assert numbers.share(chance, bound, bound).value == 1.0
    assert numbers.share(chance, chance, bound).value == 0.0
    assert numbers.share(chance, seeds([14.0] * 6), bound).value == pytest.approx(-0.5)


def test_no_way_to_cover_has_no_share() -> None:
    chance = seeds([1.0, 9.0, 2.0, 8.0, 1.0, 9.0])
    not_surely_better = seeds([2.0, 1.0, 9.0, 3.0, 2.0, 8.0])
    assert math.isnan(numbers.share(chance, chance, not_surely_better).value)
    assert math.isnan(numbers.share(seeds([5.0] * 2), seeds([4.0] * 2), seeds([1.0] * 2)).value)


def test_shares_of_a_log_resample_clusters() -> None:
    clusters = np.repeat(np.arange(10), 5)

    def log(value: float) -> numbers.Errors:
        return numbers.Errors(np.full(50, value), clusters, np.zeros(50, bool), median=False)

    share = numbers.share(log(4.0), log(3.0), log(2.0))
    assert (share.value, share.low, share.high, share.n) == (0.5, 0.5, 0.5, 10)


def test_the_pooled_share_is_of_logarithms() -> None:
    class One:
        """As much of a try as is asked for."""

        class place:  # noqa: N801
            kind = plan.simulated(1, 1)[0].kind

    def outcome(values: list[float]) -> numbers.TryOutcome:
        return numbers.TryOutcome(One, 1, "", [], len(values), seeds(values))

    outcomes = {}
    for place, scale in (("a", 1.0), ("b", 1000.0)):
        outcomes[place, "p", "random_gap"] = outcome([16.0 * scale] * 4)
        outcomes[place, "p", "rbtm"] = outcome([8.0 * scale] * 4)
        outcomes[place, "p", "oracle"] = outcome([1.0 * scale] * 4)
    over = numbers.pooled_share(outcomes, "rbtm")
    assert (over.value, over.low, over.high, over.n) == (
        pytest.approx(0.25), pytest.approx(0.25), pytest.approx(0.25), 4,
    )  # fmt: skip


def straight(n: int, step: float) -> Array:
    return np.stack([se2(i * step, 0.0, 0.0) for i in range(n)])


def test_segments_compare_the_motion_over_ten_metres() -> None:
    truth, estimate = straight(31, 1.0), straight(31, 1.01)
    errors = numbers.segments(estimate, truth)
    assert len(errors.values) == 21  # the last ten have no end 10 m further
    assert np.allclose(errors.values, 0.1)
    assert errors.clusters.tolist() == [0] * 20 + [1]
    assert errors.value == pytest.approx(0.1)
    with pytest.raises(DataError, match="a true way of 9 m: expected more than 10 m"):
        numbers.segments(straight(10, 1.0), straight(10, 1.0))


def test_differences_are_paired_and_tested_over_seeds_only() -> None:
    over, p = seeds([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).minus(seeds([2.0, 3.0, 4.0, 5.0, 6.0, 7.0]))
    assert (over.value, over.low, over.high) == (-1.0, -1.0, -1.0)
    assert p == pytest.approx(2 / 64)
    over, p = seeds([1.0, math.nan, 3.0]).minus(seeds([2.0, 3.0, 4.0]))
    assert over.n == 2 and p is None


def test_a_side_with_failed_runs_is_not_called_better() -> None:
    ours = seeds([1.0] * 10 + [math.nan] * 10)
    theirs = seeds([2.0 + 0.01 * i for i in range(20)])
    assert ours.lacks(theirs) and not theirs.lacks(ours)
    assert theirs.beside(ours) == pytest.approx(2.045)  # over the seeds that both have

    def outcome(name: str, errors: numbers.Errors) -> numbers.TryOutcome:
        return numbers.TryOutcome(None, 4, "", [], 20, errors)

    outcomes = {("a", "p", "rbtm"): outcome("rbtm", ours)}
    outcomes["a", "p", "keyframe"] = outcome("keyframe", theirs)
    (row,) = numbers.against(outcomes).to_dict("records")
    assert row["difference"] < 0 and row["p_holm"] < 0.05 and row["holds"] == ""
    outcomes["a", "p", "rbtm"] = outcome("rbtm", seeds([1.0] * 20))
    (row,) = numbers.against(outcomes).to_dict("records")
    assert row["holds"] == "better"


# --- plan


def test_every_strategy_has_equally_many_tries_and_chance_draws_rbtm_s_gaps() -> None:
    place = plan.simulated(1, 1)[0]
    tries = list(plan.tries(place, ("open3d_p2p",)))
    counts = pd.Series([one.strategy for one in tries]).value_counts()
    assert all(counts[strategy] == 4 for strategy in plan.STRATEGIES)
    assert all(counts[bound] == 1 for bound in (*plan.BOUNDS, "none"))
    stems = {one.stem for one in tries if one.strategy == "rbtm"}
    chance = [one for one in tries if one.strategy == "random_gap"]
    assert {one.source for one in chance} == stems
    overlap = next(one for one in tries if one.strategy == "random_gap_overlap")
    assert overlap.source == "paper-open3d_p2p-rbtm_overlap-1"
    (point,) = plan.points(chance[0], (3,))
    assert point.gaps_of == f"{chance[0].source}-3"
    assert point.settings.config["dataset"]["seed"] == 3
    assert point.settings.config["selector"]["seed"] == 3


# --- end to end


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder, and what was printed."""
    out = tmp_path_factory.mktemp("premise")
    code, text, errors = call(
        "--no-logs", "--seeds", "1", "--backends", "ndt_2d", "--places", "paper",
        "--out", str(out), "--jobs", "2",
    )  # fmt: skip
    assert code == 0, text + errors
    return out, text


def test_the_page_the_tables_and_the_figures_are_there(made: tuple[Path, str]) -> None:
    out, text = made
    page = (out / "README.md").read_text()
    assert "python scripts/premise.py --no-logs --places paper --seeds 1 --backends ndt_2d" in page
    for name in ("table.md", "against.csv", "shares.csv", "errors_simulated.png"):
        assert (out / name).stat().st_size > 100, name
    assert "  paper            ndt_2d          too few" in text  # one seed has no interval


def test_the_rows_are_the_runs(made: tuple[Path, str]) -> None:
    out, _ = made
    table = pd.read_csv(out / "table.csv").set_index(["place", "strategy"])
    assert set(table.loc["paper"].index) == {"none", *plan.STRATEGIES, *plan.BOUNDS}
    row = table.loc["paper", "oracle_pose"]
    run = read_run(out / "runs" / "paper-ndt_2d-oracle_pose-1-0")
    assert row["error"] == pytest.approx(run.metrics["final_translation_error_mm"])
    assert run.config["selector"]["by"] == "pose"
    chance = table.loc["paper", "random_gap"]
    assert chance["setting"] == table.loc["paper", "rbtm"]["setting"]


def test_mistakes_are_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RBTM_BENCH_DATA", raising=False)
    code, _, errors = call("--out", str(tmp_path))
    assert code == 2 and "no logs: set RBTM_BENCH_DATA" in errors
    code, _, errors = call("--no-logs", "--seeds", "0", "--out", str(tmp_path))
    assert code == 2 and "--seeds 0: expected 1 to 100" in errors
    code, _, errors = call("--data", str(tmp_path), "--out", str(tmp_path))
    assert code == 2 and "lacks" in errors
    monkeypatch.setenv("RBTM_BENCH_DATA", str(tmp_path))
    code, _, errors = call("--no-logs", "--places", "moon", "--out", str(tmp_path))
    assert code == 2 and "--places moon" in errors


def test_logs_choose_for_one_another(data_dir: Path, tmp_path: Path) -> None:
    words = ["--max-scans", "60", "--backends", "ndt_2d", "--data", str(data_dir)]
    code, text, errors = call(
        *words, "--places", "aces-corrected,intel-corrected", "--out", str(tmp_path)
    )
    assert code == 0, text + errors
    table = pd.read_csv(tmp_path / "table.csv").set_index(["place", "strategy"])
    assert table.loc["aces-corrected", "keyframe"]["chosen_on"] == "intel-corrected"
    assert (table["failed"] == 0).all()
    assert table.loc["aces-corrected", "oracle"]["error"] > 0


# --- areas


def areas(name: str, auc: float, low: float, high: float, backend: str = "a") -> dict[str, object]:
    row = {"data": "d", "backend": backend, "predictor": name, "compared": "all gaps"}
    row |= {"auc": auc, "auc_low": low, "auc_high": high, "successes": 9.0, "failures": 3.0}
    return row | {"minus_gap_low": 0.01, "minus_gap_high": 0.2, "score_us": 2.0, "describe_us": 5.0}


def test_areas_are_counted_against_chance() -> None:
    rows = [
        areas("overlap", 0.7, 0.6, 0.8),
        areas("overlap", 0.3, 0.2, 0.4, "b"),
        areas("overlap", 0.6, 0.4, 0.8, "c"),
        areas("overlap", math.nan, math.nan, math.nan, "d"),  # no failure at all
    ]
    (line,) = [
        words
        for words in similarity_areas.count_table(pd.DataFrame(rows)).splitlines()
        if "overlap" in words
    ]
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells == ["overlap", "1 / 1 of 3", "0 / 0 of 0", "4 / 0 of 4", "2", "5"]
    table = similarity_areas.area_table(pd.DataFrame(rows), "all gaps")
    assert "0.70 [0.60, 0.80]" in table and "9 / 3" in table


def test_areas_of_a_place_are_made_once(tmp_path: Path) -> None:
    def run() -> tuple[int, str]:
        text = io.StringIO()
        with contextlib.redirect_stdout(text):
            code = similarity_areas.main(
                ["--no-logs", "--only", "paper", "--backends", "ndt_2d", "--out", str(tmp_path)]
            )
        return code, text.getvalue()

    code, text = run()
    assert code == 0, text
    made = (tmp_path / "calibrate" / "paper" / "roc.csv").stat().st_mtime_ns
    assert run()[0] == 0
    assert (tmp_path / "calibrate" / "paper" / "roc.csv").stat().st_mtime_ns == made
    page = (tmp_path / "areas.md").read_text()
    assert "## Areas at equal gaps" in page and "simulated: paper" in page
