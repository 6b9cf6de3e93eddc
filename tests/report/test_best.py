"""The end of a sweep: best settings, tries, reuse, failures, and warnings about merged runs.

Every number is worked out by hand from run folders that the tests write.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from omegaconf import OmegaConf

from rbtm_bench.cli.commands import main
from rbtm_bench.core.files import write_json, write_text
from rbtm_bench.report import best_settings, frame, render, screen
from rbtm_bench.runs import stored

MM = "final_translation_error_mm"
RELATIONS = "relations_translation_mean_m"


def make_run(
    path: Path,
    selector: str,
    error: float | None,
    *,
    backend: str = "p2p",
    seed: int = 0,
    key: str = MM,
    dataset: str = "corridor",
    status: str = "done",
    reason: str | None = None,
    data: dict[str, Any] | None = None,
    metrics: dict[str, Any] | None = None,
    record: dict[str, Any] | None = None,
    shared: dict[str, Any] | None = None,
    **settings: Any,
) -> Path:
    """The files of a run that tables are made of. ``settings`` are the selector's."""
    path.mkdir(parents=True)
    config = {
        "seed": seed,
        "out": str(path),
        "dataset": {"seed": seed} if data is None else data,
        "backend": {"radius": 0.3},
        "selector": settings,
    }
    written = OmegaConf.to_yaml(OmegaConf.create({**config, **(shared or {})}))
    write_text(path / "config.yaml", written)
    choices = {"dataset": dataset, "backend": backend, "selector": selector}
    head = {"status": status, "reason": reason, "choices": choices, "seed": seed, "scans": 11}
    write_json(path / "run.json", {**head, **(record or {})})
    if status == "done":
        values = {key: error, "coverage": 1.0, "ms_per_scan": 2.0, "rejected": 0}
        write_json(path / "metrics.json", {**values, **(metrics or {})})
    return path


def best_of(*folders: Path) -> list[dict[str, Any]]:
    table = best_settings.best(frame.over_seeds(stored.find_runs(folders)))
    return table.astype(object).where(table.notna(), None).to_dict(orient="records")


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """Two backends, three seeds; medians by hand: rbtm 4: 30, 8: 20, previous 100, keyframe 25."""
    out = tmp_path / "sweep"
    errors = {4: (10, 30, 90), 8: (40, 20, 15)}
    for backend, more in (("p2p", 0.0), ("gicp", 100.0)):
        for seed in range(3):
            place = f"{backend}-{seed}"
            for window, of_seeds in errors.items():
                make_run(
                    out / f"{place}-rbtm{window}", "rbtm", more + of_seeds[seed],
                    backend=backend, seed=seed, window=window, threshold=0.7,
                )  # fmt: skip
            make_run(out / f"{place}-prev", "previous", more + 100, backend=backend, seed=seed)
            make_run(
                out / f"{place}-key",
                "keyframe",
                more + 25,
                backend=backend,
                seed=seed,
                distance=0.3,
            )
    return out


# --- the best setting of every method


def test_best_is_by_median_over_seeds_with_its_tries_and_sorted_by_error(sweep: Path) -> None:
    rows = best_of(sweep)
    shown = [
        (r["backend"], r["selector"], r["window"], r[MM], r["tried"], r["seeds"]) for r in rows
    ]
    assert shown == [
        ("gicp", "rbtm", 8, 120, 2, 3),
        ("gicp", "keyframe", None, 125, 1, 3),
        ("gicp", "previous", None, 200, 1, 3),
        ("p2p", "rbtm", 8, 20, 2, 3),
        ("p2p", "keyframe", None, 25, 1, 3),
        ("p2p", "previous", None, 100, 1, 3),
    ]


def test_settings_beside_the_selector_are_tries_as_well(tmp_path: Path) -> None:
    for i, (kernel, error) in enumerate((("none", 7.0), ("huber", 5.0), ("tukey", 6.0))):
        shared = {"backend": {"kernel": kernel}}
        make_run(tmp_path / str(i), "previous", error, shared=shared)
    (row,) = best_of(tmp_path)
    assert (row["tried"], row[MM], row["settings"]) == (3, 5.0, "backend.kernel=huber")


