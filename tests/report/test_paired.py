"""Paired differences: every number worked out by hand from run folders written by the tests."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stat_helpers import LONG, MEAN, MM, check_latex, make_log, make_run, make_seeds, shown

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import paired
from rbtm_bench.runs import stored

REFERENCE = [10, 20, 30, 40, 50, 60]
LESS = [7, 19, 24, 38, 45, 56]
"""Less by 3 1 6 2 5 4: the values of test_statistics."""


def rows_of(folder: Path, reference: str, **options: Any) -> list[dict[str, Any]]:
    table = paired.against(stored.find_runs([folder]), reference, **options)
    return table.astype(object).where(table.notna(), None).to_dict(orient="records")


def difference(row: dict[str, Any]) -> tuple[Any, ...]:
    return tuple(row[f"difference{end}"] for end in ("", "_low", "_high", "_n"))


# --- what a difference is called


def test_differences_on_the_same_seeds(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", REFERENCE)
    make_seeds(tmp_path, "rbtm", LESS, window=4)
    (row,) = rows_of(tmp_path, "previous")
    assert difference(row) == (-3.5, -5.5, -1.5, 6)
    assert (row["error"], row["reference_error"]) == (31.0, 35.0)
    assert (row["selector"], row["reference"], row["metric"]) == ("rbtm", "previous", MM)
    assert (row["p"], row["p_holm"], row["unit"]) == (2 / 64, 2 / 64, "data sets")
    assert row["holds"] == "better"
    (row,) = rows_of(tmp_path, "selector=rbtm")
    assert difference(row) == (3.5, 1.5, 5.5, 6) and row["holds"] == "worse"
    assert row["reference"] == "rbtm window=4"


def test_two_comparisons_are_two_chances(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", REFERENCE)
    make_seeds(tmp_path, "rbtm", LESS, window=4)
    make_seeds(tmp_path, "oldest", LESS, window=4)
    for row in rows_of(tmp_path, "previous"):
        assert (row["p"], row["p_holm"], row["holds"]) == (2 / 64, 4 / 64, "")
    (row, _) = rows_of(tmp_path, "previous", metrics=[MM])
    assert row["difference_high"] < 0  # the interval alone does not do


def test_with_five_data_sets_nothing_is_called_better(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", REFERENCE[:5])
    make_seeds(tmp_path, "rbtm", [1, 1, 1, 1, 1], window=4)
    (row,) = rows_of(tmp_path, "previous")
    assert (row["p"], row["p_holm"], row["holds"]) == (None, None, "")
    assert difference(row) == (-29.0, -49.0, -9.0, 5)
    lines = paired.difference_notes(paired.against(stored.find_runs([tmp_path]), "previous"))
    assert lines[1] == (
        "no test, and nothing called better, on fewer than 6 independent data sets (a log is one)"
    )


def test_only_shared_seeds_count(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [*REFERENCE, 1000, 2000])
    make_seeds(tmp_path, "rbtm", LESS, window=4)
    (row,) = rows_of(tmp_path, "previous")
    assert difference(row) == (-3.5, -5.5, -1.5, 6) and row["reference_error"] == 35.0


def test_data_without_the_reference_stay_in_the_table(tmp_path: Path) -> None:
    for place, selectors in (("paper", ("previous", "rbtm")), ("bare", ("rbtm", "oldest"))):
        for selector in selectors:
            data = {"environment": place}
            make_seeds(tmp_path / place, selector, REFERENCE, data=data, window=4)
    rows = rows_of(tmp_path, "previous")
    by_method = {(row["data"][-5:], row["selector"]): row for row in rows}
    assert set(by_method) == {("paper", "rbtm"), ("=bare", "rbtm"), ("=bare", "oldest")}
    assert (
        by_method["=bare", "rbtm"]["difference"] is None
        and by_method["=bare", "rbtm"]["holds"] == ""
    )
    table = paired.against(stored.find_runs([tmp_path]), "previous")
    assert (
        "no difference where the reference, or a number of it, is missing"
        in paired.difference_notes(table)
    )
    make_seeds(tmp_path / "x", "keyframe", [1.0], data={"environment": "hall"})
    with pytest.raises(ConfigError, match="no other method has a number on the same data"):
        rows_of(tmp_path, "keyframe")


def test_seeds_that_change_nothing_are_one_data_set(tmp_path: Path) -> None:
    """A simulation without noise gives the same numbers for every seed: no proof of anything."""
    for seed in range(20):
        for selector, error in (("previous", 9.0), ("rbtm", 1.0)):
            metrics = {MM: error, "mean_fitness": 0.9, "ms_per_scan": 1.0 + 0.1 * seed}
            place = tmp_path / f"{selector}{seed}"
            make_run(place, selector, metrics, seed=seed, fingerprint=str(seed))
    (row,) = rows_of(tmp_path, "previous")
    assert difference(row) == (-8.0, None, None, 1) and (row["p"], row["holds"]) == (None, "")
    for seed in range(20, 26):  # other results: other data
        fitness = {"mean_fitness": 0.8 + 0.001 * seed}
        for selector, error in (("previous", 9.0), ("rbtm", 1.0)):
            place = tmp_path / f"{selector}{seed}"
            make_run(place, selector, {MM: error} | fitness, seed=seed, fingerprint=str(seed))
    (row,) = rows_of(tmp_path, "previous")
    assert difference(row) == (-8.0, -8.0, -8.0, 7) and row["holds"] == "better"


def test_who_failed_on_a_seed_is_not_called_better(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", [*REFERENCE, 70])
    make_seeds(tmp_path, "rbtm", [*LESS, None], window=4)
    (row,) = rows_of(tmp_path, "previous")
    assert (row["p_holm"], row["holds"], row["status"]) == (2 / 64, "", "6 of 7 done")
    table = paired.against(stored.find_runs([tmp_path]), "previous")
    assert "a run failed is not called better" in paired.difference_notes(table)[-1]
    (row,) = rows_of(tmp_path, "rbtm")  # nor does the other lose by it
    assert row["holds"] == ""
    worse = tmp_path / "worse"
    make_seeds(worse, "previous", [*REFERENCE, 70])
    make_seeds(worse, "rbtm", [*(100 + e for e in LESS), None], window=4)
    (row,) = rows_of(worse, "previous")
    assert row["holds"] == "worse"  # all the more so


def test_rounding_is_no_difference(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", REFERENCE)
    make_seeds(tmp_path, "rbtm", [e * (1 - 1e-12) for e in REFERENCE], window=4)
    (row,) = rows_of(tmp_path, "previous")
    assert difference(row) == (0.0, 0.0, 0.0, 6)
    assert (row["p"], row["holds"]) == (None, "")


def test_what_is_no_error_is_lower_or_higher(tmp_path: Path) -> None:
    make_seeds(tmp_path, "previous", REFERENCE)
    make_seeds(tmp_path, "rbtm", LESS, window=4)
    (row,) = rows_of(tmp_path, "previous", metrics=["mean_gap"])
    assert row["holds"] == "lower"


def test_maps_alone_decide_nothing(tmp_path: Path) -> None:
    for selector in ("previous", "rbtm"):
        make_run(tmp_path / selector, selector, {"map_cells": 5, "map_cells_truth": 7})
    with pytest.raises(ConfigError, match="--metric map_cells: no comparison by it"):
        rows_of(tmp_path, "previous", metrics=["map_cells"])


# --- relations and pooled data


def test_relations_of_one_log_are_paired_by_cluster(tmp_path: Path) -> None:
    make_log(tmp_path / "a", "previous", [2, 3, 4, 5, 6, 7])
    make_log(tmp_path / "b", "rbtm", [2, 2, 4, 4, 6, 6], window=4)  # less by 0 1 0 1 0 1
    (row,) = rows_of(tmp_path, "previous", metrics=[LONG])
    assert difference(row) == pytest.approx((-0.5, -5 / 6, -1 / 6, 6))
    assert (row["unit"], row["p"], row["holds"]) == ("clusters", None, "")
    assert (row["error"], row["reference_error"]) == (4.0, 4.5)
    (row,) = rows_of(tmp_path, "previous")
    assert row["metric"] == MEAN and difference(row)[0] == -0.25 and difference(row)[3] == 12


def test_relations_that_only_one_has_used_are_left_out(tmp_path: Path) -> None:
    make_log(tmp_path / "a", "previous", [2, 3, 4, 5, 1000])
    make_log(tmp_path / "b", "rbtm", [1, 2, 3, 4, np.nan], window=4)
    (row,) = rows_of(tmp_path, "previous", metrics=[LONG])
    assert difference(row) == (-1.0, -1.0, -1.0, 4) and row["reference_error"] == 3.5


def test_six_logs_can_be_tested_pooled(tmp_path: Path) -> None:
    for i in range(6):
        log = {"data": {"path": f"{i}.clf"}, "fingerprint": f"log {i}"}
        make_log(tmp_path / f"a{i}", "previous", [10.0 + i] * 4, **log)
        make_log(tmp_path / f"b{i}", "rbtm", [10.0] * 4, window=4, **log)
    assert {row["holds"] for row in rows_of(tmp_path, "previous", metrics=[LONG])} == {""}
    (row,) = rows_of(tmp_path, "previous", metrics=[LONG], pool=True)
    # differences 0 to -5: the 0 is dropped, 2 of 32
    assert (row["p"], row["difference"], row["unit"]) == (2 / 32, -2.5, "data sets")
    assert row["data"] == "carmen (6 pooled)"


# --- the reference


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """Two backends, four methods, of which two are one selector."""
    for backend in ("none", "p2p"):
        make_seeds(tmp_path, "previous", REFERENCE, backend=backend)
        make_seeds(tmp_path, "rbtm", LESS, backend=backend, window=4, threshold=0.5)
        for distance in (0.1, 0.3):
            name = f"keyframe{distance}"
            make_seeds(tmp_path, "keyframe", LESS, name, backend=backend, distance=distance)
    return tmp_path


def pairs_of(folder: Path, reference: str) -> list[tuple[Any, ...]]:
    rows = rows_of(folder, reference)
    return [(row["backend"], row["selector"], row["reference"]) for row in rows]


def test_a_selector_is_compared_within_every_backend(sweep: Path) -> None:
    others = ["keyframe", "keyframe", "rbtm"]
    expected = [(b, s, "previous") for b in ("none", "p2p") for s in others]
    for reference in ("previous", "selector=previous", " previous,"):
        assert sorted(pairs_of(sweep, reference.strip(" ,"))) == expected


def test_a_backend_is_compared_within_every_selector_and_setting(sweep: Path) -> None:
    for reference in ("none", "backend=none"):
        pairs = pairs_of(sweep, reference)
        assert sorted(pairs) == [
            ("p2p", s, "none") for s in ("keyframe", "keyframe", "previous", "rbtm")
        ]
    for row in rows_of(sweep, "none"):
        assert row["difference"] == 0.0  # each with its own settings


def test_one_method_for_all(sweep: Path) -> None:
    pairs = pairs_of(sweep, "backend=none,selector=previous")
    assert len(pairs) == 7 and {reference for _, _, reference in pairs} == {"none previous"}


def test_settings_make_a_reference_one_method(sweep: Path) -> None:
    for words in ("keyframe distance=0.3", "keyframe selector.distance=0.3"):
        rows = rows_of(sweep, words)
        assert {row["reference"] for row in rows} == {"keyframe distance=0.3"} and len(rows) == 6
    assert len(rows_of(sweep, "rbtm window=4.0 threshold=0.5")) == 6


@pytest.mark.parametrize(
    ("reference", "why"),
    [
        ("nix", "no selector nix in these runs; known selectors: keyframe, previous, rbtm"),
        ("backend=nix", "no backend nix in these runs; known backends: none, p2p"),
        ("keyframe", "several methods on corridor, name one: none keyframe distance=0.1; none"),
        ("distance=0.3", "expected a selector or a backend"),
        ("rbtm window=5", "none of these methods is that"),
    ],
)
def test_references_that_are_none(sweep: Path, reference: str, why: str) -> None:
    with pytest.raises(ConfigError) as caught:
        rows_of(sweep, reference)
    assert str(caught.value).startswith(f"--against {reference}: {why}")


# --- what is shown


def test_the_command_line_shows_it_in_every_format(tmp_path: Path, capsys: Any) -> None:
    make_seeds(tmp_path, "previous", REFERENCE)
    make_seeds(tmp_path, "rbtm", LESS, window=4)
    words = [str(tmp_path), "--against", "selector=previous"]
    out, err = shown(capsys, *words)
    assert "-3.5 [-5.5, -1.5] (6)" in out and "better" in out and err == ""
    assert "adjusted for 1 test;" in out
    out, err = shown(capsys, *words, "-f", "latex")
    (head, row) = check_latex(out.rstrip("\n"))
    assert r"p\_holm" in head and row[head.index("holds")] == "better"
    assert "Wilcoxon signed-rank" in err
    (record,) = csv.DictReader(io.StringIO(shown(capsys, *words, "-f", "csv")[0]))
    assert (record["p_holm"], record["difference_low"], record["holds"]) == (
        "0.03125", "-5.5", "better"
    )  # fmt: skip
    for fmt in ("md", "html", "json"):
        assert "better" in shown(capsys, *words, "-f", fmt)[0]
    out, _ = shown(capsys, *words, "--columns", "selector,holds")
    assert "p_holm" not in out.splitlines()[0] and "better" in out
