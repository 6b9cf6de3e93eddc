"""When rbtm reached back: the test by rotations, and rows that are no controls."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stat_helpers import MM, make_run

from rbtm_bench.report import answer, frame, screen, verdict
from rbtm_bench.report.rotation import Rotation
from rbtm_bench.runs import stored

SPECIAL = {"selector.offset": "SEED", "selector.gaps_from": "OTHER_RUN"}


@pytest.mark.parametrize(
    ("ours", "rotated", "p"),
    [
        (1.0, range(2, 21), 0.05),  # none of 19 is as good
        (4.0, range(2, 21), 0.20),  # 2, 3 and 4
        (99.0, range(2, 21), 1.0),
        (2.0, [2.0] * 19, 1.0),  # equal ones are as good
        (1.0, [2.0, 3.0, 4.0], 0.25),
    ],
)
def test_p_counts_the_rotations_that_are_as_good(ours, rotated, p) -> None:
    assert Rotation("plicp", ours, tuple(map(float, rotated)), 19, 1).p == pytest.approx(p)


def test_words_have_the_ratio_to_the_median_and_to_the_quartiles() -> None:
    words = Rotation("plicp", 10.0, (8.0, 16.0, 20.0, 40.0, 80.0), 5, 1).words()
    assert words == "plicp 0.33, 0.5 [0.25 - 0.625]"
    words = Rotation("plicp", 10.0, (8.0, 8.0, 20.0, 20.0, 20.0), 2, 3).words()
    assert words == "plicp 0.5, 0.5 [0.5 - 1.25] (2 distinct) (best of 3: p too small)"


def one(folder: Path, selector: str, error: float, name: str = "", **more: Any) -> None:
    metrics = {MM: error, "coverage": 1.0, "ms_per_scan": 2.0, **more.pop("metrics", {})}
    name = name or selector
    record = {"trajectory_sha256": more.pop("path", name), "special": SPECIAL}
    record |= more.pop("told", {})
    make_run(folder / name, selector, metrics, told=record, **more)


def rotations(folder: Path, errors: list[float], of: str = "rbtm") -> None:
    for turn, error in enumerate(errors, start=1):
        record = {"control": {"how": "rotated", "of": of}}
        settings = {"offset": turn, "gaps_from": str(folder / of)}
        one(folder, "shifted_gap", error, f"shifted_gap-{turn}", told=record, **settings)


def told(folder: Path) -> str:
    methods = frame.methods(stored.find_runs([folder]))
    return " ".join(" ".join(answer.answer(methods, "results/x")).split())


def test_rotations_are_a_row_and_a_line(tmp_path: Path) -> None:
    """They win nothing, they are no control, and nobody is tied with them."""
    one(tmp_path, "rbtm", 30.0, window=10)
    one(tmp_path, "previous", 60.0)
    rotations(tmp_path, [20.0, *np.arange(31.0, 49.0)])
    runs = stored.find_runs([tmp_path])
    table = frame.over_seeds(runs)
    (row,) = table[table.selector == "shifted_gap"].to_dict("records")
    assert (row[MM], row[f"{MM}_q1"], row[f"{MM}_q3"], row[f"{MM}_worst"]) == (
        39.0,
        34.5,
        43.5,
        48.0,
    )
    assert row["control"] == "rotated" and row["status"] == "done"
    text = told(tmp_path)
    expected = "(p, ratio to the median of 19 rotations of its gaps): p2p 0.1, 0.769 [0.69 - 0.87]"
    assert f"when rbtm reached back {expected}" in text
    assert "p2p rbtm (window 10), 30 mm (one run); 2 rows" in text and "shifted" not in text
    (line, *_) = verdict.verdict(table, frame.methods(runs))
    assert "of the best control, previous, 60 mm" in line and "shifted_gap" not in line
    assert screen.comparison_warnings(runs) == []


def test_rotations_without_their_run_are_no_test(tmp_path: Path) -> None:
    one(tmp_path, "rbtm", 30.0, name="another")
    rotations(tmp_path, [20.0, 30.0])
    assert "reached back" not in told(tmp_path)


def test_a_keyframe_rule_that_is_previous_is_no_control(tmp_path: Path) -> None:
    one(tmp_path, "rbtm", 10.0, metrics={"mean_gap": 4.0})
    one(tmp_path, "previous", 20.0, metrics={"mean_gap": 1.0}, path="same")
    one(tmp_path, "keyframe", 20.0, metrics={"mean_gap": 1.0}, path="same", distance=0.1)
    one(tmp_path, "fixed_gap", 40.0, metrics={"mean_gap": 4.0})
    what = "alarm (mean_gap): picks the scan before every time, no control: p2p keyframe"
    text = told(tmp_path)
    assert what in text and "bit for bit" not in text
    table = frame.over_seeds(stored.find_runs([tmp_path]))
    assert "of the best control, previous, 20 mm" in verdict.verdict(table)[0]
    without = table[table.selector != "previous"]
    assert "of the best control, fixed_gap, 40 mm" in verdict.verdict(without)[0]


@pytest.mark.parametrize(
    ("control", "words"),
    [
        ("oldest", "the threshold never decided: p2p {} = p2p {} bit for bit"),
        ("previous", "the threshold never reached back: p2p {} = p2p {} bit for bit"),
        ("fixed_gap", "alarm (trajectory_sha256): p2p {} = p2p {} bit for bit"),
    ],
)
def test_rbtm_that_equals_a_control(tmp_path: Path, control: str, words: str) -> None:
    one(tmp_path, "rbtm", 10.0, path="same", metrics={"mean_gap": 4.0})
    one(tmp_path, control, 10.0, path="same", metrics={"mean_gap": 4.0})
    assert words.format(*sorted(["rbtm", control])) in told(tmp_path)