def test_what_changes_no_number_is_no_setting(tmp_path: Path) -> None:
    for i, shared in enumerate(({"pictures": True}, {"pictures": False, "time_limit": 5.0})):
        make_run(tmp_path / str(i), "previous", 3.0, seed=i, data={}, shared=shared)
    (row,) = best_of(tmp_path)
    assert (row["tried"], row["seeds"], row["settings"]) == (1, 2, "")


def test_data_sets_have_their_own_main_error(tmp_path: Path) -> None:
    make_run(tmp_path / "a", "rbtm", 9.0, window=4)
    make_run(tmp_path / "b", "rbtm", 8.0, window=8)
    logs = {"key": RELATIONS, "dataset": "carmen", "data": {"path": "a.clf"}}
    # a final position error does not count on data with relations
    make_run(tmp_path / "c", "rbtm", 0.5, window=4, metrics={MM: 1.0}, **logs)
    make_run(tmp_path / "d", "rbtm", 0.4, window=8, metrics={MM: 2.0}, **logs)
    corridor, log = best_of(tmp_path)
    assert (corridor["data"], corridor["window"], corridor[MM]) == ("corridor", 8, 8.0)
    assert (log["data"], log["window"], log[RELATIONS]) == ("carmen", 8, 0.4)
    table = best_settings.best(frame.over_seeds(stored.find_runs([tmp_path])))
    columns, main_errors = best_settings.best_columns(table)
    assert set(main_errors) == {MM, RELATIONS} and columns[-2:] == ["ms_per_scan", "tried"]


def test_a_second_error_stands_beside_the_main_one(tmp_path: Path) -> None:
    make_run(
        tmp_path / "a", "rbtm", 9.0, metrics={"ape_rmse_m": 0.1, "final_rotation_error_deg": 1}
    )
    table = best_settings.best(frame.over_seeds(stored.find_runs([tmp_path])))
    assert best_settings.best_columns(table)[0][-4:] == [MM, "ape_rmse_m", "ms_per_scan", "tried"]


def test_a_setting_with_a_failed_run_does_not_beat_a_whole_one(tmp_path: Path) -> None:
    for seed in (0, 1):
        make_run(tmp_path / f"whole{seed}", "rbtm", 50.0, seed=seed, window=4)
    make_run(tmp_path / "lucky", "rbtm", 1.0, seed=0, window=8)
    make_run(tmp_path / "lost", "rbtm", None, seed=1, window=8, status="failed")
    make_run(tmp_path / "never", "rbtm", None, seed=0, window=16, status="failed")
    (row,) = best_of(tmp_path)
    assert (row["window"], row[MM], row["tried"]) == (4, 50.0, 3)
    for seed in (0, 1):
        (tmp_path / f"whole{seed}" / "metrics.json").unlink()
        write_json(tmp_path / f"whole{seed}" / "metrics.json", {})
    (row,) = best_of(tmp_path)  # now it stands alone
    assert (row["window"], row[MM], row["status"]) == (8, 1.0, "1 of 2 done")


def test_without_any_error_no_setting_is_named(tmp_path: Path) -> None:
    make_run(tmp_path / "good", "previous", 5.0)
    for window in (4, 8):
        make_run(tmp_path / f"bad{window}", "rbtm", None, window=window, status="failed")
    good, bad = best_of(tmp_path)
    assert good["selector"] == "previous"
    assert (bad["selector"], bad["window"], bad["tried"]) == ("rbtm", None, 2)
    assert bad["status"] == "0 of 1 done"


def test_of_equal_settings_the_smallest_window_stands_for_all(tmp_path: Path) -> None:
    for window in (16, 4, 8):
        make_run(tmp_path / f"{window}", "rbtm", 5.0 if window < 16 else 6.0, window=window)
    (row,) = best_of(tmp_path)
    assert (row["window"], row["equal"], row["tried"]) == (4, 2, 3)
    table = best_settings.best(frame.over_seeds(stored.find_runs([tmp_path])))
    assert any("smallest window" in line for line in best_settings.chances(table))


