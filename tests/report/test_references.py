"""Rows of the truth and of no motion: in every format, for every data set, and never ranked."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.report import best_settings, render
from rbtm_bench.report.references import accompanied, judged, with_references
from rbtm_bench.runs import stored


@pytest.fixture
def table() -> pd.DataFrame:
    """Two methods on a data set whose truth is known, one on another; a failed one."""
    return pd.DataFrame(
        {
            "run": ["a", "b", "c", "d"],
            "status": ["done", "done", "done", "failed"],
            "dataset": ["corridor", "corridor", "carmen", "carmen"],
            "data": ["corridor", "corridor", "carmen", "carmen"],
            "backend": ["plicp", "ndt", "plicp", "ndt"],
            "selector": ["rbtm", "previous", "rbtm", "rbtm"],
            "settings": ["", "", "", ""],
            "scans": [12, 12, 30, 30],
            "ape_rmse_m": [0.2, 0.1, None, None],
            "map_cells": [350, 500, 70, None],
            "map_entropy_nat": [-3.5, -3.0, -1.0, None],
            "map_cells_truth": [400, 400, None, None],
            "map_entropy_nat_truth": [-3.4, -3.4, None, None],
            "map_cells_still": [300, 300, 40, None],
            "map_entropy_nat_still": [-3.6, -3.6, -2.0, None],
        }
    )


def cells(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[c] for c in ("run", "status", "data", "backend", "map_cells"))


def test_references_are_rows_at_the_end(table: pd.DataFrame) -> None:
    before = table.copy()
    shown = with_references(table)
    pd.testing.assert_frame_equal(table, before)
    assert list(shown) == [c for c in table if not c.endswith(("_truth", "_still"))]
    rows = shown.to_dict(orient="records")
    assert [cells(row) for row in rows[:3]] == [cells(r) for r in table.to_dict("records")[:3]]
    assert [cells(row) for row in rows[4:]] == [
        ("(truth)", "reference", "corridor", "(truth)", 400),
        ("(no motion)", "reference", "corridor", "(no motion)", 300),
        ("(no motion)", "reference", "carmen", "(no motion)", 40),  # whose truth is not known
    ]
    assert [row["map_entropy_nat"] for row in rows[4:]] == [-3.4, -3.6, -2.0]
    assert all(pd.isna(row[c]) for row in rows[4:] for c in ("selector", "scans", "ape_rmse_m"))
    assert with_references(shown) is shown  # once is enough


def test_numbers_without_a_companion_have_no_references(table: pd.DataFrame) -> None:
    plain = table[["run", "status", "ape_rmse_m", "map_cells"]]
    assert with_references(plain) is plain and judged(plain) == []
    assert accompanied(plain, ["map_cells"]) == ["map_cells"]
    assert judged(table) == ["map_cells", "map_entropy_nat"]
    assert accompanied(table, ["run", "ape_rmse_m"]) == ["run", "ape_rmse_m"]


@pytest.mark.parametrize("fmt", render.FORMATS)
def test_every_format_has_them(table: pd.DataFrame, fmt: str) -> None:
    text = render.render(table, fmt)
    assert len(re.findall(r"\(truth\)", text)) == 2  # in the columns run and backend
    assert len(re.findall(r"\(no motion\)", text)) == 4
    assert "_truth" not in text and r"\_truth" not in text and "still" not in text


def test_csv_keeps_whole_numbers_of_methods(table: pd.DataFrame) -> None:
    rows = list(csv.DictReader(io.StringIO(render.render(table, "csv"))))
    assert rows[0]["scans"] == "12" and rows[4]["scans"] == ""
    as_json = json.loads(render.render(table, "json"))
    assert as_json[0]["scans"] == 12 and as_json[4]["scans"] is None
    assert as_json[4]["map_cells"] == 400


@pytest.mark.parametrize(
    ("names", "named"),
    [("backend,map_cells", "backend"), ("selector,map_cells", "selector"), ("map_cells", "row")],
)
def test_chosen_columns_bring_their_references(table: pd.DataFrame, names: str, named: str) -> None:
    chosen = table[render.existing_columns(table, names)]
    rows = json.loads(render.render(chosen, "json"))
    assert [row["map_cells"] for row in rows[4:]] == [400, 300, 40]
    assert [row[named] for row in rows[4:]] == ["(truth)", "(no motion)", "(no motion)"]
    assert [row["data"] for row in rows[4:]] == ["corridor", "corridor", "carmen"]
    one = table[:2]
    rows = json.loads(render.render(one[render.existing_columns(one, names)], "json"))
    assert len(rows) == 4 and "data" not in rows[0]  # one data set needs no name


def test_the_screen_of_a_comparison_has_them(table: pd.DataFrame) -> None:
    one = table[:2].assign(seeds=1, map_cells=350)  # the same in every row: shown all the same
    shown, same = render.screen_table(one)
    assert "map_cells" not in same and "status done" in same
    rows = json.loads(render.render(shown, "json"))
    assert [row["map_cells"] for row in rows] == [350, 350, 400, 300]
    alone, _ = render.screen_table(table[:1])
    rows = json.loads(render.render(alone, "json"))
    assert [row["map_cells"] for row in rows] == [350, 400, 300]


def test_maps_measured_by_other_settings_have_their_own_references(table: pd.DataFrame) -> None:
    two = table[:2].assign(settings=["gap=3 metrics.map_quality.cell=0.1", "gap=3"])
    two["map_cells_truth"] = [100, 400]
    chosen = two[render.existing_columns(two, "backend,map_cells")]
    rows = json.loads(render.render(chosen, "json"))[2:]
    labelled = [(row["backend"], row["settings"], row["map_cells"]) for row in rows]
    coarse = "metrics.map_quality.cell=0.1"
    assert labelled == [
        ("(truth)", coarse, 100),
        ("(no motion)", coarse, 300),
        ("(truth)", None, 400),
        ("(no motion)", None, 300),
    ]


def test_over_seeds_references_are_medians(table: pd.DataFrame) -> None:
    three = pd.concat([table[:1]] * 3, ignore_index=True)
    three["map_cells_truth"] = [10, 30, 20]
    rows = with_references(three).to_dict(orient="records")
    assert [row["map_cells"] for row in rows[3:]] == [20, 300]


def test_nothing_is_ranked_by_the_map(table: pd.DataFrame) -> None:
    """The winner has the larger map and the higher entropy; without an error none wins."""
    assert not any(key.startswith("map_") for key, _, _ in best_settings.ERRORS)
    methods = table[:2].assign(selector="rbtm", backend="plicp", window=8, threshold=[0.1, 0.2])
    best = best_settings.best(methods)
    assert len(best) == 1 and best["run"][0] == "b" and best["map_cells"][0] == 500
    columns, main_errors = best_settings.best_columns(best)
    assert main_errors == ["ape_rmse_m"] and not any(c.startswith("map_") for c in columns)
    nothing = best_settings.best(methods.drop(columns="ape_rmse_m"))
    assert nothing["run"][0] is None and nothing["map_cells"][0] is None
    rows = json.loads(render.render(nothing, "json"))
    assert [row["run"] for row in rows] == [None]


def test_a_comparison_in_the_bare_corridor(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Standing still has the smaller map than the truth, and the table says so."""
    out = tmp_path / "out"
    words = ["backend=none", "selector=previous", "guess=identity,odometry", "metrics=maps"]
    words += ["dataset.environment=bare", "dataset.path_length=1.8", "dataset.scans=40"]
    assert main(["compare", *words, "pin=false", f"out='{out}'", "--jobs", "1"]) == 0
    screen = capsys.readouterr().out
    assert screen.count("(truth)") == screen.count("(no motion)") == 1
    for name, first in (("table.csv", "run"), ("summary.csv", "run")):
        with open(out / name, newline="", encoding="utf-8") as file:
            rows = {row[first]: row for row in csv.DictReader(file)}
        assert list(rows)[2:] == ["(truth)", "(no motion)"]
        cells = {key: float(row["map_cells"]) for key, row in rows.items()}
        assert cells["(no motion)"] < cells["(truth)"]
        stuck = next(key for key in rows if "identity" in key)
        assert cells[stuck] == cells["(no motion)"]
    runs = stored.find_runs([out])
    assert len(runs) == 2 and all("map_cells_still" in run.metrics for run in runs)
