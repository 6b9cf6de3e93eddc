"""Tables with intervals: every number worked out by hand from run folders written by the tests."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stat_helpers import LONG, MEAN, MM, check_latex, make_log, make_run, make_seeds, shown

from rbtm_bench.cli.commands import main
from rbtm_bench.report import render, with_intervals
from rbtm_bench.runs import stored


def rows_of(*folders: Path, **options: Any) -> list[dict[str, Any]]:
    table = with_intervals.interval_table(stored.find_runs(folders), **options)
    return table.astype(object).where(table.notna(), None).to_dict(orient="records")


def numbers(row: dict[str, Any], key: str) -> tuple[Any, ...]:
    return tuple(row[name] for name in (key, f"{key}_low", f"{key}_high", f"{key}_n"))


# --- data sets


def test_median_over_seeds_with_its_interval(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [3, 1, 6, 2, 5, 4])
    (row,) = rows_of(tmp_path)
    assert numbers(row, MM) == (3.5, 1.5, 5.5, 6)  # as in test_statistics
    assert (row["seeds"], row["status"], row["data"]) == (6, "done", "corridor")
    (row,) = rows_of(tmp_path, statistic="mean", metrics=["mean_gap"])
    assert row["mean_gap"] == 4.5 and MM not in row


def test_a_log_is_one_data_set_however_often_it_was_run(tmp_path: Path) -> None:
    for seed in range(8):
        log = {"dataset": "carmen", "data": {"path": "a.clf"}, "fingerprint": "the log"}
        make_run(tmp_path / str(seed), "random_gap", {MM: float(seed)}, seed=seed, **log)
    (row,) = rows_of(tmp_path)
    assert numbers(row, MM) == (3.5, None, None, 1) and row["rank"] is None


def test_several_runs_on_the_same_data_are_their_median(tmp_path: Path) -> None:
    """Three data sets of three runs each: the medians 2, 3 and 4, whose median is 3."""
    for seed, error in enumerate([1, 2, 90, 3, 50, 2, 4, 4, 40]):
        place = {"fingerprint": f"data {seed // 3}"}
        make_run(tmp_path / str(seed), "random_gap", {MM: float(error)}, seed=seed, **place)
    (row,) = rows_of(tmp_path)
    assert numbers(row, MM) == (3.0, 2.0, 4.0, 3)


def test_failed_seeds_are_no_values(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [1, None, 3, 2])
    make_seeds(tmp_path, "rbtm", [None, None], window=4)
    first, second = rows_of(tmp_path)
    assert numbers(first, MM) == (2.0, 1.0, 3.0, 3) and first["status"] == "3 of 4 done"
    assert numbers(second, MM) == (None, None, None, 0)


def test_pooled_data_sets_are_units_side_by_side(tmp_path: Path) -> None:
    for place, errors in (("bare", [1, 2, 3]), ("paper", [4, 5, 6])):
        data = {"environment": place}
        make_seeds(tmp_path / place, "previous", errors, data=data)
        make_seeds(tmp_path / place, "rbtm", [e + 1 for e in errors], data=data, window=4)
    assert [row["data"] for row in rows_of(tmp_path)][::2] == [
        "corridor environment=bare", "corridor environment=paper"
    ]  # fmt: skip
    first, second = rows_of(tmp_path, pool=True)
    assert numbers(first, MM) == (3.5, 1.5, 5.5, 6) and numbers(second, MM) == (4.5, 2.5, 6.5, 6)
    assert (first["data"], first["seeds"]) == ("corridor (2 pooled)", 6)
    assert (first["rank"], second["rank"]) == (1.0, 2.0)


def test_ranks_need_six_data_sets_that_all_have(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [3, 3, 3, 3, 3, 3, 3])
    make_seeds(tmp_path, "rbtm", [1, 1, 1, 1, 5, 5, 5], window=4)
    make_seeds(tmp_path, "oldest", [2, 2, 2, 3, 9, 9, None], window=4)
    ranks = {row["selector"]: row["rank"] for row in rows_of(tmp_path)}
    # seeds 0 to 5: previous 3 3 3 2.5 1 1, rbtm 1 1 1 1 2 2, oldest 2 2 2 2.5 3 3
    assert ranks == {
        "previous": pytest.approx(13.5 / 6),
        "rbtm": pytest.approx(8 / 6),
        "oldest": pytest.approx(14.5 / 6),
    }
    make_seeds(tmp_path, "keyframe", [1, 1, 1, 1, 1])
    assert {row["rank"] for row in rows_of(tmp_path)} == {None}


# --- relations


def test_relations_are_resampled_by_cluster(tmp_path: Path) -> None:
    path = make_log(tmp_path / "run", "previous", [0, 1, 0, 1, 0, 1])
    (row,) = rows_of(tmp_path)
    within = f"{LONG}_clusters", f"{MEAN}_clusters", "relations_local_translation_mean_m_clusters"
    assert numbers(row, within[0]) == pytest.approx((0.5, 1 / 6, 5 / 6, 6))  # as in test_statistics
    assert numbers(row, within[1]) == pytest.approx((0.5, 1 / 3, 2 / 3, 12))  # half are local
    assert numbers(row, within[2]) == (0.5, 0.5, 0.5, 6)
    assert numbers(row, MEAN) == (0.5, None, None, 1)  # of one run, whatever is within it
    (path / "relations.parquet").unlink()  # as a run of an older version
    (row,) = rows_of(tmp_path)
    assert numbers(row, MEAN) == (0.5, None, None, 1) and within[1] not in row


def test_runs_that_differ_by_seed_are_averaged_relation_by_relation(tmp_path: Path) -> None:
    make_log(tmp_path / "a", "random_gap", [0, 2, 0, 2, 0, 2], seed=0)
    make_log(tmp_path / "b", "random_gap", [0, 0, 0, 0, 0, 0], seed=1)
    (row,) = rows_of(tmp_path)
    assert numbers(row, f"{LONG}_clusters") == pytest.approx((0.5, 1 / 6, 5 / 6, 6))


def test_metrics_that_are_no_means_of_relations_have_data_sets_as_units(tmp_path: Path) -> None:
    make_log(tmp_path / "run", "previous", [0, 1, 0, 1])
    (row,) = rows_of(tmp_path, metrics=["ms_per_scan", "relations_rotation_mean_deg"])
    assert numbers(row, "ms_per_scan") == (3.0, None, None, 1)
    assert numbers(row, "relations_rotation_mean_deg_clusters") == (2.0, 2.0, 2.0, 8)


def test_several_logs_are_units_once_pooled(tmp_path: Path) -> None:
    for i in range(6):
        log = {"data": {"path": f"{i}.clf"}, "fingerprint": f"log {i}"}
        make_log(tmp_path / str(i), "previous", [i, i, i, i, np.nan], **log)
    (row,) = rows_of(tmp_path, pool=True, metrics=[LONG])
    assert numbers(row, LONG) == (2.5, 0.5, 4.5, 6)


# --- maps


def test_numbers_of_maps_carry_the_truth_and_no_motion_and_no_rank(
    tmp_path: Path, capsys: Any
) -> None:
    for seed in range(6):
        for selector in ("previous", "rbtm"):
            cells = {"map_cells": 400 + seed, "map_cells_truth": 502, "map_cells_still": 363}
            make_run(tmp_path / f"{selector}{seed}", selector, cells, seed=seed)
    assert main(["table", str(tmp_path), "--intervals", "--metric", "map_cells", "-f", "csv"]) == 0
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [(row["backend"], float(row["map_cells"])) for row in rows] == [
        ("p2p", 402.5), ("p2p", 402.5), ("(truth)", 502.0), ("(no motion)", 363.0)
    ]  # fmt: skip
    assert "map_cells_truth" not in rows[0] and {row["rank"] for row in rows} == {""}


# --- what is shown


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Two methods over six seeds with names that LaTeX would trip over."""
    make_seeds(tmp_path, "previous", [3, 1, 6, 2, 5, 4], backend="p2p_a&b")
    make_seeds(tmp_path, "rbtm", [30, 10, 60, 20, 50, 40], backend="p2p_a&b", window=4)
    return tmp_path