# --- the notes beside it


def test_unequal_tries_are_named_in_words(sweep: Path) -> None:
    table = best_settings.best(frame.over_seeds(stored.find_runs([sweep])))
    first, second = best_settings.chances(table)
    assert "chosen on the very data shown" in first
    assert second == (
        "rbtm had 2 settings to choose from, keyframe and previous 1 each: not an equal chance"
    )
    one = best_settings.best(table.drop(columns=["tried", "equal"]))
    assert best_settings.chances(one) == []  # a setting each: nothing was chosen


def test_tries_that_differ_between_backends_name_them(sweep: Path) -> None:
    make_run(sweep / "z", "previous", 1.0, seed=0, shared={"backend": {"radius": 9}})
    table = best_settings.best(frame.over_seeds(stored.find_runs([sweep])))
    assert best_settings.chances(table)[1:] == [
        "gicp: rbtm had 2 settings to choose from, keyframe and previous 1 each: "
        "not an equal chance",
        "p2p: previous and rbtm had 2 settings each to choose from, keyframe 1: "
        "not an equal chance",
    ]


def test_equal_tries_are_noted_as_equal(tmp_path: Path) -> None:
    for value in (4, 8):
        make_run(tmp_path / f"r{value}", "rbtm", float(value), window=value)
        make_run(tmp_path / f"g{value}", "fixed_gap", float(value), gap=value)
    table = best_settings.best(frame.over_seeds(stored.find_runs([tmp_path])))
    assert best_settings.chances(table)[1:] == ["every method had 2 settings to choose from"]


# --- the screen at the end


def test_a_setting_each_gives_one_table_only(tmp_path: Path) -> None:
    folders = [make_run(tmp_path / s, s, 5.0) for s in ("previous", "keyframe")]
    text = screen.of_runs(tmp_path, screen.tables_of(folders))
    assert text.count("backend") == 1 and "best" not in text and "tried" not in text


def test_a_small_sweep_shows_the_best_and_then_all(sweep: Path) -> None:
    text = screen.of_runs(sweep, screen.tables_of(sorted(sweep.iterdir())))
    assert text.startswith("the best setting of every method, by final position")
    assert text.count("backend   ") == 2 and "not printed" not in text
    assert "medians over the runs of a method that differ only in their seed (3)" in text
    assert "rbtm is 1.25 times lower on these 3 runs" in text and "Best of" not in text
    assert text.index("not an equal chance") < text.index("\nall:\n") < text.index("1.25 times")
    assert str(sweep / "summary.csv") in text


def test_the_table_of_a_big_sweep_is_written_not_printed(tmp_path: Path) -> None:
    folders = [
        make_run(tmp_path / f"r{i}", "rbtm", 100.0 - i, window=i + 2) for i in range(screen.LONG)
    ]
    folders.append(make_run(tmp_path / "p", "previous", 50.0))
    tables = screen.tables_of(folders)
    text = screen.of_runs(tmp_path, tables)
    assert not (tmp_path / "summary.csv").exists()
    screen.write_tables(tmp_path, tables)
    assert "the table of all 31 methods is not printed, only written" in text
    assert len(text.splitlines()) < 24
    assert len((tmp_path / "summary.csv").read_text().splitlines()) == 32
    assert len((tmp_path / "table.csv").read_text().splitlines()) == 32


