"""Tables in every format, and verdicts on numbers made by hand."""

from __future__ import annotations

import csv
import html
import io
import json
import math
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import best_settings, render, verdict

THIRD = 1 / 3


@pytest.fixture
def table() -> pd.DataFrame:
    """A done and a failed run; a column that is empty, one with awkward words."""
    return pd.DataFrame(
        {
            "run": ["a_1", "b&2"],
            "status": ["done", "failed"],
            "window": [4.0, None],
            "settings": ["", "x|y <z> 50%"],
            "ape_rmse_m": [THIRD, None],
            "scans": [12, 12],
            "relations_used": [None, None],
            "final_translation_error_mm": [19998.36, None],
        }
    )


class Cells(HTMLParser):
    """The rows of an HTML table."""

    def __init__(self) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.inside = False

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        self.inside = tag in ("td", "th")
        if tag == "tr":
            self.rows.append([])
        if self.inside:
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        self.inside = False

    def handle_data(self, data: str) -> None:
        if self.inside:
            self.rows[-1][-1] += data


SHOWN = ["run", "status", "window", "settings", "ape_rmse_m", "scans", "final_translation_error_mm"]
FIRST = ["a_1", "done", "4", "", "0.3333", "12", "19998"]
SECOND = ["b&2", "failed", "", "x|y <z> 50%", "", "12", ""]


# --- formats


def test_csv_keeps_everything(table: pd.DataFrame) -> None:
    rows = list(csv.DictReader(io.StringIO(render.render(table, "csv"))))
    assert list(rows[0]) == list(table)
    assert float(rows[0]["ape_rmse_m"]) == THIRD
    assert rows[1]["ape_rmse_m"] == rows[1]["window"] == rows[0]["relations_used"] == ""
    assert rows[1]["settings"] == "x|y <z> 50%"


def test_json_keeps_everything(table: pd.DataFrame) -> None:
    rows = json.loads(render.render(table, "json"))
    assert list(rows[0]) == list(table)
    assert rows[0]["ape_rmse_m"] == THIRD and rows[0]["scans"] == 12
    assert rows[1]["ape_rmse_m"] is None and rows[0]["relations_used"] is None
    tiny = pd.DataFrame({"value": [1.2345678901234567e-9]})
    assert json.loads(render.render(tiny, "json")) == [{"value": 1.2345678901234567e-9}]


def test_markdown(table: pd.DataFrame) -> None:
    lines = render.render(table, "md").splitlines()
    rows = [line.replace(r"\|", "\0").strip("|").split("|") for line in lines]
    cells = [[html.unescape(cell.strip().replace("\0", "|")) for cell in row] for row in rows]
    assert cells[0] == SHOWN and cells[2:] == [FIRST, SECOND] and not any("<" in x for x in lines)
    right = [cell.endswith(":") for cell in cells[1]]
    assert right == [name in ("window", *SHOWN[4:]) for name in SHOWN]


def test_html(table: pd.DataFrame) -> None:
    reader = Cells()
    reader.feed(render.render(table, "html"))
    assert reader.rows == [SHOWN, FIRST, SECOND]


def test_latex(table: pd.DataFrame) -> None:
    text = render.render(table, "latex")
    lines = text.splitlines()
    assert lines[0] == r"\begin{tabular}{llrlrrr}" and lines[-1] == r"\end{tabular}"
    assert r"\toprule" in text and r"\bottomrule" in text
    assert r"final\_translation\_error\_mm" in text and r"a\_1" in text and r"b\&2" in text
    assert r"50\%" in text
    assert all(line.count("&") - line.count(r"\&") == 6 for line in lines if r"\\" in line)


def test_text(table: pd.DataFrame) -> None:
    text = render.render(table, "text")
    assert "relations" not in text and "nan" not in text.lower() and "None" not in text
    assert "0.3333" in text and "19998" in text and "x|y <z> 50%" in text
    assert len({len(line) for line in text.splitlines()}) <= 3  # aligned


