"""``rbtm-bench similarity``: what it writes, draws and refuses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from rbtm_bench.cli.commands import main
from rbtm_bench.plots import scores as pictures
from rbtm_bench.plots import style
from rbtm_bench.similarity.scorematrix import Scores


def test_the_matrix_of_a_corridor(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "m"
    assert main(["similarity", "dataset.scans=25", "--out", str(out)]) == 0
    assert {p.name for p in out.iterdir()} == {
        "similarity.npz", "similarity.png", "similarity.pdf", "settings.yaml",
    }  # fmt: skip
    with np.load(out / "similarity.npz") as read:
        assert read["scores"].shape == (25, 25) and read["scans"].tolist() == list(range(25))
        np.testing.assert_allclose(read["scores"], read["scores"].T, atol=1e-6)
        np.testing.assert_allclose(np.diag(read["scores"]), 1.0, atol=1e-6)
    shown = capsys.readouterr().out
    assert "25 x 25 scores" in shown and "median score by gap: 1: 0." in shown
    assert f"{out}: similarity.npz" in shown
    assert yaml.safe_load((out / "settings.yaml").read_text())["dataset"]["scans"] == 25


def test_the_band_of_a_window(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["similarity", "--band", "selector.window=6", "dataset.scans=25", "similarity=overlap"]
    assert main([*words, f"out={tmp_path / 'b'}"]) == 0
    with np.load(tmp_path / "b" / "similarity.npz") as read:
        assert read["scores"].shape == (25, 5)
        assert np.isnan(read["scores"][0]).all() and np.isfinite(read["scores"][5:]).all()
    shown = capsys.readouterr().out
    assert "band, window 6 of overlap" in shown
    assert "compared under a guess: odometry" in shown


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--memory", "50"], "use --band selector.window=W"),
        (["--memory", "0"], "--memory 0: expected megabytes above 0"),
        (["--band", "selector=previous"], "the selector has no window"),
        (["--band", "--matrix"], "not allowed with"),
        (["backend=kiss_icp_system"], "leave it out"),
        (["dataset.scans=0"], "dataset.scans=0"),
        (["nix"], "nix: expected key=value"),
        (["--nix"], "--nix: no such option"),
        (["similarity=virtual"], "virtual"),
    ],
)
def test_mistakes(
    words: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["similarity", *words, f"out={tmp_path / 'x'}"]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_help_teaches(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["similarity", "--help"]) == 0
    shown = capsys.readouterr().out
    for word in ("--band", "--memory", "float32", "similarity.npz"):
        assert word in shown


def drawn(scores: Scores) -> tuple[str, list[str], tuple[int, ...]]:
    """Title, axis labels and shape of the picture's image."""
    with style.paper():
        figure = pictures.draw(scores, "a log", "mine")
        figure.draw_without_rendering()
    (ax,) = figure.axes[:1]
    title = figure.get_suptitle()
    return title, [ax.get_xlabel(), ax.get_ylabel()], ax.images[0].get_array().shape


def test_thousands_of_scans_are_thinned_and_the_title_says_so() -> None:
    scores = np.zeros((2500, 2500), np.float32)
    title, names, shape = drawn(Scores(scores, np.arange(2500.0), None, None))
    assert "a log, 2500 scans, similarity mine" in title and "one scan in 3 is drawn" in title
    assert shape == (834, 834) and names == ["scan k (model)", "scan j"]
    title, names, shape = drawn(Scores(scores[:, :999], np.arange(2500.0), None, 1000))
    assert "one scan in 3 is drawn, one gap in 3 is drawn" in title
    assert names == ["scan j", "gap (scans)"] and shape == (333, 834)


def test_few_scans_are_all_drawn() -> None:
    title, _, shape = drawn(Scores(np.eye(5, dtype=np.float32), np.arange(5.0), None, None))
    assert shape == (5, 5) and "drawn" not in title


def test_metres_stand_at_the_scans_where_they_are_reached() -> None:
    metres = np.array([0.0, 0.0, 5.0, 10.0, 10.0])
    with style.paper():
        figure = pictures.draw(Scores(np.eye(5, dtype=np.float32), metres, metres, None), "a", "b")
    (upper,) = figure.axes[0].child_axes[:1]
    ticks = dict(
        zip(upper.get_xticks(), (t.get_text() for t in upper.get_xticklabels()), strict=True)
    )
    assert upper.get_xlabel() == "metres travelled"
    assert ticks[0] == "0" and ticks[3] == "10"