def test_registrations_reused_are_counted_over_the_sweep(tmp_path: Path) -> None:
    # 10 accepted of 11 scans, of which 6 reused; 5 accepted, of which 1 reused
    shares = [{"reused": 0.6}, {"reused": 0.2, "coverage": 0.5, "rejected": 3}, {"reused": None}]
    for i, metrics in enumerate(shares):
        make_run(tmp_path / str(i), "rbtm", 1.0, window=i, metrics=metrics)
    make_run(tmp_path / "none", "rbtm", 1.0, backend="none", metrics={"reused": 0.0})
    runs = stored.find_runs([tmp_path])
    assert screen.reuse(runs) == [
        "registrations: asked 15, computed 8, reused 46.7% (and 3 rejected ones)"
    ]
    assert screen.reuse(runs[2:]) == []
    assert "reused" in frame.frame(runs).columns


def test_failures_are_counted_by_reason(tmp_path: Path) -> None:
    make_run(tmp_path / "good", "rbtm", 1.0)
    for i in range(3):
        make_run(tmp_path / f"slow{i}", "rbtm", None, status="failed", reason="time limit of 5 s")
    make_run(tmp_path / "crash", "rbtm", None, status="failed", reason="signal 11 (SIGSEGV)")
    runs = stored.find_runs([tmp_path])
    assert screen.reasons(runs) == [
        "failed: 4 of 5 runs",
        "  3 x time limit of 5 s (slow0, slow1, 1 more)",
        "  1 x signal 11 (SIGSEGV) (crash)",
    ]
    make_run(tmp_path / "open", "rbtm", None, status="started")
    lines = screen.reasons(stored.find_runs([tmp_path]))
    assert lines[0] == "not done: 5 of 6 runs"
    assert "  1 x started, but never ended (open)" in lines
    assert screen.reasons(runs[1:2]) == []


# --- several sweeps as one


def versioned(path: Path, selector: str, version: str, print_: str, **more: Any) -> Path:
    record = {"versions": {"open3d": version, "numpy": "2"}, "dataset_fingerprint": print_}
    return make_run(path, selector, 1.0, record={**record, "git": "abc"}, **more)


def test_alike_runs_give_no_warning(tmp_path: Path) -> None:
    for seed in (0, 1):  # another seed is other data, and may be
        versioned(tmp_path / f"a{seed}", "rbtm", "0.20", f"data{seed}", seed=seed)
        versioned(tmp_path / f"b{seed}", "previous", "0.20", f"data{seed}", seed=seed)
    assert screen.comparison_warnings(stored.find_runs([tmp_path])) == []


def test_other_versions_name_themselves_and_their_runs(tmp_path: Path) -> None:
    for i in range(3):
        versioned(tmp_path / "one" / str(i), "rbtm", "0.20", "data", window=i)
    versioned(tmp_path / "two" / "9", "rbtm", "0.19", "data", window=9)
    record = json.loads((tmp_path / "one" / "0" / "run.json").read_text())
    write_json(tmp_path / "one" / "0" / "run.json", {**record, "git": "abc+"})
    assert screen.comparison_warnings(stored.find_runs([tmp_path / "one", tmp_path / "two"])) == [
        f"open3d differs: 0.20 in 3 runs ({tmp_path / 'one'}), "
        f"0.19 in 1 run ({tmp_path / 'two' / '9'})",
        f"the checkout (git) differs: abc+ in 1 run ({tmp_path / 'one' / '0'}), "
        f"abc in 3 runs ({tmp_path / 'one'}, {tmp_path / 'two'})",
    ]


def test_other_data_under_the_same_name_and_seed_are_named(tmp_path: Path) -> None:
    for seed in (0, 1, 2):
        versioned(tmp_path / "a" / str(seed), "rbtm", "1", f"old{seed}", seed=seed)
        versioned(tmp_path / "b" / str(seed), "previous", "1", f"new{seed}", seed=seed)
    (line,) = screen.comparison_warnings(stored.find_runs([tmp_path]))
    assert line == (
        f"corridor, seed 0: the data differ: old0 in 1 run ({tmp_path / 'a' / '0'}), "
        f"new0 in 1 run ({tmp_path / 'b' / '0'}); and so for 2 more seeds"
    )


