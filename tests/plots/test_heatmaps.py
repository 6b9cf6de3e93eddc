"""Heat maps and lines over a selector's settings: medians, failed and missing cells, the files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.text import Text
from omegaconf import OmegaConf

from rbtm_bench import plots
from rbtm_bench.cli.commands import main
from rbtm_bench.core.files import write_json, write_text
from rbtm_bench.plots import heatmaps, labels, lines, style
from rbtm_bench.plots.studies import studies
from rbtm_bench.runs import stored

MM = "final_translation_error_mm"


def make_run(
    path: Path,
    error: float | None,
    selector: str = "rbtm",
    backend: str = "p2p",
    seed: int = 0,
    shared: dict[str, Any] | None = None,
    **settings: Any,
) -> None:
    """The files of a run that these figures are made of; without an error it failed."""
    path.mkdir(parents=True)
    config = {"seed": seed, "dataset": {"environment": "paper", "seed": seed}, "backend": {}}
    config |= {"selector": settings, **(shared or {})}
    write_text(path / "config.yaml", OmegaConf.to_yaml(OmegaConf.create(config)))
    choices = {"dataset": "corridor", "backend": backend, "selector": selector}
    status = "failed" if error is None else "done"
    write_json(path / "run.json", {"status": status, "choices": choices, "seed": seed})
    if error is not None:
        write_json(path / "metrics.json", {MM: error})


def grid(out: Path, windows: Any, thresholds: Any, backend: str = "p2p", **more: Any) -> None:
    """A run a place with the error 100 threshold + window."""
    for window in windows:
        for threshold in thresholds:
            make_run(
                out / f"{backend}-{window}-{threshold}", 100 * threshold + window,
                backend=backend, window=window, threshold=threshold, **more,
            )  # fmt: skip


def read(*folders: Path) -> list[stored.Run]:
    return stored.find_runs(folders)


def texts(figure: Figure) -> list[str]:
    return [artist.get_text() for artist in figure.findobj(Text)]


def hatches(figure: Figure) -> list[str]:
    patches = [patch for ax in figure.axes for patch in ax.patches]
    return [patch.get_hatch() for patch in patches if patch.get_hatch()]


# --- what can be drawn


def test_cells_are_medians_over_seeds_of_the_runs_that_are_done(tmp_path: Path) -> None:
    for seed, error in enumerate((10.0, 70.0, 20.0)):
        make_run(tmp_path / f"a{seed}", error, seed=seed, window=4, threshold=0.5)
    for seed, error in enumerate((40.0, None)):
        make_run(tmp_path / f"b{seed}", error, seed=seed, window=8, threshold=0.5)
    make_run(tmp_path / "c", None, window=4, threshold=0.6)
    (study,) = studies(read(tmp_path))
    assert (study.stem, study.axes, study.unit) == ("corridor", ("window", "threshold"), "mm")
    (panel,) = study.panels
    cells = {place: (c.median, c.known, c.runs) for place, c in panel.cells.items() if c.known}
    assert cells == {(4.0, 0.5): (20.0, 3, 3), (8.0, 0.5): (40.0, 1, 2)}
    assert panel.cells[4.0, 0.6].known == 0 and (8.0, 0.6) not in panel.cells
    assert panel.best == 20.0 and panel.control is None
    with style.paper():
        (figure,) = heatmaps.draw(study)
        figure.draw_without_rendering()
    words = texts(figure)
    assert "20" in words and "40*" in words and "some runs failed" in words
    box = figure.legends[0].get_window_extent()
    assert figure.get_figwidth() == style.SINGLE
    assert figure.bbox.x0 <= box.x0 and box.x1 <= figure.bbox.x1
    # the ground shows where nothing was run, the failed cell has a hatch of its own
    assert len(set(hatches(figure))) == 2 and {"failed", "not run"} <= set(words)


def test_panels_are_backends_and_what_else_tells_runs_apart(tmp_path: Path) -> None:
    for backend in ("p2p", "gicp"):
        grid(tmp_path / "g", (4, 8), (0.5, 0.6), backend, fallback="previous")
        make_run(tmp_path / f"{backend}-previous", 300.0, "previous", backend)
    grid(tmp_path / "h", (4, 8), (0.5, 0.6), "p2p", fallback="skip")
    grid(tmp_path / "none", (4, 8), (0.5, 0.6), "none", fallback="previous")
    (study,) = studies(read(tmp_path))  # backend "none" registers nothing: not drawn
    names = ["gicp, fallback=previous", "p2p, fallback=previous", "p2p, fallback=skip"]
    assert [panel.name for panel in study.panels] == names
    assert [panel.control for panel in study.panels] == [300.0] * 3
    (figure,) = heatmaps.draw(study)
    images = [ax.images[0] for ax in figure.axes if ax.images]
    assert len(images) == 3 and len({image.norm for image in images}) == 1  # one colour scale
    assert images[0].get_clim() == (54.0, 68.0)


def test_other_settings_than_threshold_and_window_do_as_well(tmp_path: Path) -> None:
    for distance in (0.1, 0.3):
        for angle in (5.0, 15.0):
            settings = {"distance": distance, "angle_deg": angle, "content": "scans"}
            make_run(tmp_path / f"{distance}{angle}", 9.0 + angle, "keyframe", **settings)
    make_run(tmp_path / "p", 50.0, "previous")
    (study,) = studies(read(tmp_path))
    assert (study.stem, study.axes) == ("corridor-keyframe", ("distance", "angle_deg"))
    (figure,) = heatmaps.draw(study)
    assert {"distance (m)", "angle (deg)", "final position error (mm)"} <= set(texts(figure))


def test_window_and_threshold_come_before_other_settings(tmp_path: Path) -> None:
    for i, (a, window, threshold) in enumerate([(1, 4, 0.5), (2, 8, 0.6), (1, 8, 0.5)]):
        make_run(tmp_path / str(i), 1.0 + i, alpha=a, window=window, threshold=threshold)
    (study,) = studies(read(tmp_path))
    assert study.axes == ("window", "threshold")
    assert [panel.name for panel in study.panels] == ["p2p, alpha=1", "p2p, alpha=2"]


def test_nothing_to_draw_without_a_setting_that_varies(tmp_path: Path) -> None:
    make_run(tmp_path / "a", 1.0, window=4, threshold=0.5)
    make_run(tmp_path / "b", 2.0, seed=1, window=4, threshold=0.5)
    make_run(tmp_path / "p", 2.0, "previous")
    assert studies(read(tmp_path)) == []
    make_run(tmp_path / "c", None, window=8, threshold=0.5, backend="gicp")
    make_run(tmp_path / "d", None, "fixed_gap", gap=5)
    make_run(tmp_path / "e", None, "fixed_gap", gap=9)  # all of fixed_gap failed
    assert [study.selector for study in studies(read(tmp_path))] == ["rbtm"]


# --- how it looks


def test_every_cell_holds_its_value_and_the_best_ones_a_frame(tmp_path: Path) -> None:
    grid(tmp_path, range(1, 13), np.linspace(0.1, 0.9, 12).round(3).tolist())
    make_run(tmp_path / "tie", 11.0, window=13, threshold=0.1)
    (study,) = studies(read(tmp_path))
    (figure,) = heatmaps.draw(study)
    assert "11.0" not in texts(figure) and "13" in texts(figure)  # 13 windows: no values
    for run in ("tie", *(f"p2p-{12}-{t}" for t in study.values(1))):
        for file in (tmp_path / run).iterdir():
            file.unlink()
    (study,) = studies(read(tmp_path))
    (figure,) = heatmaps.draw(study)
    values = [t for t in figure.findobj(Text) if t.get_fontsize() == heatmaps.NUMBER]
    assert len(values) == 11 * 12 and "11" in [t.get_text() for t in values]
    frames = [p for p in figure.axes[0].patches if p.get_edgecolor()[:3] == (0, 0, 0)]
    assert [(p.get_x(), p.get_y()) for p in frames if not p.get_hatch()] == [
        (-0.5 + heatmaps.INSET, -0.5 + heatmaps.INSET)
    ]


def test_a_wide_range_has_a_logarithmic_colour_scale(tmp_path: Path) -> None:
    for i, error in enumerate((10.0, 50.0, 100.0, 190.0)):
        make_run(tmp_path / str(i), error, window=4 + i // 2, threshold=0.5 + i % 2)
    (study,) = studies(read(tmp_path))
    (figure,) = heatmaps.draw(study)
    assert not isinstance(figure.axes[0].images[0].norm, LogNorm)
    make_run(tmp_path / "far", 61_800.0, window=9, threshold=0.5)
    make_run(tmp_path / "zero", 0.0, window=9, threshold=1.5)
    (study,) = studies(read(tmp_path))
    (figure,) = heatmaps.draw(study)
    image = figure.axes[0].images[0]
    assert isinstance(image.norm, LogNorm) and image.get_clim() == (10.0, 61_800.0)
    words = texts(figure)
    assert "61.8k" in words and {"100", "1000", "10k"} <= set(words)


def test_equal_errors_everywhere_still_give_a_figure(tmp_path: Path) -> None:
    for i in range(4):
        make_run(tmp_path / str(i), 0.0, window=4 + i // 2, threshold=0.5 + i % 2)
    assert "corridor-heatmap" in {f.stem for f in plots.draw(read(tmp_path), tmp_path / "out")}


def test_many_backends_take_several_pages_in_one_colour_scale(tmp_path: Path) -> None:
    for number in range(7):
        grid(tmp_path, (2, 4, 8, 16, 32, 64, 100), (0.5, 0.6, 0.7, 0.8), f"backend{number}")
    make_run(tmp_path / "far", 999.0, backend="backend6", window=2, threshold=0.9)
    (study,) = studies(read(tmp_path))
    figures = list(heatmaps.draw(study))
    assert len(figures) > 1
    assert all(figure.get_figheight() <= style.TALLEST + 0.5 for figure in figures)
    norms = {ax.images[0].norm for figure in figures for ax in figure.axes if ax.images}
    assert len(norms) == 1
    assert sum(len([ax for ax in f.axes if ax.images]) for f in figures) == 7
    files = {f.stem for f in plots.draw(read(tmp_path), tmp_path / "out")}
    assert {"corridor-heatmap", "corridor-heatmap-2"} <= files


@pytest.mark.parametrize(
    ("number", "text"),
    [(0.0, "0"), (0.2134, "0.213"), (11.47, "11.5"), (99.96, "100"), (1076.3, "1076"),
     (9999.6, "10k"), (61_753.0, "61.8k"), (-3.0, "-3")],
)  # fmt: skip
def test_values_are_short(number: float, text: str) -> None:
    assert heatmaps.short(number) == text


@pytest.mark.parametrize(
    ("setting", "text"),
    [("window", "window (scans)"), ("keyframe_angle_deg", "keyframe angle (deg)"),
     ("threshold", "similarity threshold Th (no unit)"), ("alpha", "alpha"),
     ("keyframe_distance", "keyframe distance (m)"), ("gap", "gap (scans)")],
)  # fmt: skip
def test_axes_have_units(setting: str, text: str) -> None:
    assert labels.axis(setting) == text


# --- lines


def test_one_setting_gives_lines_with_the_control_and_failed_places(tmp_path: Path) -> None:
    for backend, control in (("gicp", 80.0), ("p2p", 90.0)):
        make_run(tmp_path / f"{backend}p", control, "previous", backend)
        for window in (4, 8, 16):
            for seed in (0, 1, 2):
                error = None if (backend, window) == ("p2p", 16) else 10.0 * window + seed
                make_run(
                    tmp_path / f"{backend}{window}{seed}", error, backend=backend, seed=seed,
                    window=window, threshold=0.7,
                )  # fmt: skip
    (study,) = studies(read(tmp_path))
    assert study.axes == ("window",)
    figure = lines.draw(study)
    (ax,) = figure.axes
    by_name = {line.get_label(): line for line in ax.lines}
    np.testing.assert_array_equal(by_name["gicp"].get_xydata(), [[4, 41], [8, 81], [16, 161]])
    assert np.isnan(by_name["p2p"].get_ydata()[2])
    assert {"failed", "previous", "window (scans)"} <= set(texts(figure))
    assert ax.get_yscale() == "linear" and ax.get_ylim()[0] == 0
    files = {f.stem for f in plots.draw(read(tmp_path), tmp_path / "out")}
    assert "corridor-line" in files and "corridor-heatmap" not in files


def test_many_lines_take_several_panels_and_wide_ranges_log_scales(tmp_path: Path) -> None:
    for number in range(8):
        for gap in (1, 10, 40):
            make_run(
                tmp_path / f"{number}-{gap}", 10.0**number * gap, "fixed_gap", f"b{number}", gap=gap
            )
    (study,) = studies(read(tmp_path))
    figure = lines.draw(study)
    first, second = figure.axes
    assert [len(ax.get_legend().get_texts()) for ax in (first, second)] == [6, 2]
    assert (first.get_xscale(), first.get_yscale()) == ("log", "log")
    assert [tick.get_text() for tick in first.get_xticklabels()] == ["1", "10", "40"]


# --- files


def test_plot_rebuilds_the_figures_of_merged_sweeps(tmp_path: Path, capsys: Any) -> None:
    grid(tmp_path / "one", (4, 8), (0.5, 0.6))
    grid(tmp_path / "two", (16, 32), (0.5, 0.6))
    grid(tmp_path / "other", (4, 8), (0.5,), shared={"dataset": {"environment": "bare"}})
    out = tmp_path / "figures"
    assert main(["plot", *(str(tmp_path / name) for name in ("one", "two")), f"--out={out}"]) == 0
    listed = capsys.readouterr().out.split()
    assert {str(out / f"corridor-heatmap.{end}") for end in ("png", "pdf")} <= set(listed)
    pixels = matplotlib.image.imread(out / "corridor-heatmap.png")[..., :3]
    assert pixels.shape[1] == pytest.approx(150 * style.SINGLE, abs=1) and pixels.std() > 0.1
    assert b"/Type3" not in (out / "corridor-heatmap.pdf").read_bytes()
    (study,) = studies(read(tmp_path / "one", tmp_path / "two"))
    assert study.values(0) == [4, 8, 16, 32] and len(study.medians) == 8
    both = studies(read(tmp_path / "one", tmp_path / "other"))
    assert [s.stem for s in both] == ["corridor-environment=paper", "corridor-environment=bare"]
    assert [s.axes for s in both] == [("window", "threshold"), ("window",)]
