"""Figures of methods side by side, and of occupancy grids: what is drawn, and when."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from figure_helpers import data_of, lines, make_run, scaled, texts
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.text import Annotation, Text

from rbtm_bench import plots
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.plots import cost, growth, looks, methods, occupancy, style, trajectories
from rbtm_bench.plots.placing import Label, place
from rbtm_bench.runs import stored
from rbtm_bench.runs.occupancy import Occupancy
from rbtm_bench.runs.pictures import write_npz

# --- accuracy against time


def numbered(out: Path, *numbers: tuple[str, str, float, float]) -> list[stored.Run]:
    return [
        make_run(out / f"{backend}-{selector}", selector, backend, ms=ms, error=error)
        for backend, selector, ms, error in numbers
    ]


def test_the_front_is_what_nothing_beats_in_both(tmp_path: Path) -> None:
    runs = numbered(
        tmp_path, ("a", "previous", 1.0, 50.0), ("a", "rbtm", 2.0, 20.0),
        ("b", "previous", 3.0, 30.0), ("b", "rbtm", 8.0, 5.0), ("b", "keyframe", 8.0, 6.0),
    )  # fmt: skip
    (figure,) = cost.draw(data_of(*runs))
    (ax,) = figure.axes
    step = lines(figure)["Pareto front"].get_xydata()
    inner = [[1, 50], [2, 50], [2, 20], [8, 20], [8, 5]]
    assert step[1:-1].tolist() == inner
    assert step[0][0] == 1 and step[0][1] > 1e6 and step[-1][1] == 5 and step[-1][0] > 1e6
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
    assert ax.get_xlabel() == "time a scan (ms)" and ax.get_ylabel() == "final position error (mm)"
    figure.draw_without_rendering()
    ticks = [label.get_text() for label in ax.get_yticklabels()]
    assert {"5", "10", "20", "50"} <= set(ticks)
    assert ax.get_xlim()[1] < 20 and ax.get_ylim()[1] < 200  # the front does not widen the axes
    marks = {
        (line.get_xdata()[0], line.get_marker()) for line in ax.lines if len(line.get_xdata()) == 1
    }
    assert {(1.0, "o"), (2.0, "D"), (3.0, "o"), (8.0, "D"), (8.0, "s")} == marks
    named = {note.get_text(): note.xy for note in ax.texts if isinstance(note, Annotation)}
    assert set(named) == {"a", "b"}
    assert named["a"] in [(1.0, 50.0), (2.0, 20.0)]
    assert {"Previous", "Keyframe", "RBTM"} <= set(texts(figure).split("\n"))


def test_points_close_together_still_have_ticks_between(tmp_path: Path) -> None:
    runs = numbered(tmp_path, ("a", "previous", 52.0, 1010.0), ("b", "rbtm", 118.0, 757.0))
    (figure,) = cost.draw(data_of(*runs))
    ax = figure.axes[0]
    for ticks, (low, high) in ((ax.get_xticks(), ax.get_xlim()), (ax.get_yticks(), ax.get_ylim())):
        assert sum(low <= tick <= high for tick in ticks) >= 2


def test_methods_of_which_a_run_failed_are_pale_and_not_on_the_front(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / "g", error=1.0, ms=1.0, seed=0), *numbered(
        tmp_path, ("p2p", "previous", 2.0, 30.0), ("gicp", "rbtm", 3.0, 20.0)
    )]  # fmt: skip
    runs += [make_run(tmp_path / "bad", error=None, seed=1)]
    data = data_of(*runs)
    points = cost.read(data, "final_translation_error_mm")
    assert {point.error: point.whole for point in points} == {1.0: False, 20.0: True, 30.0: True}
    assert [(p.time, p.error) for p in cost.front(points)] == [(2.0, 30.0), (3.0, 20.0)]
    (figure,) = cost.draw(data)
    drawn = figure.axes[0].lines
    pale = [line.get_xdata()[0] for line in drawn if line.get_alpha() == cost.PARTIAL]
    assert pale == [1.0] and "some runs failed" in texts(figure)


def test_points_are_medians_and_large_errors_metres(tmp_path: Path) -> None:
    runs = [
        make_run(tmp_path / f"{s}{i}", s, seed=i, error=error * factor, ms=ms * factor)
        for s, error, ms in (("previous", 60_000.0, 1.0), ("rbtm", 900.0, 4.0))
        for i, factor in enumerate((0.5, 1.0, 1.9))
    ]
    runs += [make_run(tmp_path / "n", "previous", "none", error=90_000.0)]
    (figure,) = cost.draw(data_of(*runs))
    assert figure.axes[0].get_ylabel() == "final position error (m)"
    assert lines(figure)["Pareto front"].get_xydata()[1:-1].tolist() == [[1, 60], [4, 60], [4, 0.9]]
    guess = [line for line in figure.axes[0].lines if line.get_color() == looks.GUESS["color"]]
    assert guess[0].get_ydata()[0] == 90.0 and "medians of 3 seeds" in texts(figure)
    runs[-1] = make_run(tmp_path / "far", "previous", "none", error=900_000.0)
    (figure,) = cost.draw(data_of(*runs))
    assert figure.axes[0].get_ylim()[1] < 200  # the guess does not widen the axes
    assert "no registration: 900 m \N{UPWARDS ARROW}" in texts(figure)
    assert not list(cost.draw(data_of(*runs[:3])))  # one method: nothing to compare


def test_backends_are_told_apart_by_colour_and_a_name_beside_their_line(tmp_path: Path) -> None:
    runs = numbered(
        tmp_path, ("plicp", "previous", 1.0, 50.0), ("plicp", "rbtm", 2.0, 20.0),
        ("psm", "previous", 3.0, 30.0), ("psm", "rbtm", 8.0, 5.0),
    )  # fmt: skip
    (figure,) = cost.draw(data_of(*runs))
    (ax,) = figure.axes
    named = {note.get_text(): note.get_color() for note in ax.texts}
    assert named == {"PLICP": looks.BACKENDS["plicp"], "PSM": looks.BACKENDS["psm"]}
    links = [line for line in ax.lines if line.get_alpha() == cost.LINK["alpha"]]
    assert [line.get_color() for line in links] == list(named.values())
    assert all(np.all(np.diff(line.get_xdata()) > 0) for line in links)


def test_labels_cover_neither_markers_nor_each_other() -> None:
    figure = Figure(figsize=(7.0, 4.2), dpi=100)
    ax = figure.add_subplot()
    ax.set(xlim=(0, 10), ylim=(0, 10))
    spots = [(5.0 + 0.3 * i, 5.0 + 0.25 * (i % 3)) for i in range(8)]
    place(figure, ax, [Label(f"backend{i}", (spot,)) for i, spot in enumerate(spots)], spots)
    figure.draw_without_rendering()
    boxes_of = [Text.get_window_extent(note) for note in ax.texts]
    for number, box in enumerate(boxes_of):
        assert not any(box.overlaps(other) for other in boxes_of[number + 1 :])
        assert not any(box.contains(*ax.transData.transform(spot)) for spot in spots)
        assert ax.get_window_extent().fully_containsx(box.x0)


# --- the spread over seeds


def seeds(out: Path, errors: list[float], selector: str = "rbtm") -> list[stored.Run]:
    return [
        make_run(out / f"{selector}{i}", selector, seed=i, error=error)
        for i, error in enumerate(errors)
    ]


def test_boxes_show_quartiles_extremes_runs_and_n(tmp_path: Path) -> None:
    errors = [10.0, 20.0, 30.0, 40.0, 70.0]
    runs = [*seeds(tmp_path, errors), *seeds(tmp_path, [50.0] * 3, "previous")]
    runs += [make_run(tmp_path / "bad", seed=9, error=None)]
    figure = methods.errors(runs)
    assert figure is not None
    (box,) = figure.axes[0].patches  # none of three seeds
    corners = box.get_path().vertices[:, 0]
    assert (corners.min(), corners.max()) == (20.0, 40.0)
    drawn = [list(line.get_xdata()) for line in figure.axes[0].lines]
    assert [30.0] in drawn  # the median
    assert [20.0, 10.0] in drawn and [40.0, 70.0] in drawn  # whiskers
    assert errors in drawn and [50.0] * 3 in drawn  # the runs
    assert "5 of 6 runs" in texts(figure) and "final position error (mm)" in texts(figure)


def test_many_runs_are_their_box_alone(tmp_path: Path) -> None:
    errors = [float(i) for i in range(1, methods.ALL + 1)]
    figure = methods.errors(seeds(tmp_path, errors))
    assert figure is not None and len(figure.axes[0].patches) == 1
    assert errors not in [list(line.get_xdata()) for line in figure.axes[0].lines]


# --- occupancy


def with_grid(run: stored.Run, hits: Any, passed: Any, cell: float = 0.5) -> stored.Run:
    grid = Occupancy(np.asarray(hits, np.uint32), np.asarray(passed, np.uint32), np.zeros(2), cell)
    points = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0]], np.float32)
    write_npz(run.path / "map.npz", points=points, **grid.arrays())
    return run


def test_cells_are_white_black_grey_or_unknown(tmp_path: Path) -> None:
    run = with_grid(make_run(tmp_path / "r"), [[0, 3, 1, 0]], [[4, 1, 3, 0]])
    figure = occupancy.draw(run)
    assert figure is not None
    (image,) = figure.axes[0].images
    pixels = np.asarray(image.get_array())[0]
    assert pixels[0].tolist() == [1, 1, 1] and pixels[1].tolist() == [0, 0, 0]  # 0, 75 %
    assert pixels[2].tolist() == [0.5, 0.5, 0.5]  # 25 %, black from 50 % on
    assert pixels[3].tolist() == pytest.approx(to_rgb(occupancy.UNKNOWN))
    assert image.get_extent() == [0.0, 2.0, 0.0, 0.5] and image.origin == "lower"
    words = texts(figure)
    assert "cells of 0.5 m" in words and "never seen" in words
    assert "ground truth" in words and "blocks" not in words


def test_fine_cells_are_drawn_by_the_fullest_of_a_block(tmp_path: Path) -> None:
    hits, passed = np.zeros((2000, 2000)), np.zeros((2000, 2000))
    passed[:1000] = 5
    hits[3, 1000] = 9  # a cell between free ones
    run = with_grid(make_run(tmp_path / "r"), hits, passed, cell=0.001)
    figure = occupancy.draw(run)
    assert figure is not None
    (image,) = figure.axes[0].images
    pixels = np.asarray(image.get_array())[..., 0]
    size = 2000 // (len(pixels) - 1)
    assert size > 1 and pixels[3 // size, 1000 // size] == 0.0
    assert (pixels[0] == 1.0).sum() == pixels.shape[1] - 1
    assert f"blocks of {0.001 * size:g} m" in texts(figure)


def test_a_run_without_a_grid_has_no_figure_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    run = make_run(tmp_path / "r")
    assert occupancy.draw(run) is None
    write_npz(run.path / "map.npz", points=np.zeros((1, 3), np.float32))
    assert occupancy.draw(run) is None
    for broken in ({"hits": np.zeros(3)}, {"cell": np.array(-1.0)}, {"corner": np.zeros(3)}):
        arrays = {"hits": np.zeros((2, 2)), "passed": np.zeros((2, 2)), "corner": np.zeros(2)}
        arrays |= {"cell": np.array(1.0), "points": np.zeros((1, 3)), **broken}
        write_npz(run.path / "map.npz", **arrays)
        with pytest.raises(DataError, match=r"map.npz: .*not a grid"):
            occupancy.draw(run)


# --- files


def test_plot_makes_the_figures_that_make_sense(tmp_path: Path) -> None:
    runs = [
        make_run(tmp_path / f"{b}{s}{i}", s, b, i, poses=scaled(1.1 + 0.1 * i))
        for b in ("p2p", "gicp")
        for s in ("previous", "rbtm")
        for i in range(4)
    ]
    files = plots.draw(runs, tmp_path / "figures")
    stems = {file.stem for file in files}
    kinds = ("trajectories", "error_over_path", "accuracy_time")
    assert {f"corridor-{kind}" for kind in kinds} <= stems
    for file in files:
        if file.suffix == ".pdf":  # fonts as TrueType, embedded
            content = file.read_bytes()
            assert b"/FontFile2" in content and b"/Type3" not in content
    only = plots.draw(
        runs, tmp_path / "only", ["errors"],
        style.Drawing(style="talk", titles=False, formats=("svg",)),
    )  # fmt: skip
    assert [file.name for file in only] == ["errors.svg"]
    first = only[0].read_bytes()
    plots.draw(runs, tmp_path / "only", ["errors"], style.Drawing("talk", False, ("svg",)))
    assert only[0].read_bytes() == first and b"by method" not in first
    with pytest.raises(ConfigError, match=r"--only eror: no such figure. Did you mean errors\?"):
        plots.draw(runs, tmp_path / "only", ["eror"])
    alone = with_grid(make_run(tmp_path / "alone", truth=None, ms=None), [[1]], [[0]])
    assert {file.stem for file in plots.draw([alone], tmp_path / "one")} == {
        "alone-map", "alone-occupancy",
    }  # fmt: skip


def test_legends_stay_inside_the_figure(tmp_path: Path) -> None:
    runs = [
        make_run(tmp_path / f"{s}", s, poses=scaled(1.1), window=30, threshold=0.7, seed=1)
        for s in ("previous", "keyframe", "fixed_gap", "oldest", "random_gap", "rbtm")
    ]
    data = data_of(*runs)
    with style.paper():
        for figure in (*trajectories.draw(data), *growth.draw(data), *cost.draw(data)):
            figure.draw_without_rendering()
            box = figure.legends[0].get_window_extent()
            assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
            rows = [text.get_window_extent() for text in figure.legends[0].get_texts()]
            assert all(not a.overlaps(b) for a, b in pairwise(rows))
