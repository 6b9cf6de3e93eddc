"""What a page holds: the table's numbers, every scan's choice, and what it leaves out."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from conftest import HOSTILE, payload
from page_helpers import unpacked
from sweep_helpers import call

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.page import assemble, choices, runs, scans
from rbtm_bench.report import answer, frame
from rbtm_bench.runs import stored


def rows_of(data: dict[str, Any], selector: str, backend: str = "plicp") -> list[int]:
    cells = [row["cells"] for row in data["rows"]]
    return [i for i, c in enumerate(cells) if (c["selector"], c["backend"]) == (selector, backend)]


def run_of(data: dict[str, Any], row: int, results: Path) -> Path:
    return results / data["rows"][row]["shown"]


def test_the_answer_and_the_numbers_are_those_of_the_table(data, results: Path) -> None:
    methods = frame.methods(stored.find_runs([results]))
    assert [": ".join(line) for line in data["answer"]] == answer.findings(methods)
    shown = {row["shown"]: row["cells"] for row in data["rows"]}
    assert len(shown) == len(methods)
    for method in methods:
        cells = shown[method.runs[0].path.name]
        for key in ("final_translation_error_mm", "ms_per_scan", "coverage"):
            expected = method.row.get(key)
            assert cells.get(key) == (None if expected is None else pytest.approx(expected, 1e-5))
    assert sum(row["best"] for row in data["rows"]) == 1


def test_failed_runs_are_rows_with_their_reason(data) -> None:
    (failed,) = rows_of(data, "previous", HOSTILE)
    assert data["runs"][failed] is None
    assert data["rows"][failed]["reasons"] == [f"no {HOSTILE} & \u2028 more"]


def test_markup_in_names_is_nowhere_markup(html: str) -> None:
    assert "alert(1)<" not in html and html.count("<script") == 2
    assert html.count("</script>") == 2 and "<img" not in html


def test_the_page_names_no_address(html: str) -> None:
    code = html.partition('<script id="data-of-page"')[0] + html.rpartition("<script>")[2]
    foreign = code.replace("http://www.w3.org/2000/svg", "")  # a name, which nobody fetches
    assert not re.search(r"https?:|url\(|@import|<link|src=", foreign)
    assert "default-src 'none'" in code and "connect-src" not in code


def test_the_same_runs_make_the_same_page(html: str, results: Path) -> None:
    assert assemble.page([results])[0] == html


def test_poses_are_those_of_the_run(data, results: Path) -> None:
    row = rows_of(data, "previous")[0]
    T = Trajectory.read_tum(run_of(data, row, results) / "trajectory.tum").T_world_scan
    poses = unpacked(data["runs"][row]["poses"]).reshape(3, -1)
    np.testing.assert_allclose(poses[:2], T[:, :2, 3].T, atol=1e-6)
    np.testing.assert_allclose(np.cos(poses[2]), T[:, 0, 0], atol=1e-6)


def test_scans_are_those_of_the_data(data, results: Path) -> None:
    points = data["scenes"][0]["points"]
    assert points["every"] == 1 and points["thinned"] == ""
    run = stored.read_run(results / "plicp-previous")
    dataset = scans.open_scans(run, False, 10**6).dataset
    ends, xy = unpacked(points["ends"]), unpacked(points["xyz"]).reshape(-1, 2) * points["scale"]
    np.testing.assert_allclose(xy[ends[4] : ends[5]], dataset[5].points[:, :2], atol=1e-3)


def test_replayed_choices_are_those_that_were_made(data, results: Path) -> None:
    refused = passed = 0
    for row in [*rows_of(data, "rbtm"), *rows_of(data, "previous")]:
        steps = pq.read_table(run_of(data, row, results) / "steps.parquet").to_pydict()
        chosen = data["runs"][row]["choices"]
        assert chosen["others"] == 0 and chosen["every"] == 1
        counts, gaps, scores, fates = (
            unpacked(chosen[name]) for name in ("counts", "gaps", "scores", "fates")
        )
        ends = np.cumsum(counts)
        for j in range(1, len(counts)):
            part = slice(ends[j] - counts[j], ends[j])
            mine = np.flatnonzero(fates[part] == choices.CHOSEN)
            matched = steps["status"][j] in choices.MATCHED
            assert len(mine) == matched
            if matched:
                assert j - gaps[part][mine[0]] == steps["model"][j]
                if chosen["scored"]:
                    assert 1e-4 * scores[part][mine[0]] == pytest.approx(
                        steps["score"][j], abs=1e-4
                    )
            names = [line.partition(":")[0] for line in steps["refused"][j].splitlines()]
            assert len(names) == steps["rejected"][j]
            assert sorted(map(int, names)) == sorted(j - gaps[part][fates[part] == choices.REFUSED])
            refused += len(names)
            passed += int((fates[part] == choices.PASSED).sum())
    assert refused > 0 and passed > 0


def test_the_guess_is_what_the_registration_began_from(data, results: Path) -> None:
    """Constant velocity along the stored poses."""
    row = rows_of(data, "previous")[0]
    T = Trajectory.read_tum(run_of(data, row, results) / "trajectory.tum").T_world_scan
    x, y, _ = unpacked(data["runs"][row]["choices"]["guess"]).reshape(3, -1)
    moved = np.linalg.inv(T[3]) @ T[4]
    np.testing.assert_allclose([x[5], y[5]], moved[:2, 3], atol=1e-6)


@pytest.fixture
def copy(results: Path, tmp_path: Path) -> Path:
    """One of the runs, to be spoilt."""
    return Path(shutil.copytree(results / "plicp-previous", tmp_path / "spoilt"))


def rewritten(run: Path, **sections: dict[str, Any]) -> None:
    config = yaml.safe_load((run / "config.yaml").read_text("utf-8"))
    for group, values in sections.items():
        config[group] = {**config[group], **values}
    (run / "config.yaml").write_text(yaml.safe_dump(config), encoding="utf-8")


def test_other_data_than_the_run_saw_are_not_shown(copy: Path) -> None:
    rewritten(copy, dataset={"range_noise": 0.02})
    data = payload(assemble.page([copy])[0])
    (scene,) = data["scenes"]
    assert "not what they were" in scene["note"] and "points" not in scene
    own = data["runs"][0]["map"]  # the run's own map stands in
    assert len(unpacked(own["xy"])) > 100


def test_foreign_code_is_not_run_unless_trusted(copy: Path, tmp_path: Path) -> None:
    rewritten(copy, dataset={"_target_": "pathlib.Path.mkdir", "self": None})
    (tmp_path / "sly.py").write_text("raise RuntimeError('it ran')")
    for trust, words in ((False, "--trust"), (True, "")):
        (scene,) = payload(assemble.page([copy], trust)[0])["scenes"]
        assert words in scene["note"] and "points" not in scene


def test_a_damaged_run_costs_its_own_row_alone(copy: Path, results: Path) -> None:
    (copy / "steps.parquet").write_bytes(b"PAR1 nothing")
    text, notes = assemble.page([copy, results / "none-previous"])
    data = payload(text)
    assert sorted(run is None for run in data["runs"]) == [False, True]
    assert any("steps.parquet" in note for note in notes)


def test_much_is_thinned_and_says_so(results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "THIN", 10)
    monkeypatch.setattr(assemble, "STORED", 30)
    monkeypatch.setattr(scans, "POINTS", 900)
    text, notes = assemble.page([results])
    data = payload(text)
    whole = [run for run in data["runs"] if run and run["whole"]]
    thin = [run for run in data["runs"] if run and not run["whole"]]
    assert len(whole) == 1 and len(thin) == 9
    assert all(len(unpacked(run["kept"])) == 10 and run["scans"] == 24 for run in thin)
    assert "9 of 11 rows are kept without their scans" in notes
    points = data["scenes"][0]["points"]
    assert points["every"] == 2 and "every 2th scan" in points["thinned"]
    assert len(unpacked(points["ends"])) == 12 and len(unpacked(points["xyz"])) <= 2 * 900


def test_the_command_writes_one_file(results: Path, tmp_path: Path) -> None:
    code, out, error = call("report", str(results), f"out={tmp_path / 'page.html'}")
    assert code == 0 and error == ""
    assert "page.html" in out
    assert (tmp_path / "page.html").read_text("utf-8").startswith("<!doctype html>")
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["nowhere"], "nowhere: no such file or folder"),
        ([".", "out=."], "is a folder"),
        ([".", "--serve", "--out", "x.html"], "--serve"),
    ],
)
def test_mistakes_are_one_line(words: list[str], expected: str, results: Path) -> None:
    code, _, error = call("report", *words, cwd=results)
    assert code in (1, 2) and expected in error and error.count("\n") == 1
