"""A number is declared once, and stands everywhere."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from rbtm_bench.cli import metrics_page
from rbtm_bench.core.column import Column, page_rows
from rbtm_bench.core.columns import COLUMNS, KNOWN, MAIN, is_cost, less_is_better
from rbtm_bench.core.step_columns import STEPS
from rbtm_bench.core.types import StepRecord, StepTable

ADD = """
import io, contextlib, json, sys
from pathlib import Path
import rbtm_bench.core.error_columns as errors
import rbtm_bench.core.step_columns as steps
from rbtm_bench.core.column import Column, StepColumn, page_rows

errors.ERRORS += (
    Column("new", "new_mm", "mm", "a new number", "own", table=True, screen=True,
           line="a new error", short="n_mm"),
)
steps.STEPS += (StepColumn("new_step", "float", "m", "a new step", 1.5),)

from rbtm_bench.cli.commands import main
from rbtm_bench.core.columns import COLUMNS
from rbtm_bench.metrics.final_pose import FinalPose
evaluate = FinalPose.evaluate
from rbtm_bench.core.columns import family
FinalPose.columns = {**FinalPose.columns, **family("new")}
FinalPose.evaluate = lambda self, *words: {**evaluate(self, *words), "new_mm": 3.5}
out = Path(sys.argv[1])
small = ["dataset.scans=6", "dataset.beams=91", "backend=none", "selector=previous"]
text = io.StringIO()
with contextlib.redirect_stdout(text):
    for seed in (0, 1):
        assert main(["run", *small, f"seed={seed}", f"out={out / str(seed)}"]) == 0
assert "a new error                           3.5 mm" in text.getvalue(), text.getvalue()
import pandas as pd
assert pd.read_parquet(out / "0" / "steps.parquet")["new_step"].tolist() == [1.5] * 6
assert json.loads((out / "0" / "metrics.json").read_text())["new_mm"] == 3.5
from rbtm_bench.report import frame, screen
from rbtm_bench.runs.stored import find_runs
assert frame.over_seeds(find_runs([out]))["new_mm"].tolist() == [3.5]
assert frame.FIRST.index("new_mm") < frame.FIRST.index("registrations")
tables = screen.tables_of([out / "0", out / "1"])
screen.write_tables(out, tables)
shown = screen.of_runs(out, tables)
header = [line.split() for line in shown.splitlines()[:4]]
assert any("n" in words for words in header), shown
assert "new_mm" in (out / "table.csv").read_text()
assert "| `new_mm` | mm | a new number | own |" in page_rows(COLUMNS)
from rbtm_bench.cli.metrics_page import step_rows
assert "| `new_step` | float | m | a new step |" in step_rows()
"""


def test_a_number_added_in_one_place_stands_everywhere(tmp_path: Path) -> None:
    command = [sys.executable, "-c", ADD, str(tmp_path / "runs")]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, env={**os.environ, "COLUMNS": "300"}
    )
    assert done.returncode == 0, done.stderr


def test_the_page_is_made_of_the_declared_numbers(capsys: pytest.CaptureFixture[str]) -> None:
    assert metrics_page.main(["--check"]) == 0, capsys.readouterr().out
    text = metrics_page.PAGE.read_text(encoding="utf-8")
    for column in COLUMNS:
        (row,) = page_rows([column])
        assert text.count(f"\n{row}\n") == 1, column.name
    stale = text.replace("| `skipped` | count |", "| `skipped` | pieces |")
    assert stale != text and metrics_page.page(stale) == text


def test_names_are_unique_and_derived_numbers_come_behind_their_family() -> None:
    assert len(KNOWN) == len(COLUMNS) and len({c.name for c in STEPS}) == len(STEPS)
    names = list(KNOWN)
    assert names.index("relations_rotation_std_deg") < names.index("relations_local_used")
    assert names.index("relations_long_rotation_std_deg") < names.index("registrations")
    assert KNOWN["map_cells_still"].about == "`map_cells` with every scan at the first pose"


def test_what_is_asked_of_a_number() -> None:
    assert [column.name for column in MAIN] == [
        "relations_translation_mean_m",
        "final_translation_error_mm",
        "ape_rmse_m",
    ]
    assert is_cost("ms_per_scan") and is_cost("reused") and not is_cost("ape_rmse_m")
    assert less_is_better("kitti_translation_percent") and not less_is_better("mean_gap")
    assert not is_cost("a_plugins_number") and not less_is_better("a_plugins_number")
    assert KNOWN["final_along_mm"].plain_unit == "mm" and KNOWN["coverage"].plain_unit == ""
    assert str(Column("f", "n_m", "m", "about", "own")) == "m; about; own"


def test_a_step_has_the_declared_columns_and_no_others() -> None:
    record = StepRecord(3, 0.5, 1, status="registered")
    assert (record.model, record.status, record.rejected, record.fitness) == (
        1,
        "registered",
        0,
        None,
    )
    assert list(record.as_dict()) == [column.name for column in STEPS]
    with pytest.raises(TypeError, match="no such columns of a step: fittnes"):
        StepRecord(0, 0.0, fittnes=1.0)
    record.fittnes = 1.0
    with pytest.raises(TypeError, match="no such columns of a step: fittnes"):
        StepTable([record])
