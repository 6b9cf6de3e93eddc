"""The pivot of a paper's table: what stands in its cells, what is marked, what is said."""

from __future__ import annotations

from pathlib import Path

import pytest
from stat_helpers import MM, make_log, make_replicates, make_run, shown

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.report import frame, typeset
from rbtm_bench.report.names import Names
from rbtm_bench.report.pivot import Pivot, pivot
from rbtm_bench.runs.stored import find_runs

NEAR = [1.0 + 0.01 * i for i in range(12)]
"""Twelve errors of a method about 1 mm."""


def made(folder: Path, rows: str = "backend", columns: str = "selector", *keys: str) -> Pivot:
    return pivot(frame.methods(find_runs([folder])), rows, columns, keys, Names.read())


@pytest.fixture
def compared(tmp_path: Path) -> Path:
    """Two strategies about 1 mm, one ten times worse, two settings of keyframe, one failed."""
    make_replicates(tmp_path, "rbtm", NEAR, window=8, threshold=0.7)
    make_replicates(tmp_path, "previous", [10 * e for e in NEAR])
    make_replicates(tmp_path, "keyframe", [1.1 * e for e in reversed(NEAR)], distance=0.3)
    make_replicates(tmp_path, "keyframe", [3 * e for e in NEAR], name="far", distance=0.9)
    make_replicates(tmp_path, "oldest", [None] * 12)
    return tmp_path


def test_the_best_and_what_is_not_told_apart(compared: Path) -> None:
    table = made(compared)
    cells = {column: cell for (_, column), cell in table.blocks[0].cells.items()}
    assert [name for name, cell in cells.items() if cell.best] == ["rbtm"]
    assert [name for name, cell in cells.items() if cell.tied] == ["keyframe"]
    assert cells["keyframe"].settings == 2
    assert cells["keyframe"].value == pytest.approx(1.1 * 1.055)
    assert cells["oldest"].value is None
    assert cells["rbtm"].quartiles == pytest.approx((1.0275, 1.0825))


def test_the_order_is_that_of_the_names_file(
    compared: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert made(compared).values("selector") == ["previous", "keyframe", "oldest", "rbtm"]
    own = tmp_path / "own.yaml"
    own.write_text("selector:\n  rbtm: Ours\n  oldest: '100% | <b>'\n")
    words, _ = shown(capsys, str(compared), "--paper", "--names", str(own), "-f", "md")
    assert words.splitlines()[2] == "| Backend | Ours | 100% \\| &lt;b&gt; | Previous | Keyframe |"


def test_the_caption_says_data_replicates_settings_and_test(compared: Path) -> None:
    words = typeset.caption(made(compared), spread=True)
    assert words == (
        "Final position error on Corridor: median over 12 perturbed copies of the data [quartiles]."
        " In 1 of 4 cells the best of 2 settings on these data. Bold: lowest; \N{DAGGER}: not"
        " told apart from it (exact paired test over replicates, Holm over 3 comparisons, p < 0.05,"
        " and medians more than 2 times apart)."
    )


def test_one_run_each_proves_nothing(tmp_path: Path) -> None:
    for selector, error in (("rbtm", 5.0), ("previous", 5.1)):
        make_run(tmp_path / selector, selector, {MM: error})
    table = made(tmp_path)
    assert not any(cell.tied for cell in table.cells)
    words = typeset.caption(table, spread=True)
    assert words.endswith("one run each. Bold: lowest; without replicates no difference is tested.")


def test_data_sets_with_errors_of_their_own_are_blocks_with_units(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_run(tmp_path / "a", "rbtm", {MM: 5.0})
    make_run(tmp_path / "b", "previous", {MM: 1234.5})
    make_log(tmp_path / "c", "rbtm", [0.5, 0.7])
    words, _ = shown(capsys, str(tmp_path), "--paper", "-f", "md")
    assert "| *Corridor: Final position error (mm)* |" in words
    assert "| *a: Mean relation error (m)* |" in words
    assert "1234" in words and "| \N{EN DASH} | **0.550** |" in words


def test_metrics_beside_each_other_are_of_one_method(tmp_path: Path) -> None:
    """The best by the first metric, whose time is not the least of its settings."""
    make_run(tmp_path / "a", "keyframe", {MM: 5.0, "ms_per_scan": 9.0}, distance=0.3)
    make_run(tmp_path / "b", "keyframe", {MM: 6.0, "ms_per_scan": 1.0}, distance=0.5)
    table = made(tmp_path, "selector", "metric", MM, "ms_per_scan")
    assert [cell.value for cell in table.cells] == [5.0, 9.0]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["--rows", "selector"], "two different axes"),
        (["--metric", f"{MM},mean_gap"], "metric for several metrics"),
        (["--rows", "nosuch"], "nosuch: no axis; expected a group"),
        (["--rows", "selector.nosuch"], "selector.nosuch: no axis"),
        (["-f", "csv"], "--format csv: does not go with --paper"),
        (["--best"], "--best: does not go with --paper"),
        (["--metric", "nosuch"], "none of these runs has a number of that name"),
    ],
)
def test_what_cannot_be_a_table_is_one_line(
    words: list[str], expected: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    make_run(tmp_path / "a", "rbtm", {MM: 5.0, "mean_gap": 2.0}, window=3)
    assert main(["table", str(tmp_path), "--paper", *words]) == 2
    told = capsys.readouterr().err
    assert expected in told and told.count("\n") == 1


def test_a_names_file_with_a_group_that_is_none(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("backends:\n  plicp: X\n")
    with pytest.raises(ConfigError, match="backends: no such group"):
        Names.read(own)
    own.write_text("backend:\n  plicp: [1]\n")
    with pytest.raises(ConfigError, match="backend: expected names as text"):
        Names.read(own)


def test_names_are_of_members_that_exist() -> None:
    from rbtm_bench.runs.settings import members

    for group, names in Names.read().groups.items():
        if group not in ("data", "setting", "axis", "metric"):
            assert set(names) - {"none"} <= set(members(group)), group


@pytest.mark.parametrize(
    ("value", "text"),
    [(3.649, "3.65"), (39.0, "39.0"), (999.7, "1000"), (1710.2, "1710"), (0.04567, "0.0457"),
     (0.0, "0"), (9.996, "10.0"), (1.2e-6, "1.20e-06")],
)  # fmt: skip
def test_three_significant_digits(value: float, text: str) -> None:
    assert typeset.number(value) == text


def test_html_escapes_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make_run(tmp_path / "a", "<script>alert(1)</script>", {MM: 5.0})
    words, _ = shown(capsys, str(tmp_path), "--paper", "-f", "html")
    assert "<script" not in words and "&lt;script&gt;" in words
