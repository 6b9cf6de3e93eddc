"""The paragraph at the end: who won, who is tied, what it costs, which alarms stand, what next."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from stat_helpers import MM, make_replicates, make_run, shown

from rbtm_bench.cli.commands import main
from rbtm_bench.report import answer, best_settings, frame, render
from rbtm_bench.runs import stored


def told(folder: Path) -> list[str]:
    lines = answer.answer(frame.methods(stored.find_runs([folder])), "results/x")
    assert lines[0] == "the answer:" and len(lines) <= answer.MOST
    return lines


def one(folder: Path, selector: str, error: float, path: str = "", **more: Any) -> None:
    metrics = {MM: error, "coverage": more.pop("coverage", 1.0), "ms_per_scan": 2.0}
    metrics |= more.pop("metrics", {})
    name = f"{more.get('backend', 'p2p')}-{selector}-{error:g}"
    record = {"trajectory_sha256": path or name, **more.pop("told", {})}
    make_run(folder / name, selector, metrics, told=record, **more)


def test_winner_over_all_rows_cost_and_what_loses_to_no_registration(tmp_path: Path) -> None:
    one(tmp_path, "rbtm", 20.0, window=10)
    one(tmp_path, "previous", 90.0)
    one(tmp_path, "previous", 40.0, backend="none", metrics={"ms_per_scan": 0.1})
    one(tmp_path, "oracle", 1.0)
    text = " ".join(" ".join(told(tmp_path)).split())
    assert f"winner ({MM}): p2p rbtm (window 10), 20 mm (one run); 4 rows" in text
    assert "cost (ms_per_scan): 2 ms; the least: none previous, 0.1 ms" in text
    assert f"worse than no registration ({MM} > 40 mm): 1 of 3: p2p previous" in text


def test_ties_are_those_that_replicates_cannot_part(tmp_path: Path) -> None:
    make_replicates(tmp_path, "rbtm", [10.0 + i / 10 for i in range(10)])
    make_replicates(tmp_path, "keyframe", [11.0 - i / 10 for i in range(10)])
    make_replicates(tmp_path, "previous", [90.0 + i for i in range(10)])
    text = " ".join(" ".join(told(tmp_path)).split())
    assert "worst 10.9, 10 replicates" in text
    assert f"not told apart from it (p_holm, ratio of {MM}): 1 of 2: p2p keyframe" in text


def test_replicates_that_cannot_part_so_many_methods_are_named(tmp_path: Path) -> None:
    """Nine pairs reach p = 2 / 2^9, fourteen times that is .055: no difference could show."""
    for gap in range(2, 16):
        make_replicates(
            tmp_path, "previous", [90.0 * gap + i for i in range(9)], name=f"gap{gap}", gap=gap
        )
    make_replicates(tmp_path, "rbtm", [10.0 + i for i in range(9)])
    text = " ".join(" ".join(told(tmp_path)).split())
    assert "14 of 14" in text
    assert "; 9 replicates cannot part any of 14 comparisons, 10 could)" in text


@pytest.mark.parametrize(
    ("shares", "words"),
    [
        ({"decided": 0.0, "pick_oldest": 1.0}, "passed always (the same as oldest)"),
        ({"decided": 0.0, "pick_none": 1.0}, "passed never (the fallback alone)"),
        ({"decided": 0.0, "pick_none": 0.5, "pick_oldest": 0.5}, "never decided"),
        ({"decided": 1.0}, "decided every scan"),
        ({"decided": 0.3}, ""),
        ({"decided": None}, ""),
    ],
)
def test_a_threshold_that_does_the_same_for_every_scan(shares: Any, words: str) -> None:
    said = answer.idle_threshold(shares)
    assert said.endswith(words) and bool(said) == bool(words)


def test_alarms(tmp_path: Path) -> None:
    one(tmp_path, "oldest", 20.0, "same")
    one(
        tmp_path,
        "rbtm",
        20.0,
        "same",
        window=10,
        threshold=0.1,
        metrics={"decided": 0.0, "pick_oldest": 1.0},
    )
    why = {"why_unregistered": "2.00 m from the guess", "readings": ["data: caution: odd truth"]}
    one(tmp_path, "previous", 70.0, coverage=0.25, told=why)
    one(tmp_path, "keyframe", 30.0, "k", distance=0.3)
    one(tmp_path, "keyframe", 30.5, "k", distance=0.4)
    make_run(tmp_path / "failed", "fixed_gap", None, told={"reason": "out of luck"})
    runs = stored.find_runs([tmp_path])
    found = answer.alarms(frame.methods(runs))
    assert found[0] == "alarm (status): 1 of 6 runs failed: out of luck"
    assert found[1] == "alarm (coverage): DEAD, under half registered: p2p previous 25%"
    assert found[2].startswith("alarm (decided): the threshold passed always")
    assert "p2p oldest = p2p rbtm (window 10, threshold 0.1) bit for bit" in " ".join(found)
    assert "settings that never bind: p2p keyframe (distance=0.3) = " in " ".join(found)
    assert found[-1] == "alarm (data): caution: odd truth"
    lines = told(tmp_path)
    assert lines[-1].startswith("next: rbtm-bench show")
    assert lines[1].startswith(f"winner ({MM}): p2p oldest")  # of equals the one without threshold
    dead = next(run for run in runs if run.metrics.get("coverage") == 0.25)
    assert answer.dead_words(dead).startswith("DEAD RUN: only 25% of its scans were registered")


@pytest.mark.parametrize("width", ["60", "100"])
def test_tables_fit_the_terminal(
    width: str, tmp_path: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", width)
    for i, error in enumerate((30.0, 10.0, 20.0)):
        more = {f"a_long_metric_number_{k}": 1.5 * k + i for k in range(20)}
        one(tmp_path, ("previous", "rbtm", "keyframe")[i], error, metrics=more)
    out, _ = shown(capsys, str(tmp_path))
    lines = out.splitlines()
    long = [line for line in lines if len(line) > int(width) and not line.startswith("next:")]
    assert long == []
    rows = [line.split() for line in lines if "done" in line or "p2p-" in line]
    assert rows[0][0] == "*" and "p2p-rbtm-10" in rows[0]
    assert any(line.startswith(f"left out at {width} characters") for line in lines)


def test_a_cell_is_wrapped_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "50")
    table = pd.DataFrame({"backend": ["p2p"], "settings": [" ".join(["key=value"] * 30)]})
    lines = render.fitted(table, ["backend", "settings"])[0].splitlines()
    assert len(lines) == 4 and all(len(line) <= 50 for line in lines)


def test_sort_and_filter(tmp_path: Path, capsys: Any) -> None:
    for selector, error in (("previous", 30.0), ("rbtm", 10.0), ("keyframe", 20.0)):
        one(tmp_path, selector, error)
    words = [str(tmp_path), "-f", "csv", "--columns", "selector"]
    assert shown(capsys, *words, "--sort", MM)[0].split()[1:] == ["rbtm", "keyframe", "previous"]
    assert shown(capsys, *words, "--filter", f"{MM} > 15")[0].split()[1:] == [
        "keyframe",
        "previous",
    ]
    for bad in (["--sort", "nonsense"], ["--filter", "nonsense >"], ["--filter", f"{MM} < 0"]):
        assert main(["table", *words, *bad]) == 2
    assert main(["table", *words[:1], "--against", "rbtm", "--sort", MM]) == 2


def test_ranked_marks_one_row_a_data_set() -> None:
    rows = [("a", "rbtm", 3.0), ("b", "rbtm", 2.0), ("a", "oracle", 1.0), ("b", "previous", None)]
    table = pd.DataFrame(rows, columns=["data", "selector", MM]).assign(status="done")
    marked = best_settings.ranked(table)
    assert marked["won"].tolist() == ["*", "", "*", ""]
    assert marked["selector"].tolist() == ["rbtm", "oracle", "rbtm", "previous"]
    assert best_settings.ranked(marked) is marked


def test_what_follows_a_recipe_is_the_recipe_with_replicates(tmp_path: Path) -> None:
    """Not other selectors: it has set the one that it names."""
    told = {"command": "rbtm-bench run a.clf +experiment=best_2d out=x"}
    make_run(tmp_path / "a", "keyframe", {MM: 10.0}, told=told)
    methods = frame.methods(stored.find_runs([tmp_path]))
    last = answer.answer(methods, str(tmp_path))[-1]
    assert last == "next: rbtm-bench compare a.clf +experiment=best_2d replicates=10"