def test_numbers_in_words() -> None:
    words = [render.word_of(v) for v in (0.0, 4.0, 0.123456, 1e-7, 2.5e7, 123.456, 1234.5, 3, True)]
    assert words == ["0", "4", "0.1235", "1e-07", "2.5e+07", "123.5", "1234", "3", "True"]
    assert [render.word_of(v) for v in (None, "", math.nan)] == ["", "", ""]


def test_every_format_of_real_runs_parses_back(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    words = ["backend=none", "selector=previous,rbtm", "dataset.scans=8", "pin=false"]
    assert main(["compare", *words, f"out='{out}'", "--jobs", "1"]) == 0
    printed = {}
    for fmt in render.FORMATS:
        capsys.readouterr()
        assert main(["table", str(out), "--format", fmt]) == 0
        printed[fmt] = capsys.readouterr().out
    rows = list(csv.DictReader(io.StringIO(printed["csv"])))
    assert printed["csv"] == (out / "table.csv").read_text()
    assert [row["run"] for row in rows] == ["none-previous", "none-rbtm"]
    assert rows[0]["relations_used"] == "" and rows[0]["window"] == ""
    as_json = json.loads(printed["json"])
    assert as_json[0]["relations_used"] is None and as_json[1]["window"] == 10
    for row, other in zip(rows, as_json, strict=True):
        assert float(row["ape_rmse_m"]) == other["ape_rmse_m"]
    reader = Cells()
    reader.feed(printed["html"])
    assert len(reader.rows) == 3 and "relations_used" not in reader.rows[0]
    assert printed["md"].count("\n") == 4 and "relations_used" not in printed["md"]
    assert "none-rbtm" in printed["text"] and r"\begin{tabular}" in printed["latex"]


# --- choice of columns


def test_columns_by_name(table: pd.DataFrame) -> None:
    assert render.existing_columns(table, " run ,scans,") == ["run", "scans"]
    with pytest.raises(ConfigError, match="--columns scan: no such column") as caught:
        render.existing_columns(table, "run,scan")
    assert "scans" in str(caught.value)


def test_a_screen_shows_what_differs() -> None:
    table = frame(
        method("previous", 10.0, coverage=1.0, rejected=0),
        method("rbtm", 20.0, coverage=1.0, rejected=2),
    )
    shown, same = render.screen_table(table)
    assert "coverage" not in shown and "rejected" in shown and "selector" in shown
    assert "coverage 1" in same and "backend p2p" in same and "data corridor" in same
    assert render.screen_table(table[:1])[1] == ""


# --- verdicts


def method(
    selector: str,
    error: float | None,
    backend: str = "p2p",
    data: str = "corridor",
    key: str = "final_translation_error_mm",
    **more: Any,
) -> dict[str, Any]:
    """A row of medians with one error."""
    row = {"dataset": "corridor", "data": data, "backend": backend, "selector": selector}
    empty = dict.fromkeys(k for k, _, _ in best_settings.ERRORS)
    return {**row, "settings": "", "status": "done", **empty, key: error, **more}


def frame(*rows: dict[str, Any]) -> pd.DataFrame:
    return pd.DataFrame(list(rows))


def test_of_single_runs_nothing_is_better_only_lower() -> None:
    (line,) = verdict.verdict(frame(method("previous", 100.0), method("rbtm", 20.0)))
    assert line == (
        "corridor, p2p: final position error of rbtm is 20 mm, "
        "of the best control, previous, 100 mm: rbtm is 5 times lower on this run."
    )
    (line,) = verdict.verdict(frame(method("previous", 20.0), method("rbtm", 50.0)))
    assert "rbtm is 2.5 times higher on this run." in line
    (line,) = verdict.verdict(frame(method("previous", 20.0), method("rbtm", 20.0)))
    assert "rbtm is equal." in line
    for other in (20.9, 19.2):
        (line,) = verdict.verdict(frame(method("previous", other), method("rbtm", 20.0)))
        assert "rbtm is within 5% on this run." in line
    (line,) = verdict.verdict(frame(method("previous", 21.1), method("rbtm", 20.0)))
    assert "times lower" in line and "better" not in line
    (line,) = verdict.verdict(frame(method("previous", 0.0), method("rbtm", 20.0)))
    assert "rbtm is higher on this run." in line


def test_the_best_control_and_previous_are_both_named() -> None:
    rows = [method("previous", 800.0), method("keyframe", 10.0), method("rbtm", 20.0)]
    (line,) = verdict.verdict(frame(*rows))
    assert "of the best control, keyframe, 10 mm: rbtm is 2 times higher on this run" in line
    assert line.endswith("; previous 800 mm, rbtm is 40 times lower on this run.")


def test_the_baseline_without_registration_is_named() -> None:
    rows = [method("previous", 100.0), method("rbtm", 20.0), method("previous", 10.0, "none")]
    (line,) = verdict.verdict(frame(*rows))
    assert line.endswith("; no registration 10 mm, rbtm is 2 times higher on this run.")


def test_the_best_of_several_settings_is_called_that() -> None:
    rows = [
        method("previous", 100.0),
        method("rbtm", 40.0, window=8.0, threshold=0.5),
        method("rbtm", 20.0, window=64.0, threshold=0.75, settings="fallback=skip"),
    ]
    (line,) = verdict.verdict(frame(*rows))
    assert "of rbtm (window 64, threshold 0.75, fallback=skip) is 20 mm" in line
    assert line.endswith("Best of 1 x previous, 2 x rbtm settings, chosen on this very data.")


def test_a_line_for_every_data_set_and_backend() -> None:
    rows = [
        method(selector, error, backend, data)
        for data in ("paper", "bare")
        for backend in ("p2p", "gicp")
        for selector, error in (("previous", 9.0), ("rbtm", 3.0))
    ]
    lines = verdict.verdict(frame(*rows))
    heads = ["paper, p2p", "paper, gicp", "bare, p2p", "bare, gicp"]
    assert [line.split(":")[0] for line in lines] == heads


def test_each_data_set_is_judged_by_an_error_it_has() -> None:
    relations = "relations_translation_mean_m"
    rows = [
        method("previous", 0.5, data="aces", key=relations),
        method("rbtm", 0.25, data="aces", key=relations),
        method("previous", 30.0),
        method("rbtm", 60.0),
    ]
    first, second = verdict.verdict(frame(*rows))
    assert first.startswith("aces, p2p: mean relation error of rbtm is 0.25 m")
    assert second.startswith("corridor, p2p: final position error of rbtm is 60 mm")


@pytest.mark.parametrize(
    "rows",
    [
        [method("rbtm", 20.0)],
        [method("previous", 20.0), method("keyframe", 10.0)],
        [method("previous", 20.0, "none"), method("rbtm", 20.0, "none")],
        [method("previous", None), method("rbtm", None)],
        [method("previous", None), method("rbtm", 20.0)],
        [method("previous", 20.0), method("rbtm", None)],
        [method("previous", 20.0, "gicp"), method("rbtm", 20.0)],
    ],
    ids=["no controls", "no rbtm", "only none", "all failed", "control failed", "ours", "apart"],
)
def test_no_verdict_without_both_sides(rows: list[dict[str, Any]]) -> None:
    assert verdict.verdict(frame(*rows)) == []


def test_figures_have_three_digits() -> None:
    words = [render.three_digits(v) for v in (0.123456, 12.345, 123.45, 12345.6, 2e7)]
    assert words == ["0.123", "12.3", "123", "12346", "2e+07"]


def test_a_threshold_that_never_decided_is_said() -> None:
    rows = [method("previous", 100.0), method("rbtm", 20.0, decided=0.0)]
    (line,) = verdict.verdict(frame(*rows))
    assert line.endswith("5 times lower on this run; its threshold never decided.")