def test_csv_and_json_hold_numbers(runs: Path, capsys: Any) -> None:
    out, err = shown(capsys, str(runs), "--intervals", "-f", "csv")
    first, second = csv.DictReader(io.StringIO(out))
    assert [first[f"{MM}{end}"] for end in ("", "_low", "_high", "_n")] == [
        "3.5",
        "1.5",
        "5.5",
        "6",
    ]
    assert second["rank"] == "2.0" and "bootstrap 95% interval" in err
    rows = json.loads(shown(capsys, str(runs), "--intervals", "-f", "json")[0])
    assert rows[1][f"{MM}_high"] == 55.0 and rows[0]["threshold"] is None


def test_text_says_what_the_numbers_are(runs: Path, capsys: Any) -> None:
    out, err = shown(capsys, str(runs), "--intervals")
    assert "3.5 [1.5, 5.5] (6)" in out and "35 [15, 55] (6)" in out and err == ""
    assert "the same in every row: data corridor" in out
    assert (
        "median over data sets (seeds), on one log over its replicates" in out
        and "rank: mean" in out
    )
    out, _ = shown(capsys, str(runs), "--intervals", "--mean", "--columns", f"selector,{MM}")
    assert "mean over data sets" in out and "backend" not in out.split("\n")[0]


def test_latex_is_a_table_that_compiles(runs: Path, capsys: Any) -> None:
    out, err = shown(capsys, str(runs), "--intervals", "-f", "latex")
    head, first, second = check_latex(out.rstrip("\n"))
    assert r"final\_translation\_error\_mm" in head and r"p2p\_a\&b" in first
    assert "3.5 [1.5, 5.5] (6)" in first and "35 [15, 55] (6)" in second
    assert "95% interval" in err


