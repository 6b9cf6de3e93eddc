"""scripts/freiburg_table.py end to end on the beginnings of the real logs, and its numbers."""

from __future__ import annotations

import contextlib
import io
import json
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from stat_helpers import make_log

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.metrics.relation_errors import RelationErrors
from rbtm_bench.runs.stored import find_runs, read_run
from rbtm_bench.studies.freiburg import command, numbers, plan, words

BACKEND = "small_gicp_icp"
SMALL = ("--max-scans", "260", "--backends", BACKEND, "--jobs", "1")


def call(*words: str) -> tuple[int, str]:
    """Exit code and standard output."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        code = command.main(list(words))
    return code, text.getvalue()


@pytest.fixture(scope="module")
def made(data_dir: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder, and what was printed."""
    out = tmp_path_factory.mktemp("freiburg")
    words = [*SMALL, "--data", str(data_dir), "--out", str(out), "--reference", str(out / "small")]
    code, text = call(*words)
    assert code == 0, text
    return out, text


def test_every_log_backend_and_way_has_a_row(made: tuple[Path, str]) -> None:
    table = pd.read_csv(made[0] / "table.csv", keep_default_na=False)
    ways = ["previous", "keyframe", "fixed_gap", "rbtm"]
    expected = [("none", "none"), *((BACKEND, way) for way in ways)]
    expected += [("kiss_icp_system", "kiss_icp_system")]
    for log in ("ACES", "Intel", "MIT CSAIL"):
        rows = table[table["log"] == log]
        assert list(zip(rows["backend"], rows["way"], strict=True)) == expected
        others = ", ".join(x for x in ("ACES", "Intel", "MIT CSAIL") if x != log)
        assert set(rows[rows["backend"] == BACKEND]["chosen_on"]) == {others}
    assert list(table["tried"]) == [1, 4, 4, 4, 4, 4] * 3
    assert set(table["status"]) == {"done"}


def test_the_setting_shown_did_best_on_the_other_logs(made: tuple[Path, str]) -> None:
    """From the runs alone: by the logarithms of their errors, written down anew."""
    out, _ = made
    table = pd.read_csv(out / "table.csv").set_index(["log", "way"])
    names = {"aces": "ACES", "intel": "Intel", "mit-csail": "MIT CSAIL"}
    for log, name in names.items():
        for way in plan.WAYS:
            scores = []
            for k in range(4):
                errors = [
                    read_run(out / "runs" / f"{other}-{BACKEND}-{way.selector}-{k + 1}").metrics[
                        "relations_translation_mean_m"
                    ]
                    for other in names
                    if other != log
                ]
                scores.append(sum(math.log(e) for e in errors if e is not None))
            best = way.values[int(np.argmin(scores))]
            assert f" {best:g}" in f" {table.loc[(name, way.selector), 'setting']}".rstrip(" m")


def test_the_pages_hold_what_the_tables_say(made: tuple[Path, str]) -> None:
    out, text = made
    page = (out / "README.md").read_text()
    assert "python scripts/freiburg_table.py --backends small_gicp_icp --max-scans 260" in page
    assert (out / "table.md").read_text().strip() in page
    assert re.search(r"Left out: [\w, ]*hsm", page) and "nan" not in page.replace("dominan", "")
    assert str(out) not in page and "freiburg/" not in page.replace("scripts/freiburg", "")
    assert text.strip().splitlines()[-1].startswith("- fixed gap: of ")
    copy = (out / "small" / "freiburg.md").read_text()
    assert re.search(r"\| +ms \|", page) and not re.search(r"\| +ms \|", copy)
    assert page.splitlines()[:20] == copy.splitlines()[:20]
    assert page.splitlines()[-1].startswith("Made by `python scripts/freiburg_table.py")
    small = pd.read_csv(out / "small" / "freiburg.csv")
    whole = pd.read_csv(out / "table.csv")
    assert np.allclose(small["mean_m"], whole["mean_m"], rtol=1e-3, equal_nan=True)
    assert "reason" not in small and "ms_per_scan" not in small


def test_a_second_call_makes_nothing_anew(made: tuple[Path, str], data_dir: Path) -> None:
    out, _ = made
    before = (out / "table.csv").read_bytes()
    code, text = call(*SMALL, "--data", str(data_dir / "freiburg"), "--out", str(out), "--no-runs")
    assert code == 0 and "runs made" not in text
    assert (out / "table.csv").read_bytes() == before
    (out / "runs" / "aces-none" / "run.json").rename(out / "runs" / "aces-none" / "away")
    code, _ = call(*SMALL, "--data", str(data_dir), "--out", str(out), "--no-runs")
    (out / "runs" / "aces-none" / "away").rename(out / "runs" / "aces-none" / "run.json")
    assert code == 2


