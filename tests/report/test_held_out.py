"""Settings chosen on other data: every choice worked out by hand from run folders of the tests."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from stat_helpers import MEAN, MM, check_latex, make_log, make_run, make_seeds, shown

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import held_out, paired, with_intervals
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.runs import stored

Errors = Mapping[str, float | None]
"""By data set; None: the run failed."""


def make_places(
    folder: Path, selector: str, settings: Mapping[Any, Errors], name: str = "gap", **more: Any
) -> None:
    """A run for every value of a setting and every place."""
    backend = more.get("backend", "p2p")
    for value, errors in settings.items():
        for place, error in errors.items():
            metrics = None if error is None else {MM: error, "ms_per_scan": 2.0}
            where = folder / f"{place}-{backend}-{selector}-{value}"
            data = {"environment": place}
            own = {name: value} if value is not None else {}
            make_run(where, selector, metrics, data=data, fingerprint=place, **more, **own)


def rows_of(chosen: list[MethodRuns]) -> dict[tuple[str, str], dict[str, Any]]:
    """By the last word of the data set and the selector."""
    rows = {
        (m.row["data"].rpartition("=")[2], str(m.row["selector"])): m.row | {"n": len(m.runs)}
        for m in chosen
    }
    assert len(rows) == len(chosen)
    return rows


def left_out(folder: Path) -> dict[tuple[str, str], dict[str, Any]]:
    return rows_of(held_out.leave_one_out(stored.find_runs([folder])))


def settings_of(rows: Mapping[tuple[str, str], dict[str, Any]]) -> dict[str, Any]:
    return {place: row["settings"] for (place, _), row in rows.items()}


# --- leave one out


def test_the_setting_is_the_best_of_the_other_data_sets(tmp_path: Path) -> None:
    # best on each place itself: gap 2 on a, 5 on b and c; on the others of a: 5, of b: 2, of c: 2
    errors = {
        2: {"a": 1.0, "b": 40.0, "c": 20.0},
        5: {"a": 9.0, "b": 10.0, "c": 10.0},
    }
    make_places(tmp_path, "fixed_gap", errors)
    rows = left_out(tmp_path)
    # geometric means over the others: a: 28.3, 10; b: 4.5, 9.5; c: 6.3, 9.5
    assert settings_of(rows) == {"a": "gap=5", "b": "gap=2", "c": "gap=2"}
    assert [rows[p, "fixed_gap"][MM] for p in "abc"] == [9.0, 40.0, 20.0]
    a = rows["a", "fixed_gap"]
    assert (a["tried"], a["equal"], a["left_out"]) == (2, 1, 0)
    assert a["chosen_on"] == "environment=b, environment=c"
    assert a["n"] == 1 and a["seeds"] == 1 and a["status"] == "done"


def test_a_ratio_counts_the_same_on_small_and_large_errors(tmp_path: Path) -> None:
    # on b gap 5 is twice as good, on c a little worse by ratio, though by far more millimetres
    errors = {2: {"a": 1.0, "b": 4.0, "c": 10_000.0}, 5: {"a": 1.0, "b": 2.0, "c": 15_000.0}}
    make_places(tmp_path, "fixed_gap", errors)
    assert left_out(tmp_path)["a", "fixed_gap"]["settings"] == "gap=5"


def test_seeds_of_a_place_count_as_one_data_set(tmp_path: Path) -> None:
    """Over places, not over runs: three good seeds of b do not outvote c."""
    make_places(tmp_path, "fixed_gap", {2: {"a": 1.0, "c": 8.0}, 5: {"a": 1.0, "c": 1.0}})
    for gap, error in ((2, 1.0), (5, 2.0)):
        data = {"environment": "b"}
        make_seeds(tmp_path / f"b{gap}", "fixed_gap", [error] * 3, data=data, gap=gap)
    row = left_out(tmp_path)["a", "fixed_gap"]
    assert row["settings"] == "gap=5"  # 1/2 ln 2 against 1/2 ln 8; of runs 3/4 ln 2, 1/4 ln 8
    assert left_out(tmp_path)["b", "fixed_gap"]["seeds"] == 3


def test_every_backend_and_selector_chooses_for_itself(tmp_path: Path) -> None:
    for backend, better in (("p2p", 2), ("gicp", 5)):
        errors = {gap: dict.fromkeys("ab", 1.0 if gap == better else 3.0) for gap in (2, 5)}
        make_places(tmp_path, "fixed_gap", errors, backend=backend)
        make_places(tmp_path, "previous", {None: dict.fromkeys("ab", 7.0)}, backend=backend)
    chosen = held_out.leave_one_out(stored.find_runs([tmp_path]))
    known = [(m.row["data"][-1], m.row["backend"], m.row["selector"]) for m in chosen]
    assert sorted(known) == sorted(
        (p, b, s) for p in "ab" for b in ("p2p", "gicp") for s in ("fixed_gap", "previous")
    )
    by_backend = {m.row["backend"]: m.row["settings"] for m in chosen if m.row["settings"]}
    assert by_backend == {"p2p": "gap=2", "gicp": "gap=5"}
    single = [m.row for m in chosen if m.row["selector"] == "previous"]
    assert {(row["tried"], row["chosen_on"]) for row in single} == {(1, "")}  # nothing to choose


def test_a_setting_that_failed_elsewhere_is_chosen_only_if_all_did(tmp_path: Path) -> None:
    errors: dict[int, Errors] = {
        2: {"a": 5.0, "b": 1.0, "c": None},
        5: {"a": 6.0, "b": 50.0, "c": 50.0},
    }
    make_places(tmp_path, "fixed_gap", errors)
    rows = left_out(tmp_path)
    assert settings_of(rows) == {"a": "gap=5", "b": "gap=5", "c": "gap=2"}
    assert rows["c", "fixed_gap"]["status"] == "0 of 1 done"  # chosen elsewhere, failed on c
    assert rows["c", "fixed_gap"][MM] is None
    for place in "bc":  # now every setting has failed once among b and c
        (tmp_path / f"{place}-p2p-fixed_gap-5" / "metrics.json").unlink()
    record = tmp_path / "c-p2p-fixed_gap-5" / "run.json"
    record.write_text(record.read_text().replace('"done"', '"failed"'))
    (tmp_path / "b-p2p-fixed_gap-5" / "metrics.json").write_text(json.dumps({MM: 0.5}))
    assert left_out(tmp_path)["a", "fixed_gap"]["settings"] == "gap=5"  # 0.5 on b beats 1.0


def test_a_done_run_without_the_error_has_not_done(tmp_path: Path) -> None:
    make_places(tmp_path, "fixed_gap", {2: {"a": 5.0}, 5: {"a": 6.0, "b": 50.0}})
    data = {"environment": "b"}
    make_run(tmp_path / "x", "fixed_gap", {"ms_per_scan": 1.0}, data=data, gap=2)
    assert left_out(tmp_path)["a", "fixed_gap"]["settings"] == "gap=5"


def test_of_equal_settings_the_first(tmp_path: Path) -> None:
    make_places(tmp_path, "fixed_gap", {g: {"a": float(g), "b": 3.0} for g in (4, 2, 3)})
    row = left_out(tmp_path)["a", "fixed_gap"]
    assert (row["settings"], row["equal"], row["tried"]) == ("gap=2", 3, 3)  # runs are by name


def test_no_error_at_all_is_the_best(tmp_path: Path) -> None:
    errors = {2: {"a": 1.0, "b": 1e-9, "c": 1.0}, 5: {"a": 2.0, "b": 0.0, "c": 1.0}}
    make_places(tmp_path, "fixed_gap", errors)
    assert left_out(tmp_path)["a", "fixed_gap"]["settings"] == "gap=5"


def test_settings_that_not_all_data_have_are_left_out(tmp_path: Path) -> None:
    make_places(tmp_path, "fixed_gap", {2: {"a": 1.0, "b": 1.0}, 5: {"a": 1.0, "b": 9.0},
                                        9: {"a": 0.1}})  # fmt: skip
    chosen = held_out.leave_one_out(stored.find_runs([tmp_path]))
    row = rows_of(chosen)["a", "fixed_gap"]
    assert (row["settings"], row["tried"], row["left_out"]) == ("gap=2", 2, 1)
    assert "1 setting was left out: not run on all of the data" in held_out.choice_notes(chosen)


def test_without_numbers_elsewhere_no_setting_is_named(tmp_path: Path) -> None:
    lost: dict[int, Errors] = {2: {"a": 1.0, "b": None}, 5: {"a": 2.0, "b": None}}
    make_places(tmp_path, "fixed_gap", lost)
    chosen = held_out.leave_one_out(stored.find_runs([tmp_path]))
    row = rows_of(chosen)["a", "fixed_gap"]
    assert (row["status"], row["settings"], row["n"], row.get(MM)) == ("no choice", "", 0, None)
    assert (row["tried"], row["backend"]) == (2, "p2p")
    assert "1 row names no setting: no number on other data to choose by" in held_out.choice_notes(
        chosen
    )
    held_out.chosen_table(chosen)
    assert len(with_intervals.interval_table([], [MM], methods=chosen)) == 2


def test_one_data_set_cannot_leave_one_out(tmp_path: Path) -> None:
    make_places(tmp_path, "fixed_gap", {2: {"a": 1.0}})
    with pytest.raises(ConfigError, match=r"on one data set \(corridor\)"):
        left_out(tmp_path)


def test_files_go_by_their_names_and_many_by_their_number(tmp_path: Path) -> None:
    for log in ("a", "b", "c", "d", "e"):
        for gap in (2, 5):
            data = {"path": f"/far/away/{log}.clf.gz"}
            run = {"data": data, "dataset": "carmen", "fingerprint": log, "gap": gap}
            make_run(tmp_path / f"{log}{gap}", "fixed_gap", {MEAN: 1.0 * gap}, **run)
    chosen = held_out.leave_one_out(stored.find_runs([tmp_path]))
    assert {m.row["chosen_on"] for m in chosen} == {"4 other data sets"}
    for log in "de":
        for gap in (2, 5):
            for file in (tmp_path / f"{log}{gap}").iterdir():
                file.unlink()
    chosen = held_out.leave_one_out(stored.find_runs([tmp_path]))
    assert chosen[0].row["chosen_on"] == "b.clf.gz, c.clf.gz"


# --- chosen on what is named


@pytest.fixture
def seeds(tmp_path: Path) -> Path:
    """Two places with seeds 0 to 7; on the seeds 6 and 7 gap 5 is best in a and gap 2 in b, on the
    others it is the other way round."""
    for place, best, base in (("a", 5, 0.0), ("b", 2, 20.0)):
        data = {"environment": place}
        for gap in (2, 5):
            first, last = (9.0, 2.0) if gap == best else (1.0, 4.0)
            errors = [base + first + s for s in range(6)] + [base + last] * 2
            make_seeds(tmp_path / f"{place}{gap}", "fixed_gap", errors, data=data, gap=gap)
        errors = [base + 10.0 + s for s in range(8)]
        make_seeds(tmp_path / place, "previous", errors, data=data)
    return tmp_path


def test_seeds_that_choose_are_not_shown(seeds: Path) -> None:
    chosen = held_out.choose_on(stored.find_runs([seeds]), "seed", ["6", "7"])
    rows = rows_of(chosen)
    assert {key: row["settings"] for key, row in rows.items() if key[1] == "fixed_gap"} == {
        ("a", "fixed_gap"): "gap=5", ("b", "fixed_gap"): "gap=2"
    }  # fmt: skip
    assert all(row["seeds"] == 6 for row in rows.values())
    assert {run.record["seed"] for method in chosen for run in method.runs} == set(range(6))
    assert rows["a", "fixed_gap"][MM] == 11.5  # the median of 9 to 14
    assert rows["a", "fixed_gap"]["chosen_on"] == "seed=6,7"
    assert rows["a", "previous"]["chosen_on"] == ""


def test_one_place_chooses_for_the_others(seeds: Path) -> None:
    runs = stored.find_runs([seeds])
    for key in ("dataset.environment", "environment"):
        chosen = held_out.choose_on(runs, key, ["a"])
        assert {m.row["data"][-1] for m in chosen} == {"b"}
        (row,) = (m.row for m in chosen if m.row["selector"] == "fixed_gap")
        # in a on all eight seeds: gap 2 is better on six of them
        assert (row["settings"], row["seeds"], row["chosen_on"]) == ("gap=2", 8, f"{key}=a")


def test_a_missing_seed_counts_as_failed(tmp_path: Path) -> None:
    make_seeds(tmp_path / "2", "fixed_gap", [5.0, 1.0], gap=2)
    make_seeds(tmp_path / "5", "fixed_gap", [5.0, 2.0, 2.0], gap=5)
    (method,) = held_out.choose_on(stored.find_runs([tmp_path]), "seed", ["1", "2"])
    assert method.row["settings"] == "gap=5"


@pytest.mark.parametrize(
    ("word", "why"),
    [
        ("seed", "--choose-on seed: expected KEY=VALUES"),
        ("seed=", "expected KEY=VALUES"),
        ("=3", "expected KEY=VALUES"),
        ("seed=6,8", "no run has seed=8; known: 0, 1, 2, 3, 4, 5, 6, 7"),
        ("colour=red", "none of these runs has a colour"),
        ("environment=a,b", "all runs have it, none is left"),
    ],
)
def test_mistakes_are_named(seeds: Path, word: str, why: str) -> None:
    with pytest.raises(ConfigError) as caught:
        held_out.choose_on(stored.find_runs([seeds]), *held_out.parse(word))
    assert why in str(caught.value)


# --- compared and pooled


def test_held_out_rows_are_paired(seeds: Path) -> None:
    runs = stored.find_runs([seeds])
    chosen = held_out.choose_on(runs, "seed", ["6", "7"])
    table = paired.against(runs, "previous", methods=chosen)
    assert len(table) == 2 and set(table["difference"]) == {-1.0}  # 9 + s minus 10 + s
    assert set(table["difference_n"]) == {6} and set(table["p"]) == {2 / 64}
    assert set(table["chosen_on"]) == {"seed=6,7"} and set(table["tried"]) == {2}
    by_backend = {
        backend: held_out.choose_on(runs, "seed", ["6", "7"]) for backend in ("p2p", "gicp")
    }
    for method in by_backend["gicp"]:
        method.row["backend"] = "gicp"
    both = [*by_backend["p2p"], *by_backend["gicp"]]
    table = paired.against(runs, "backend=gicp", methods=both)
    assert set(table["difference"]) == {0.0}  # whatever settings each has


def test_pooled_over_places_whatever_their_settings(seeds: Path) -> None:
    runs = stored.find_runs([seeds])
    chosen = held_out.pooled(held_out.choose_on(runs, "seed", ["6", "7"]))
    rows = {m.row["selector"]: m.row for m in chosen}
    assert rows["fixed_gap"]["data"] == "corridor (2 pooled)"
    assert (rows["fixed_gap"]["settings"], rows["fixed_gap"]["seeds"]) == ("", 12)
    table = paired.against(runs, "previous", methods=chosen)
    assert list(table["difference_n"]) == [12] and list(table["difference"]) == [-1.0]
    assert list(table["holds"]) == ["better"]
    table = with_intervals.interval_table(runs, methods=chosen)
    assert set(table[f"{MM}_n"]) == {12} and set(table["rank"]) == {1.0, 2.0}


# --- what is shown


def test_tries_are_noted(tmp_path: Path) -> None:
    make_places(tmp_path, "fixed_gap", {g: dict.fromkeys("ab", 1.0 * g) for g in (2, 5)})
    make_places(tmp_path, "previous", {None: dict.fromkeys("ab", 7.0)})
    chosen = held_out.leave_one_out(stored.find_runs([tmp_path]))
    rule, tries = held_out.choice_notes(chosen)
    assert "least mean logarithm of the main error" in rule and "failed run" in rule
    assert tries == "fixed_gap had 2 settings to choose from, previous 1: not an equal chance"
    table = held_out.chosen_table(chosen)
    assert list(table["selector"]) == ["fixed_gap", "previous"] * 2  # by error
    names, main = held_out.chosen_columns(table)
    assert names[-2:] == ["tried", "chosen_on"] and main == [MM]


@pytest.mark.parametrize("fmt", ["text", "csv", "md", "latex", "html", "json"])
def test_the_command_line_shows_it_in_every_format(seeds: Path, capsys: Any, fmt: str) -> None:
    out, err = shown(capsys, str(seeds), "--choose-on", "seed=6,7", "-f", fmt)
    assert "tried" in out and "seed=6,7" in out.replace("\\", "")
    assert "mean logarithm" in (out if fmt == "text" else err)
    if fmt == "latex":
        head, *rows = check_latex(out.rstrip("\n"))
        assert head[-1] == r"chosen\_on" and len(rows) == 4
    if fmt == "json":
        rows = json.loads(out)
        assert sorted(row["settings"] or "" for row in rows) == ["", "", "gap=2", "gap=5"]


def test_the_command_line_combines_it(seeds: Path, capsys: Any) -> None:
    words = [str(seeds), "--held-out"]
    out, _ = shown(capsys, *words, "-f", "csv", "--columns", "selector,settings,tried,chosen_on")
    assert out.splitlines()[0] == "selector,settings,tried,chosen_on" and len(out.splitlines()) == 5
    # on the eight seeds of a gap 2 has the smaller logarithms, on those of b gap 5
    assert "fixed_gap,gap=2,2,environment=a" in out and "fixed_gap,gap=5,2,environment=b" in out
    out, _ = shown(capsys, str(seeds), "--choose-on", "seed=6,7", "--against", "previous")
    assert "-1 [-1, -1] (6)" in out and "mean logarithm" in out
    out, _ = shown(capsys, str(seeds), "--choose-on", "seed=6,7", "--against", "previous", "--pool")
    assert "-1 [-1, -1] (12)" in out
    out, _ = shown(capsys, str(seeds), "--choose-on", "seed=6,7", "--intervals")
    assert "11.5 [" in out and "tried" in out


def test_relations_of_a_log_keep_their_clusters(tmp_path: Path) -> None:
    for log in ("a", "b"):
        data = {"path": f"{log}.clf"}
        more: dict[str, Any] = {"data": data, "fingerprint": log}
        make_log(tmp_path / f"{log}p", "previous", [2, 3, 4, 5, 6, 7], **more)
        for gap, errors in ((2, [1, 2, 3, 4, 5, 6]), (5, [9] * 6)):
            make_log(tmp_path / f"{log}{gap}", "fixed_gap", errors, gap=gap, **more)
    runs = stored.find_runs([tmp_path])
    chosen = held_out.leave_one_out(runs)
    assert {m.row["settings"] for m in chosen} == {"", "gap=2"}
    table = paired.against(runs, "previous", methods=chosen)
    assert set(table["unit"]) == {"clusters"} and set(table["difference"]) == {-0.5}
    assert math.isnan(table["p"].iloc[0])


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--held-out", "--best"], "--held-out: goes with"),
        (["--choose-on", "seed=1", "--over-seeds"], "--choose-on: goes with"),
        (["--choose-on", "seed"], "expected KEY=VALUES"),
    ],
)
def test_mistakes_on_the_command_line(seeds: Path, words: list[str], why: str, capsys: Any) -> None:
    from rbtm_bench.cli.commands import main

    assert main(["table", str(seeds), *words]) == 2
    error = capsys.readouterr().err
    assert why in error and len(error.splitlines()) == 1


def test_the_data_shown_cannot_choose(tmp_path: Path) -> None:
    for seed in (0, 1):  # a log has no seeds: the same data twice
        make_run(tmp_path / f"r{seed}", "random_gap", {MM: 1.0}, seed=seed, fingerprint="log")
    runs = stored.find_runs([tmp_path])
    with pytest.raises(
        ConfigError, match=r"chosen on the very data of r0.*seed does not change the data"
    ):
        held_out.choose_on(runs, "seed", ["1"])