@pytest.mark.parametrize("fmt", ["md", "html"])
def test_readers_get_folded_cells(runs: Path, capsys: Any, fmt: str) -> None:
    out, _ = shown(capsys, str(runs), "--intervals", "-f", fmt)
    assert "3.5 [1.5, 5.5] (6)" in out and "_low" not in out and "_n" not in out


def test_too_few_units_are_noted(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [1, 2, 3, 4])
    make_seeds(tmp_path, "rbtm", [1, 2], window=4)
    table = with_intervals.interval_table(stored.find_runs([tmp_path]))
    lines = with_intervals.interval_notes(table, "median")
    assert "at most 88% with 4" in lines[1] and "no interval of fewer than 3" in lines[2]
    assert with_intervals.folded(table)[MM].tolist() == ["2.5 [1, 4] (4)", "1.5 (2)"]
    assert len(lines) == 3  # and nothing of ranks


def test_a_metric_that_no_run_has(runs: Path, capsys: Any) -> None:
    assert main(["table", str(runs), "--intervals", "--metric", "ape_rmse_m"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("rbtm-bench: --metric ape_rmse_m: none of these runs has a number")
    assert MM in error and error.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--metric", MM], "--metric: goes with --intervals, --against, --paper"),
        (["--pool"], "--pool: goes with"),
        (["--over-seeds", "--mean"], "--mean: goes with --intervals"),
        (["--best", "--intervals"], "not allowed with"),
        (["--intervals", "--against", "previous"], "not allowed with"),
    ],
)
def test_options_that_do_not_fit(runs: Path, capsys: Any, words: list[str], why: str) -> None:
    assert main(["table", str(runs), *words]) == 2
    assert why in capsys.readouterr().err


def test_formats_are_those_of_all_tables() -> None:
    assert set(render.FORMATS) == {"text", "csv", "md", "latex", "html", "json"}
