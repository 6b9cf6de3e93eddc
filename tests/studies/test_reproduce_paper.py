"""scripts/reproduce_paper.py end to end, very small, and the pieces that its numbers hang on."""

from __future__ import annotations

import contextlib
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from rbtm_bench.datasets.environments import PAPER
from rbtm_bench.plots import paper, ratios, style
from rbtm_bench.runs.stored import Run
from rbtm_bench.studies.paper import command, findings, plan, tables

BACKENDS = ("open3d_p2p", "ndt_2d")
WORDS = ("--quick", "--seeds", "1", "--scans", "19", "--backends", ",".join(BACKENDS))
FIGURES = ("fig1b", "fig1c", "fig2", "fig3", "fig4a", "fig4b", "fig_ratio")


def call(out: Path, *words: str) -> tuple[int, str]:
    """Exit code and standard output."""
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        code = command.main([*WORDS, "--out", str(out), *words])
    return code, text.getvalue()


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder, and what was printed."""
    out = tmp_path_factory.mktemp("paper")
    code, text = call(out)
    assert code == 0, text
    return out, text


def test_files_are_there(made: tuple[Path, str]) -> None:
    out, _ = made
    names = ["README.md", "table1.md", "table1.csv", "choices.csv", "ratio.csv"]
    names += ["open_settings.csv", *(f"{stem}.{e}" for stem in FIGURES for e in ("png", "pdf"))]
    for name in names:
        assert (out / name).stat().st_size > 100, name
    assert (out / "fig4a.png").read_bytes()[:4] == b"\x89PNG"
    assert (out / "fig4a.pdf").read_bytes()[:4] == b"%PDF"
    assert not (out / "runs" / "pairs").exists()


def test_table_has_every_method_of_every_backend(made: tuple[Path, str]) -> None:
    table = pd.read_csv(made[0] / "table1.csv")
    ways = plan.make_ways(19)
    assert len(table) == len(BACKENDS) * len(ways)
    assert set(table["way"]) == set(ways)
    for backend in BACKENDS:
        assert set(table[table["backend"] == backend]["way"]) == set(ways)
    assert (table["runs"] == 1).all() and (table["failed"] == 0).all()
    numbers = table[["median_error_mm", "along_mm", "cross_mm", "heading_deg"]]
    assert np.isfinite(numbers).all(axis=None)
    parts = np.hypot(table["along_mm"], table["cross_mm"])
    assert np.allclose(parts, table["median_error_mm"])  # of a single seed
    assert (table[table["way"].str.startswith("standard")]["standard_over_this"] == 1).all()


def test_settings_were_chosen_on_other_data_than_shown(made: tuple[Path, str]) -> None:
    """By what the runs say of themselves, not by what the table claims."""
    data: dict[bool, set[str]] = {True: set(), False: set()}
    for file in (made[0] / "runs").glob("*/run.json"):
        record = json.loads(file.read_text())
        if file.parent.name.startswith(("ratio", "open", "figure")):
            continue
        which = int(file.parent.name.rpartition("-")[2])
        data[which >= 100 and which not in plan.SHOWN_BEAMS].add(record["dataset_fingerprint"])
    assert len(data[True]) == len(data[False]) == 2  # a seed and a sensor each
    assert not data[True] & data[False]


def test_every_method_had_equally_many_tries(made: tuple[Path, str]) -> None:
    choices = pd.read_csv(made[0] / "choices.csv")
    counts = choices.groupby(["way", "backend"]).agg(
        tries=("setting", "nunique"), chosen=("chosen", "sum"), runs=("runs", "min")
    )
    assert (counts["tries"] == 4).all() and (counts["chosen"] == 1).all()
    assert (counts["runs"] == 1).all()
    assert (pd.read_csv(made[0] / "table1.csv")["tried"] == 4).all()


def test_the_smallest_error_was_chosen_and_is_shown(made: tuple[Path, str]) -> None:
    choices = pd.read_csv(made[0] / "choices.csv")
    table = pd.read_csv(made[0] / "table1.csv").set_index(["way", "backend"])
    for key, tried in choices.groupby(["way", "backend"]):
        won = tried[tried["chosen"]].iloc[0]
        assert won["median_error_mm"] == tried["median_error_mm"].min()
        assert table.loc[key, "setting"] == won["setting"]


def test_random_gap_draws_the_gaps_of_rbtm_on_the_same_seed(made: tuple[Path, str]) -> None:
    for seed, count in ((0, 1), (100, 4)):
        folders = list((made[0] / "runs").glob(f"random_gap-*-open3d_p2p-{seed}"))
        assert len(folders) == count
        for folder in folders:
            run = tables.read_run(folder)
            source = Path(run.config["selector"]["gaps_from"]).name
            assert source == folder.name.replace("random_gap", "circular")
            assert run.config["selector"]["seed"] == run.config["dataset"]["seed"] == seed


def test_table_is_printed_last_a_method_a_line(made: tuple[Path, str]) -> None:
    ways = plan.make_ways(19)
    lines = made[1].rstrip().splitlines()[-len(ways) :]
    table = pd.read_csv(made[0] / "table1.csv").set_index(["way", "backend"])
    for line, way in zip(lines, ways.values(), strict=True):
        row = table.loc[(way.key, "open3d_p2p")]
        head = f"{way.name} {row['brief']} {tables.number(row['median_error_mm'])} "
        assert " ".join(line.split()).startswith(head)


def test_a_terminal_of_100_columns_is_enough(made: tuple[Path, str]) -> None:
    start = made[1].index("The same of the other backends")
    lines = made[1][start:].splitlines()
    assert any(line.startswith("ndt_2d") for line in lines)
    assert max(map(len, lines)) <= 100
    full = plan.make_ways(361)
    widest = max(len(way.name) for way in full.values())
    assert widest + max(len(way.brief(k)) for way in full.values() for k in range(4)) < 50


def test_readme_says_what_is_open_and_whether_the_descriptor_fires(made: tuple[Path, str]) -> None:
    text = (made[0] / "README.md").read_text()
    for word in ("sensor", "number of scans", "window", "threshold", "guess", "noise", "ICP"):
        assert any(
            line.startswith(f"| {word}") or f"| {word}" in line for line in text.splitlines()
        )
    table = pd.read_csv(made[0] / "table1.csv").set_index(["way", "backend"])
    fired = int(table.loc[("literal", "open3d_p2p"), "fired"])
    assert f"that of {fired} of 18: " in text  # the first of 19 scans has no model scan
    assert ("it never fires**" in text) is (fired == 0)
    assert "nan" not in text.replace("dominan", "")


@pytest.mark.slow
def test_a_second_call_makes_nothing_anew(made: tuple[Path, str]) -> None:
    out, _ = made
    before = (out / "table1.csv").read_bytes()
    changed = (out / "runs" / "standard-1-open3d_p2p-100" / "run.json").stat().st_mtime_ns
    (out / "runs" / "circular-1-ndt_2d-100" / "run.json").unlink()  # as if cut at it
    code, text = call(out)
    assert code == 0 and "1 runs made" in text
    assert (out / "table1.csv").read_bytes() == before
    assert (out / "runs" / "standard-1-open3d_p2p-100" / "run.json").stat().st_mtime_ns == changed


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--backends", "psm"), "must hold open3d_p2p"),
        (("--backends", "open3d_p2p,nonsense"), "nonsense"),
        (("--seeds", "0"), "expected 1 to 100"),
        (("--seeds", "101"), "later ones choose"),
        (("--scans", "5"), "at least 10"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command.main([*words, "--out", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert message in error and len(error.splitlines()) == 1


def test_seeds_that_choose_are_never_shown() -> None:
    for size in (plan.FULL, plan.QUICK):
        for noise in (0.0, 10.0):
            (key, choosing), (same, shown) = (size.replicates(noise, c) for c in (True, False))
            assert key == same and not set(choosing) & set(shown)
    assert len(plan.FULL.replicates(10.0, False)[1]) == 20
    assert plan.FULL.replicates(0.0, True)[0] == "dataset.beams"


@pytest.mark.parametrize("scans", [3, 19, 37, 181, 361])
def test_tries_differ_whatever_the_number_of_scans(scans: int) -> None:
    for way in plan.make_ways(scans).values():
        assert len(set(way.values)) == 4, way.key
        assert len({way.setting(k) for k in range(4)}) == 4
    assert plan.make_ways(181)["circular"].setting(0) == "window 64, threshold 0.5"
    assert plan.make_ways(181)["fixed_gap"].values == (5, 10, 20, 40)  # 1 cm a scan
    assert plan.make_ways(361)["oldest"].values == (16, 32, 64, 128)


def run_of(name: str, error: float, **metrics: Any) -> Run:
    values = {tables.ERROR: error, "fallbacks": 0, **metrics}
    return Run(Path(name), {"status": "done", "scans": 11}, {}, values)


def test_ratio_is_the_median_of_what_a_seed_gives() -> None:
    above = [run_of(f"a-{k}", e) for k, e in enumerate((10.0, 40.0, 90.0, 5.0))]
    below = [run_of(f"b-{k}", e) for k, e in ((2, 30.0), (0, 5.0), (1, 10.0), (9, 1.0))]
    ratio = tables.ratio_of(above, below)
    assert ratio is not None and ratio.n == 3  # seed 9 has no partner, seed 3 neither
    assert ratio.value == 3.0  # of 2, 4 and 3
    assert tables.ratio_of(above, [run_of("b-9", 1.0)]) is None


def test_fired_counts_scans_without_fallback() -> None:
    runs = [run_of("a-0", 1.0, fallbacks=10), run_of("a-1", 1.0, fallbacks=7)]
    assert tables.fired(runs) == {"fired": 3, "scans": 20}


def table_of(medians: dict[str, float], p: dict[str, float]) -> pd.DataFrame:
    rows = [
        {"backend": "b", "way": w, "median_error_mm": e, "p_holm": p.get(w)}
        for w, e in medians.items()
    ]
    return pd.DataFrame(rows)


def test_better_and_worse_only_where_the_test_holds() -> None:
    medians = {"circular": 5.0, "fixed_gap": 9.0, "keyframe": 1.0, "oldest": 8.0, "random_gap": 2.0}
    table = table_of(medians, {"fixed_gap": 0.01, "keyframe": 0.04, "oldest": 0.2})
    verdicts = tables.against_controls(table).set_index("control")["verdict"]
    assert verdicts.to_dict() == {
        "fixed_gap": "better", "keyframe": "worse", "oldest": "", "random_gap": ""
    }  # fmt: skip
    (row,) = tables.by_backend(table).to_dict("records")
    assert list(row.values()) == ["b", "5", "9 (+)", "1 (-)", "8", "2"]
    words = findings.against_the_controls(table)
    assert "fixed gap at 1 (shown better at 1, shown worse at 0)" in words
    assert "random gap at 0 (shown better at 0, shown worse at 0)" in words


@pytest.mark.parametrize(
    ("fired", "phrase"),
    [
        (0, "**it never fires**"),
        (3, "**it all but never fires** (1.5%"),
        (150, "it fires on 75.0%"),
    ],
)
def test_the_literal_descriptor_is_judged_by_its_fallbacks(fired: int, phrase: str) -> None:
    choices = pd.DataFrame(
        [
            {"way": way, "backend": "open3d_p2p", "setting": "threshold 0.2", "fired": fired,
             "scans": 200}
            for way in ("literal", "literal_clean")
        ]
    )  # fmt: skip
    row = {"backend": "open3d_p2p", "setting": "threshold 0.2", "fired": fired, "scans": 200,
           "median_error_mm": 500.0, "standard_over_this": 0.5}  # fmt: skip
    table = pd.DataFrame([{**row, "way": way} for way in ("literal", "literal_clean")])
    noisy, clean = findings.literal_fires(choices, table)
    assert phrase in noisy and "2 times larger than the standard way's" in noisy
    assert noisy.startswith("With 10 mm noise") and clean.startswith("Without noise")


def test_numbers_are_written_short() -> None:
    words = [tables.number(v) for v in (1076.3, 7.423, -0.01234, 99.96, math.nan, None)]
    assert words == ["1076", "7.4", "-0.012", "100", "", ""]


@pytest.mark.parametrize(
    ("ratio", "text"),
    [(145.3, "150"), (3.66, "3.7"), (1.04, "1"), (0.96, "1"), (0.5, "1/2"), (0.0597, "1/17")],
)
def test_ratios_below_one_are_written_as_parts(ratio: float, text: str) -> None:
    assert ratios.written(ratio) == text


def test_outline_follows_the_walls_of_fig_3() -> None:
    room = paper.outline(PAPER.walls)
    assert len(room) == len(PAPER.walls) == 28
    x, y = room.T
    area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
    recesses = 2 * 0.6 * 0.3 + 0.6 * 0.4 + 2 * 0.6 * 0.3 + 0.5 * 0.5
    assert area == pytest.approx(6.5 * 2.0 + recesses)
    with pytest.raises(ValueError, match="the walls end at"):
        paper.outline((*PAPER.walls[:-1], ((9.0, 9.0), (9.0, 8.0))))


def test_ratio_picture_marks_worse_cells_and_the_paper(tmp_path: Path) -> None:
    cells = [
        ratios.Ratio(n, mm, d, r)
        for (n, mm, d), r in zip(
            [(19, 0.0, 0.1), (19, 0.0, 0.3), (181, 0.0, 0.1), (19, 10.0, 0.1), (181, 10.0, 0.3)],
            [0.5, 2.0, 200.0, math.nan, 30.0],
            strict=True,
        )
    ]
    with style.paper():
        figure = ratios.draw([("standard / RBTM", cells)], "title", 145.0)
        texts = [text.get_text() for ax in figure.axes for text in ax.texts]
        style.save(figure, tmp_path, "ratio")
    assert sorted(texts) == ["1/2", "2", "200", "30"]
    assert [ax.get_title() for ax in figure.axes[:2]] == ["no noise", "range noise 10 mm"]
    assert {path.name for path in tmp_path.iterdir()} == {"ratio.png", "ratio.pdf"}