def test_what_is_missing_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("RBTM_BENCH_DATA", raising=False)
    part, whole = tmp_path / "part", tmp_path / "whole"
    for folder, names in ((part, ["aces"]), (whole, ["aces", "intel", "mit-csail"])):
        folder.mkdir()
        for name in names:
            (folder / f"{name}.clf").touch()
            (folder / f"{name}.relations").touch()
    for options, message in (
        ((), "set RBTM_BENCH_DATA"),
        (("--data", str(tmp_path / "none")), "no such folder"),
        (("--logs", str(part)), "lacks intel.clf.gz, intel.relations, mit-csail.clf.gz, mit"),
        (("--data", str(whole), "--backends", "nix"), "--backends nix: no installed planar"),
        (("--data", str(whole), "--max-scans", "1"), "expected at least 2"),
    ):
        assert command.main([*options, "--out", str(tmp_path / "out")]) == 2
        error = capsys.readouterr().err
        assert message in error and len(error.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_sizes() -> None:
    full, quick = plan.make_size(False, None, None), plan.make_size(True, None, None)
    assert set(quick.backends) < set(full.backends) and full.left_out == ()
    assert (full.max_scans, quick.max_scans) == (None, plan.QUICK_SCANS)
    assert set(quick.left_out) == set(full.backends) - set(quick.backends)
    with pytest.raises(ConfigError, match="no installed planar backend"):
        plan.make_size(False, "none", None)


# --- the numbers, by hand

TRANSFER = pd.DataFrame(columns=["log", "way", "backends", "times"])


def errors_of(long: list[float]) -> RelationErrors:
    """A long relation with each error, in clusters of its own, and as many local ones of 0.5 m in
    blocks of their own."""
    start = 100.0 * np.arange(len(long))
    return RelationErrors(
        np.concatenate([start, start]),
        np.concatenate([start + 1000.0, start + 1.0]),
        np.repeat([False, True], len(long)),
        np.concatenate([np.array(long), np.full(len(long), 0.5)]),
        np.zeros(2 * len(long)),
    )


def test_ratio_over_backends_by_hand() -> None:
    ones = errors_of([1.0] * 4)
    # 2 and 8 times: 4 in the geometric mean; the same in every cluster, so no spread
    pairs = [[errors_of([2.0] * 4), ones], [errors_of([8.0] * 4), ones]]
    ratio = numbers.geometric_ratio(pairs, "long")
    assert (ratio.value, ratio.low, ratio.high, ratio.n) == pytest.approx((4, 4, 4, 4))
    assert numbers.geometric_ratio(pairs, "local").value == pytest.approx(1.0)
    whole = numbers.geometric_ratio(pairs)  # of means (2 + .5) / 1.5 and (8 + .5) / 1.5, by 2
    assert whole.value == pytest.approx(math.sqrt(2.5 / 1.5 * 8.5 / 1.5)) and whole.n == 8


def test_ratio_spreads_with_its_clusters() -> None:
    ours = [1.0, 1.0, 1.0, 1.0, 1.0, 13.0]
    ratio = numbers.geometric_ratio([[errors_of(ours), errors_of([1.0] * 6)]], "long")
    # the bad cluster is not drawn with (5/6)^6 = 33%, four times or more with 0.9%
    assert ratio.value == pytest.approx(3.0) and ratio.low == 1.0 and ratio.high == pytest.approx(7)
    assert not ratio.excludes(2.0) and ratio.excludes(0.99)


def test_ratio_over_relations_that_all_have() -> None:
    ones = errors_of([1.0] * 4)
    gap = errors_of([math.nan, 3.0, 3.0, 3.0])
    ratio = numbers.geometric_ratio([[gap, ones], [ones, errors_of([9.0, 1.0, 1.0, 1.0])]], "long")
    assert ratio.value == pytest.approx(math.sqrt(3.0)) and ratio.n == 3
    assert math.isnan(numbers.geometric_ratio([]).value)
    assert math.isnan(numbers.geometric_ratio([[errors_of([math.nan]), ones]][:0]).value)


@pytest.fixture
def hand(tmp_path: Path) -> Path:
    """Three logs, one backend; RBTM's long errors are below or above those of the controls."""
    for log, ours in (("aces", 1.0), ("intel", 4.0), ("mit-csail", 2.5)):
        more = {"data": {"path": f"x/{log}.clf"}, "fingerprint": log}
        make_log(tmp_path / f"{log}-none", "previous", [9.0] * 6, backend="none", **more)
        for k in (1, 2):
            worse = 0.1 * (k - 1)  # the first try is always the best
            values = {
                "previous": [2.0] * 6,
                "keyframe": [ours] * 6,
                "rbtm": [ours] * 6,
                "fixed_gap": [ours - 0.5, ours + 0.5] * 3,
            }
            for way, errors in values.items():
                name = tmp_path / f"{log}-plicp-{way}-{k}"
                knob = {"gap": k} if way != "previous" else {"extra": k}
                make_log(name, way, [e + worse for e in errors], backend="plicp", **more, **knob)
    return tmp_path


def test_verdicts_and_words_by_hand(hand: Path) -> None:
    chosen = numbers.choose(find_runs([hand]))
    assert len(chosen) == 3 * 5
    assert all(m.runs[0].path.name.endswith(("none", "-1")) for m in chosen.values())
    table = numbers.table(chosen)
    row = table[(table["log"] == "Intel") & (table["way"] == "rbtm")].iloc[0]
    assert (row["long_m"], row["local_m"], row["mean_m"]) == (4.0, 0.5, 2.25)
    assert (row["setting"], row["tried"], row["long_m_n"]) == ("threshold 0.6", 2, 6)
    differences = numbers.differences(chosen, ["plicp"])
    whole = differences[differences["relations"] == "long"].set_index(["log", "control"])
    verdicts = whole["verdict"].to_dict()
    assert [verdicts["ACES", c] for c in numbers.CONTROL_WAYS] == ["better", "better", "", ""]
    assert [verdicts["Intel", c] for c in numbers.CONTROL_WAYS] == ["better", "worse", "", ""]
    assert whole.loc[("ACES", "previous"), "ratio"] == 0.5
    results = words.FreiburgTables(table, differences, numbers.pooled(chosen, ["plicp"]), TRANSFER)
    medians, why = words.medians(table)
    assert "4.75 (0.5, 9)" in medians and "1.25 (0.5, 2)" in medians
    assert "fixed gap 0.5 m" in why
    lines = words.comparison(results)
    first, previous, keyframe, gap = lines[0].splitlines()
    assert "of 3 pairs of log and backend RBTM is better on 3, worse on 0" in first
    assert "better on 1, worse on 2, not told apart on 0" in previous
    assert "ACES 0.6 [0.6, 0.6] (+); Intel 1.8 [1.8, 1.8] (-)" in previous
    assert "not told apart on 3" in keyframe and "not told apart on 3" in gap
    assert "better than no registration (odometry): plicp." in lines[2]


def test_what_choosing_elsewhere_costs(hand: Path) -> None:
    for log in ("aces", "intel"):  # the second try is best on this log, the first one elsewhere
        path = hand / f"{log}-plicp-rbtm-2" / "metrics.json"
        metrics = json.loads(path.read_text())
        best = json.loads((hand / f"{log}-plicp-rbtm-1" / "metrics.json").read_text())
        key = numbers.ERRORS["mean_m"]
        share = 0.5 if log == "aces" else 1.25
        path.write_text(json.dumps({**metrics, key: best[key] * share}))
    runs = find_runs([hand])
    table = numbers.transfer(numbers.choose(runs), runs).set_index(["log", "way"])["times"]
    assert table["ACES", "rbtm"] == pytest.approx(2.0)  # the first was chosen, the second is half
    assert table["Intel", "rbtm"] == pytest.approx(1.25)  # on ACES the second is far better
    assert table["ACES", "previous"] == pytest.approx(1.0)


def test_failed_runs_are_rows_marked_failed(hand: Path) -> None:
    for k in (1, 2):  # every try of RBTM on Intel
        run = hand / f"intel-plicp-rbtm-{k}"
        record = json.loads((run / "run.json").read_text())
        (run / "run.json").write_text(
            json.dumps({**record, "status": "failed", "reason": "out of memory"})
        )
    chosen = numbers.choose(find_runs([hand]))
    table = numbers.table(chosen)
    row = table[(table["log"] == "Intel") & (table["way"] == "rbtm")].iloc[0]
    assert (row["status"], row["reason"]) == ("failed", "out of memory")
    assert math.isnan(row["mean_m"])
    differences = numbers.differences(chosen, ["plicp"])
    rows = differences[differences["log"] == "Intel"]
    assert rows["ratio"].isna().all() and set(rows["verdict"]) == {""}
    results = words.FreiburgTables(table, differences, numbers.pooled(chosen, ["plicp"]), TRANSFER)
    page = words.readme(results, plan.FreiburgSize(("plicp",)), "command", {"numpy": "2"})
    assert "Failed: Intel plicp rbtm (out of memory)." in page
    assert "of 2 pairs of log and backend" in page
