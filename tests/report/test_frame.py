"""Runs read back: columns, medians over seeds, and folders that are damaged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import DataError
from rbtm_bench.report import frame
from rbtm_bench.runs import stored

ASKED_FOR = [
    *("run", "status", "dataset", "backend", "selector", "window", "threshold", "seed", "scans"),
    *("coverage", "final_translation_error_mm", "final_along_mm", "final_cross_mm"),
    *("final_rotation_error_deg", "ape_rmse_m", "rpe_translation_rmse_m"),
    *("rpe_rotation_rmse_deg", "relations_used", "relations_total"),
    *("relations_translation_mean_m", "relations_translation_std_m"),
    *("relations_rotation_mean_deg", "relations_rotation_std_deg"),
    *("registrations", "rejected", "fallbacks", "mean_gap", "seconds", "ms_per_scan"),
]


def make_run(
    folder: Path,
    seed: int = 0,
    selector: dict[str, Any] | None = None,
    metrics: dict[str, Any] | None = None,
    dataset: dict[str, Any] | None = None,
    **record: Any,
) -> Path:
    """A run folder written by hand; without metrics it failed."""
    folder.mkdir(parents=True)
    chosen = {"dataset": "corridor", "backend": "open3d_p2p", "selector": "previous"}
    stored_record = {
        "status": "failed" if metrics is None else "done",
        "reason": "RuntimeError: out of luck" if metrics is None else None,
        "seconds": None if metrics is None else 1.5,
        "choices": chosen,
        "seed": seed,
        "scans": 12,
        **record,
    }
    config = {"seed": seed, "out": str(folder), "selector": selector or {}}
    config["dataset"] = {"seed": seed, **(dataset or {})}
    (folder / "run.json").write_text(json.dumps(stored_record))
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    if metrics is not None:
        (folder / "metrics.json").write_text(json.dumps(metrics))
    return folder


def chosen(**choices: str) -> dict[str, str]:
    return {"dataset": "corridor", "backend": "open3d_p2p", "selector": "previous", **choices}


RBTM = {"window": 8, "threshold": 0.5, "fallback": "previous", "content": "scans"}


# --- reading


def test_a_real_run_reads_back(tmp_path: Path) -> None:
    out = tmp_path / "out"
    words = ["dataset.scans=10", "backend=none", "pin=false", f"out='{out}'", "seed=3"]
    assert main(["run", *words, "selector.window=5"]) == 0
    run = stored.read_run(out)
    assert run.done and run.path == out
    row = frame.row(run)
    assert [key for key in row if key in ASKED_FOR] == ASKED_FOR
    assert list(row)[-1] == "reason" and row["reason"] is None
    assert (row["run"], row["status"], row["dataset"]) == ("out", "done", "corridor")
    assert (row["backend"], row["selector"], row["window"]) == ("none", "rbtm", 5)
    assert (row["threshold"], row["seed"], row["scans"]) == (0.7, 3, 10)
    assert row["final_translation_error_mm"] == pytest.approx(1800.0)
    assert row["relations_used"] is None and row["relations_translation_mean_m"] is None
    assert row["registrations"] == 9 and row["rejected"] == 0
    assert set(run.metrics) <= set(row)


def test_runs_below_a_folder_once_each_and_in_order(tmp_path: Path) -> None:
    for name in ("b", "a", "deep/er/c"):
        make_run(tmp_path / name, metrics={})
    runs = stored.find_runs([tmp_path / "b", tmp_path, tmp_path / "deep"])
    assert [run.path.name for run in runs] == ["b", "a", "c"]


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (lambda run: (run / "run.json").write_text("{"), "run.json: not readable as JSON"),
        (lambda run: (run / "run.json").write_text("[]"), "run.json: expected an object"),
        (lambda run: (run / "run.json").write_bytes(b"\xff\xfe"), "run.json: not UTF-8 text"),
        (lambda run: (run / "run.json").write_text('{"choices": 3}'), "run.json: choices"),
        (lambda run: (run / "metrics.json").write_text('{"a":'), "metrics.json: not readable"),
        (lambda run: (run / "metrics.json").write_text("3"), "metrics.json: expected an object"),
        (lambda run: (run / "config.yaml").unlink(), "config.yaml"),
        (lambda run: (run / "config.yaml").write_text("a: [1"), "config.yaml"),
        (lambda run: (run / "config.yaml").write_text("- 1"), "config.yaml: expected"),
        (lambda run: (run / "config.yaml").write_text("selector: 3"), "config.yaml: expected"),
    ],
)
def test_damaged_folders(tmp_path: Path, damage: Any, named: str) -> None:
    run = make_run(tmp_path / "run", metrics={"ape_rmse_m": 1.0})
    damage(run)
    with pytest.raises(DataError) as caught:
        stored.find_runs([tmp_path])
    message = str(caught.value)
    assert str(run) in message and named in message
    assert len(message.splitlines()) == 1


def test_paths_without_runs(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").touch()
    for path, why in (
        (tmp_path / "nowhere", "no such file or folder"),
        (tmp_path / "empty", "holds no run"),
        (tmp_path / "file", "holds no run"),
    ):
        with pytest.raises(DataError, match=why) as caught:
            stored.find_runs([path])
        assert str(path) in str(caught.value)


# --- rows


def test_a_failed_run_has_no_numbers(tmp_path: Path) -> None:
    row = frame.row(stored.read_run(make_run(tmp_path / "bad")))
    assert (row["status"], row["reason"]) == ("failed", "RuntimeError: out of luck")
    for key in frame.FIRST[frame.FIRST.index("coverage") :]:
        assert row[key] is None, key


def test_a_run_that_was_killed_or_goes_on(tmp_path: Path) -> None:
    run = stored.read_run(make_run(tmp_path / "on", status="started", reason=None))
    assert not run.done and frame.row(run)["status"] == "started"


def test_columns_of_a_frame_do_not_depend_on_the_first_run(tmp_path: Path) -> None:
    make_run(tmp_path / "a")
    make_run(tmp_path / "b", metrics={"ape_rmse_m": 2.0, "own_metric": 3.0})
    table = frame.frame(stored.find_runs([tmp_path]))
    assert [c for c in table if c in ASKED_FOR] == ASKED_FOR
    assert list(table)[-2:] == ["own_metric", "reason"]
    assert table["own_metric"].isna().tolist() == [True, False]


def test_a_row_is_labelled_by_what_differs_in_the_table(tmp_path: Path) -> None:
    every = {**RBTM, "fallback": "skip", "restart_after": None}
    for name, fallback in (("a", "skip"), ("b", "skip"), ("c", "previous")):
        settings = {**every, "fallback": fallback}
        make_run(tmp_path / name, selector=settings, metrics={}, choices=chosen(selector="rbtm"))
    same, both = stored.find_runs([tmp_path / "a", tmp_path / "b"]), stored.find_runs([tmp_path])
    assert frame.frame(same)["settings"].tolist() == ["", ""]
    rows = frame.frame(both).set_index("run")["settings"].to_dict()
    assert rows == {"a": "fallback=skip", "b": "fallback=skip", "c": "fallback=previous"}


def test_the_source_of_gaps_in_words(tmp_path: Path) -> None:
    make_run(tmp_path / "rbtm", selector=RBTM, metrics={}, choices=chosen(selector="rbtm"))
    for folder, words in (("rbtm", "rbtm window=8 threshold=0.5"), ("moved away", "moved away")):
        drawn = {"gaps_from": str(tmp_path / folder), "gaps": None, "seed": 0}
        run = stored.read_run(make_run(tmp_path / f"of {folder}", selector=drawn, metrics={}))
        assert frame.source_words(run) == words


def test_rows_tell_what_differs(tmp_path: Path) -> None:
    for number, name in enumerate(("a.clf", "b.clf")):
        path = {"path": f"logs/{name}", "relations": f"logs/{number}.relations"}
        make_run(tmp_path / name, dataset=path, metrics={}, choices=chosen(dataset="carmen"))
    table = frame.frame(stored.find_runs([tmp_path]))
    assert table["dataset"].tolist() == ["carmen", "carmen"]
    assert [("a.clf" in d, "b.clf" in d) for d in table["data"]] == [(True, False), (False, True)]
    assert len(frame.over_seeds(stored.find_runs([tmp_path]))) == 2


# --- medians over seeds


def test_medians_by_hand(tmp_path: Path) -> None:
    for seed, error in enumerate((30.0, 10.0, 50.0, 20.0)):
        values = {"final_translation_error_mm": error, "registrations": 11, "mean_gap": None}
        make_run(tmp_path / f"run-{seed}", seed=seed, metrics=values)
    (row,) = frame.over_seeds(stored.find_runs([tmp_path])).to_dict("records")
    assert row["final_translation_error_mm"] == 25.0  # of 10, 20, 30, 50
    assert (row["seeds"], row["status"], row["registrations"]) == (4, "done", 11)
    assert row["mean_gap"] is None and row["reason"] is None
    assert "seed" not in row


def test_methods_stay_apart_and_in_order(tmp_path: Path) -> None:
    def method(name: str, backend: str, error: float, **selector: Any) -> None:
        for seed in (0, 1):
            make_run(
                tmp_path / f"{name}-{seed}",
                seed=seed,
                selector=selector,
                metrics={"ape_rmse_m": error + seed},
                choices=chosen(backend=backend, selector=name[2:]),
            )

    method("a-rbtm", "open3d_p2p", 1.0, window=4)
    method("b-rbtm", "none", 2.0, window=4)
    method("c-rbtm", "open3d_p2p", 3.0, window=8)
    table = frame.over_seeds(stored.find_runs([tmp_path]))
    assert table["backend"].tolist() == ["open3d_p2p", "open3d_p2p", "none"]
    assert table["ape_rmse_m"].tolist() == [1.5, 3.5, 2.5]
    assert table["window"].tolist() == [4, 8, 4]
    assert table["seeds"].tolist() == [2, 2, 2]


def test_failed_seeds_do_not_count_as_zero(tmp_path: Path) -> None:
    make_run(tmp_path / "a", seed=0)
    for seed, error in ((1, 4.0), (2, 8.0)):
        make_run(tmp_path / f"b{seed}", seed=seed, metrics={"ape_rmse_m": error, "own": 1.0})
    (row,) = frame.over_seeds(stored.find_runs([tmp_path])).to_dict("records")
    assert (row["ape_rmse_m"], row["seeds"], row["status"]) == (6.0, 3, "2 of 3 done")
    assert row["own"] == 1.0 and row["reason"] == "RuntimeError: out of luck"


def test_only_failed_seeds(tmp_path: Path) -> None:
    for seed in (0, 1):
        make_run(tmp_path / str(seed), seed=seed)
    (row,) = frame.over_seeds(stored.find_runs([tmp_path])).to_dict("records")
    assert row["status"] == "0 of 2 done" and row["ape_rmse_m"] is None


def test_random_gap_runs_of_different_sources_are_different_methods(tmp_path: Path) -> None:
    for window in (4, 8):
        for seed in (0, 1):
            source = tmp_path / f"rbtm-{window}-{seed}"
            rbtm = {**RBTM, "window": window}
            make_run(source, seed=seed, selector=rbtm, metrics={}, choices=chosen(selector="rbtm"))
            drawn = {"gaps_from": str(source), "gaps": None, "seed": seed}
            folder = tmp_path / f"random-{window}-{seed}"
            picked = chosen(selector="random_gap")
            make_run(folder, seed=seed, selector=drawn, metrics={}, choices=picked)
    table = frame.over_seeds(stored.find_runs([tmp_path]))
    drawn_rows = table[table["selector"] == "random_gap"]
    assert sorted(drawn_rows["settings"]) == [
        "gaps of rbtm window=4 threshold=0.5",
        "gaps of rbtm window=8 threshold=0.5",
    ]
    assert drawn_rows["seeds"].tolist() == [2, 2]


def test_a_number_over_seeds_is_the_median_of_those_that_have_it(tmp_path: Path) -> None:
    """Of 1, 2, 90 it is 2 (and not 31); of 4, 10 it is 7; of three runs one has no such number."""
    for seed, (ape, rpe) in enumerate([(90.0, 10.0), (1.0, None), (2.0, 4.0)]):
        metrics = {"ape_rmse_m": ape, "rpe_translation_rmse_m": rpe}
        make_run(tmp_path / str(seed), seed, metrics=metrics)
    (row,) = frame.over_seeds(stored.find_runs([tmp_path])).to_dict("records")
    assert (row["ape_rmse_m"], row["rpe_translation_rmse_m"]) == (2.0, 7.0)
    assert (row["seeds"], row["status"]) == (3, "done")