def test_a_log_is_the_same_data_whatever_the_seed(tmp_path: Path) -> None:
    log = {"dataset": "carmen", "data": {"path": "a.clf"}}
    versioned(tmp_path / "a", "rbtm", "1", "old", seed=0, **log)
    versioned(tmp_path / "b", "rbtm", "1", "new", seed=1, **log)
    (line,) = screen.comparison_warnings(stored.find_runs([tmp_path]))
    assert line.startswith("carmen: the data differ: old in 1 run")


def test_repeated_runs_are_counted(tmp_path: Path) -> None:
    for place in "abc":
        versioned(tmp_path / place / "run", "rbtm", "1", "data", window=4)
    (line,) = screen.comparison_warnings(stored.find_runs([tmp_path]))
    assert line == "2 runs repeat the settings and the seed of another; medians count each"


def test_table_merges_sweeps_and_warns_on_standard_error(tmp_path: Path, capsys: Any) -> None:
    versioned(tmp_path / "one" / "r", "rbtm", "0.20", "data", window=4)
    versioned(tmp_path / "two" / "p", "previous", "0.19", "data")
    paths = [str(tmp_path / "one"), str(tmp_path / "two")]
    assert main(["table", *paths, "--format", "csv", "--columns", "selector"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "selector\nrbtm\nprevious\n"
    assert printed.err.startswith("warning: open3d differs") and printed.err.count("\n") == 1


@pytest.mark.parametrize("fmt", render.FORMATS)
def test_table_best_rebuilds_the_end_of_a_sweep(sweep: Path, capsys: Any, fmt: str) -> None:
    assert main(["table", str(sweep), "--best", "--format", fmt]) == 0
    printed = capsys.readouterr()
    assert "tried" in printed.out
    beside = printed.out if fmt == "text" else printed.err
    assert "not an equal chance" in beside
    if fmt == "json":
        rows = json.loads(printed.out)
        assert [row["tried"] for row in rows] == [2, 1, 1, 2, 1, 1]
        assert rows[0]["window"] == 8 and rows[0]["ms_per_scan"] == 2.0
    if fmt == "text":
        tables = screen.tables_of(sorted(sweep.glob("*-*")))
        table, _, _ = printed.out.partition("\nthe answer:")
        assert "the answer:" in printed.out and table.strip() in screen.of_runs(sweep, tables)


# --- reading


SCALARS = {
    "float": 1e-5, "large": 1e16, "text": "1e-5", "day": "2020-01-01", "no": "no", "on": True,
    "none": None, "list": [1, 2.5, "a"], "nested": {"a": {"b": -3}}, "umlaut": "größe",
    "lines": "a\nb", "infinite": float("inf"), "time": "12:30:00", "missing": "???",
}  # fmt: skip


def test_settings_are_read_as_omegaconf_reads_them(tmp_path: Path) -> None:
    path = make_run(tmp_path / "run", "rbtm", 1.0, shared=SCALARS)
    expected = OmegaConf.to_container(OmegaConf.load(path / "config.yaml"))
    assert stored.read_run(path).config == expected
    for text in ("a: 1e-5", "a: 1.e3", "a: 2020-01-01", "a: 1_000", "a: .5", "a: '1e3'"):
        write_text(path / "config.yaml", text)
        expected = OmegaConf.to_container(OmegaConf.load(path / "config.yaml"))
        assert stored.read_run(path).config == expected
    assert yaml.SafeLoader.yaml_implicit_resolvers["2"]  # others still find their dates


def test_a_source_of_gaps_is_read_again_when_it_changes(tmp_path: Path) -> None:
    source = make_run(tmp_path / "source", "rbtm", 1.0, window=4, threshold=0.5)
    drawn = make_run(tmp_path / "drawn", "random_gap", 1.0, gaps_from=str(source))
    assert frame.source_words(stored.read_run(drawn)) == "rbtm window=4 threshold=0.5"
    text = (source / "config.yaml").read_text().replace("window: 4", "window: 16")
    write_text(source / "config.yaml", text)
    assert frame.source_words(stored.read_run(drawn)) == "rbtm window=16 threshold=0.5"
