"""Figures from small run folders: which files appear, and that they show something."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.image
import numpy as np
import pyarrow.parquet as pq
import pytest
from matplotlib.figure import Figure

from rbtm_bench import plots
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.files import write_json, write_text
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import StepRecord, StepTable
from rbtm_bench.plots import folder, labels, maps, matrix, methods, pairs, steps, style
from rbtm_bench.runs import stored
from rbtm_bench.runs.experiment import write_steps
from rbtm_bench.runs.pictures import write_npz

N = 12
SELECTORS: dict[str, dict[str, Any]] = {
    "previous": {},
    "fixed_gap": {"gap": 5},
    "rbtm": {"window": 6, "threshold": 0.8, "fallback": "previous", "content": "scans"},
}


def records(selector: str) -> list[StepRecord]:
    """A row of every status."""
    rows = [StepRecord(0, 0.0)]
    for i in range(1, N):
        score = 0.9 - 0.01 * i if selector == "rbtm" else float("nan")
        rows.append(StepRecord(i, 0.1 * i, max(i - 3, 0), min(i, 3), score, status="registered"))
    if selector == "rbtm":
        rows[5] = StepRecord(5, 0.5, 4, 1, 0.6, status="fallback")
        for i, status in ((6, "skipped"), (7, "predicted"), (8, "unusable")):
            rows[i] = StepRecord(i, 0.1 * i, status=status)
    return rows


def make_run(
    path: Path,
    selector: str = "rbtm",
    backend: str = "open3d_p2p",
    seed: int = 0,
    error: float | None = 12.0,
    *,
    dataset: dict[str, Any] | None = None,
    settings: dict[str, Any] | None = None,
    status: str = "done",
    check: str = "none",
    truth: bool = True,
    spatial: bool = False,
) -> stored.Run:
    """A run folder like those that ``experiment.run`` leaves, read back."""
    path.mkdir(parents=True)
    config = {
        "seed": seed,
        "map_resolution": 0.05,
        "dataset": {"environment": "paper", "seed": seed} if dataset is None else dataset,
        "backend": {"radius": 0.3},
        "selector": {**SELECTORS.get(selector, {}), **(settings or {})},
    }
    write_text(path / "config.yaml", json.dumps(config))
    choices = {"dataset": "corridor" if dataset is None else "carmen", "backend": backend}
    choices |= {"selector": selector, "similarity": "curvature", "check": check}
    record = {"status": status, "choices": choices, "seed": seed, "scans": N}
    if status != "done":
        write_json(path / "run.json", {**record, "reason": "the lid is shut"})
        return stored.read_run(path)
    write_json(path / "run.json", record)
    metrics = {"final_translation_error_mm": error, "final_along_mm": -3.0, "final_cross_mm": 2.0}
    write_json(path / "metrics.json", {**metrics, "mean_gap": 2.8, "rejected": 1})
    write_steps(path / "steps.parquet", StepTable(records(selector)))
    stamps = 0.1 * np.arange(N)
    estimate = np.stack([se2(0.1 * i, 0.01 * i, 0.0) for i in range(N)])
    Trajectory(stamps, estimate).write_tum(path / "trajectory.tum")
    if truth:
        moved = np.stack([se2(5.0, 5.0, 1.0) @ se2(0.12 * i, 0.0, 0.0) for i in range(N)])
        Trajectory(stamps, moved).write_tum(path / "ground_truth.tum")
    points = np.random.default_rng(seed).uniform(-1, 3, (400, 3)) * [1, 1, float(spatial)]
    write_npz(path / "map.npz", points=points.astype(np.float32))
    if selector == "rbtm":
        scores = np.exp(-0.2 * np.abs(np.subtract.outer(np.arange(N), np.arange(N))))
        write_npz(path / "similarity.npz", scans=np.arange(N), scores=scores)
    return stored.read_run(path)


def stems(files: list[Path]) -> set[str]:
    """The figures' names; every one exists as PNG and as PDF."""
    assert all(file.is_file() for file in files)
    png, pdf = ({f.stem for f in files if f.suffix == end} for end in (".png", ".pdf"))
    assert png == pdf and len(files) == 2 * len(png)
    return png


def texts(figure: Figure) -> str:
    return "\n".join(artist.get_text() for artist in figure.findobj(matplotlib.text.Text))


# --- which figures


def test_two_runs_give_every_figure_of_a_run_and_the_pair(tmp_path: Path):
    runs = [make_run(tmp_path / "std", "previous"), make_run(tmp_path / "ours", "rbtm")]
    files = plots.draw(runs, tmp_path / "new" / "figures")
    assert stems(files) == {
        *("std-map", "std-gap", "ours-map", "ours-gap", "ours-similarity"),
        "corridor-open3d_p2p-standard_beside_rbtm",
        *("corridor-trajectories", "corridor-error_over_path"),
    }
    for file in files:
        if file.suffix == ".png":
            pixels = matplotlib.image.imread(file)[..., :3]
            width = 7.0 if "beside" in file.stem else 3.4
            assert pixels.shape[1] == pytest.approx(150 * width, abs=1)
            assert 200 < pixels.shape[0] < 1200
            assert pixels.std() > 0.03
        else:  # fonts as TrueType, embedded
            content = file.read_bytes()
            assert b"/FontFile2" in content and b"/Type3" not in content
    assert not list((tmp_path / "new" / "figures").glob(".*"))


def test_many_runs_give_the_comparison_and_one_representative(tmp_path: Path):
    runs = [
        make_run(tmp_path / f"{backend}-{selector}-{seed}", selector, backend, seed, 10.0 + seed)
        for backend in ("none", "open3d_p2p")
        for selector in ("previous", "fixed_gap", "rbtm")
        for seed in (2, 1)
    ]
    assert stems(plots.draw(runs, tmp_path / "figures")) == {
        *(f"open3d_p2p-rbtm-1-{kind}" for kind in ("map", "gap", "similarity")),
        *(f"open3d_p2p-previous-1-{kind}" for kind in ("map", "gap")),  # the winner
        "corridor-open3d_p2p-seed1-standard_beside_rbtm",
        *("errors", "corridor-trajectories", "corridor-error_over_path"),
    }


def test_titles_are_in_words_for_readers(tmp_path: Path):
    figure = steps.gaps(make_run(tmp_path / "ours", "rbtm"))
    assert figure is not None
    words = texts(figure).replace("\N{NO-BREAK SPACE}", " ").replace("\n", " ")
    assert "Corridor, ICP (Open3D), RBTM (window 6, Th 0.8), seed 0" in words
    with style.paper(style.Drawing(titles=False)):
        bare = steps.gaps(make_run(tmp_path / "bare", "rbtm"))
    assert bare is not None and bare.get_suptitle() == ""


def test_failed_and_running_runs_are_left_out(tmp_path: Path):
    runs = [
        make_run(tmp_path / "good", "rbtm"),
        make_run(tmp_path / "bad", "previous", status="failed"),
        make_run(tmp_path / "open", "fixed_gap", status="started"),
    ]
    files = plots.draw(runs, tmp_path / "figures")
    expected = {"good-map", "good-gap", "good-similarity", "errors", "corridor-error_over_path"}
    assert stems(files) == expected
    figure = methods.errors(runs)
    assert figure is not None
    assert "2 of 3 runs are not done" in texts(figure) and "no result" in texts(figure)


def test_nothing_to_draw_says_why(tmp_path: Path):
    with pytest.raises(DataError, match="no runs given"):
        plots.draw([], tmp_path)
    failed = make_run(tmp_path / "bad", status="failed")
    with pytest.raises(DataError, match=r"none of 1 run.*bad is failed: the lid is shut"):
        plots.draw([failed], tmp_path)
    empty = make_run(tmp_path / "empty", "rbtm")
    for name in ("map.npz", "steps.parquet", "similarity.npz", "trajectory.tum"):
        (empty.path / name).unlink()
    with pytest.raises(DataError, match="no map, steps, similarity or error in empty"):
        plots.draw([empty], tmp_path)


def test_a_folder_that_cannot_be_made_is_a_data_error(tmp_path: Path):
    run = make_run(tmp_path / "run")
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="cannot be written"):
        plots.draw([run], tmp_path / "file")


@pytest.mark.parametrize("name", ["map.npz", "steps.parquet", "similarity.npz", "trajectory.tum"])
def test_a_damaged_file_is_named(tmp_path: Path, name: str):
    run = make_run(tmp_path / "run")
    (run.path / name).write_bytes(b"PK\x03\x04 not what it was")
    with pytest.raises(DataError, match=name):
        plots.draw([run], tmp_path / "figures")


def test_drawing_leaves_matplotlib_as_it_was_and_repeats_bit_for_bit(tmp_path: Path):
    run = make_run(tmp_path / "run")
    before = dict(matplotlib.rcParams)
    first, second = (plots.draw([run], tmp_path / name) for name in "ab")
    assert dict(matplotlib.rcParams) == before
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()


# --- single figures


def test_undefined_similarities_are_hatched_and_counted(tmp_path: Path):
    run = make_run(tmp_path / "run")
    scores = np.eye(4)
    scores[1, :] = scores[:, 1] = np.nan
    write_npz(run.path / "similarity.npz", scans=np.arange(4), scores=scores)
    figure = matrix.similarity(run)
    assert figure is not None and "undefined (43.8%)" in texts(figure)
    write_npz(run.path / "similarity.npz", scans=np.arange(4), scores=np.full((4, 4), np.nan))
    assert "gap" in {f.stem.split("-")[1] for f in plots.draw([run], tmp_path / "figures")}
    figure = matrix.similarity(run)
    assert figure is not None and "undefined (100.0%)" in texts(figure)


def test_every_status_has_its_mark_and_scores_a_panel(tmp_path: Path):
    figure = steps.gaps(make_run(tmp_path / "ours", "rbtm"))
    assert figure is not None and len(figure.axes) == 2
    words = texts(figure)
    for word in ("registered (7)", "fallback (1)", "skipped (1", "threshold 0.8", "1 registr"):
        assert word in words
    standard = steps.gaps(make_run(tmp_path / "std", "previous"))
    assert standard is not None and len(standard.axes) == 1


def test_truth_is_moved_to_the_first_estimated_pose(tmp_path: Path):
    scene = folder.read_scene(make_run(tmp_path / "run"))
    assert scene is not None and scene.truth is not None and scene.planar
    assert np.allclose(scene.truth, [[0.12 * i, 0.0] for i in range(N)], atol=1e-12)


def test_a_map_in_space_is_thinned_and_seen_from_above(tmp_path: Path):
    run = make_run(tmp_path / "run", spatial=True, truth=False)
    points = np.random.default_rng(0).normal(size=(folder.DRAWN + 999, 3)).astype(np.float32)
    points[5] = np.nan
    write_npz(run.path / "map.npz", points=points)
    scene = folder.read_scene(run)
    assert scene is not None and len(scene.points) == folder.DRAWN and scene.truth is None
    figure = maps.single(run)
    assert figure is not None and "map from above" in texts(figure)


def test_stray_points_do_not_decide_the_view_but_poses_do():
    points = np.random.default_rng(0).uniform(0, 10, (5000, 2)).astype(np.float32)
    points[0] = 900.0
    path = np.array([[0.0, 0.0], [30.0, 0.0]])
    x0, x1, y0, y1 = maps.view([folder.Scene(points, path, None, True)])
    assert -3 < x0 < 0 and 30 < x1 < 33 and -3 < y0 < 0 and 9 < y1 < 13


def test_a_run_without_motion_and_map_still_gives_a_figure(tmp_path: Path):
    run = make_run(tmp_path / "run", truth=False)
    write_npz(run.path / "map.npz", points=np.zeros((0, 3), np.float32))
    Trajectory(np.zeros(1), np.eye(4)[None]).write_tum(run.path / "trajectory.tum")
    assert "run-map" in stems(plots.draw([run], tmp_path / "figures"))


# --- pairs


def test_a_pair_takes_the_lowest_common_seed_and_the_first_setting(tmp_path: Path):
    runs = [make_run(tmp_path / f"p{seed}", "previous", seed=seed) for seed in (0, 1)]
    runs += [
        make_run(tmp_path / f"r{window}", seed=1, settings={"window": window}) for window in (9, 5)
    ]
    (pair,) = pairs.standard_and_rbtm(runs)
    assert (pair.standard, pair.rbtm) == (runs[1], runs[2])
    assert pair.stem == "corridor-open3d_p2p-seed1"
    figure = maps.beside(pair)
    assert figure is not None and "RBTM (window\N{NO-BREAK SPACE}9" in texts(figure)
    left, right = figure.axes
    assert left.get_xlim() == right.get_xlim() and left.get_ylim() == right.get_ylim()


def test_pairs_never_mix_data_sets_and_say_what_else_differs(tmp_path: Path):
    logs = [{"path": f"logs/{name}.clf.gz", "relations": name} for name in ("aces", "intel")]
    runs = [
        make_run(tmp_path / f"{selector}{i}", selector, dataset=log)
        for i, log in enumerate(logs)
        for selector in ("previous", "rbtm")
    ]
    of_logs = pairs.standard_and_rbtm(runs)
    assert [p.stem for p in of_logs] == ["carmen-open3d_p2p-aces", "carmen-open3d_p2p-intel"]
    assert not pairs.standard_and_rbtm([runs[0], runs[3]])
    gated = make_run(tmp_path / "gated", "rbtm", dataset=logs[0], check="gated")
    assert pairs.standard_and_rbtm([*runs, gated])[0].rbtm is runs[1]
    (loose,) = pairs.standard_and_rbtm([runs[0], gated])
    assert loose.remarks == ("check none", "check gated")


# --- errors by method


def test_errors_have_a_row_a_method_and_a_log_axis_only_for_wide_ranges(tmp_path: Path):
    runs = [make_run(tmp_path / f"{s}{i}", s, seed=i, error=e) for s, i, e in (
        ("rbtm", 0, 10.0), ("rbtm", 1, 14.0), ("previous", 0, 90.0), ("fixed_gap", 0, 12.0),
    )]  # fmt: skip
    figure = methods.errors(runs)
    assert figure is not None
    (ax,) = figure.axes
    names = [label.get_text().split(" (")[0] for label in ax.get_yticklabels()]
    assert names == ["Previous", "Fixed gap", "RBTM"] and ax.get_xscale() == "linear"
    for worst, scale in ((900.0, "log"), (0.0, "linear")):
        runs[3] = make_run(tmp_path / f"{worst}", "fixed_gap", error=worst)
        figure = methods.errors(runs)
        assert figure is not None and figure.axes[0].get_xscale() == scale
    runs[0] = make_run(tmp_path / "wide", "rbtm", error=9000.0)
    figure = methods.errors(runs)
    assert figure is not None and figure.axes[0].get_xscale() == "symlog"


def test_backend_none_is_a_line_and_data_sets_have_their_own_axes(tmp_path: Path):
    runs = [make_run(tmp_path / f"n{i}", "rbtm", "none", error=1800.0) for i in range(2)]
    runs += [make_run(tmp_path / f"b{i}", "rbtm", f"backend{i}") for i in range(5)]
    runs += [make_run(tmp_path / "log", "rbtm", dataset={"path": "aces.clf"})]
    figure = methods.errors(runs)
    assert figure is not None and len(figure.axes) == 6
    assert "no registration" in texts(figure) and "ACES" in texts(figure)
    assert "errors" in stems(plots.draw(runs, tmp_path / "figures"))
    assert methods.errors([make_run(tmp_path / "unknown", error=None)]) is None


def test_a_sweep_with_too_many_settings_has_a_row_a_selector(tmp_path: Path):
    runs = [
        make_run(tmp_path / f"{i}", "rbtm", error=5.0 + i, settings={"window": i + 2})
        for i in range(60)
    ]
    figure = methods.errors(runs)
    assert figure is not None and figure.get_figheight() < 11
    assert "RBTM (60 settings)" in texts(figure)


# --- words


def test_names_that_are_alike_get_their_parents(tmp_path: Path):
    runs = [make_run(tmp_path / a / b / "0") for a in "xy" for b in "pq"]
    runs += [make_run(tmp_path / "x" / "other")]
    stem_of = labels.stems(runs)
    assert [stem_of[run] for run in runs] == ["x-p-0", "x-q-0", "y-p-0", "y-q-0", "other"]


@pytest.mark.parametrize(
    ("number", "unit", "text"),
    [
        (25.91, "mm", "25.9 mm"),
        (61753, "mm", "61.8 m"),
        (-0.5, "deg", "−0.5°"),
        (1260, "mm", "1260 mm"),
    ],
)
def test_quantities_have_three_digits_and_a_fitting_unit(number: float, unit: str, text: str):
    assert labels.quantity(number, unit).replace("\N{NO-BREAK SPACE}", " ") == text


def test_titles_break_into_lines_that_fit():
    with style.paper():
        text = style.wrapped(f"one two\n{'word ' * 30}{'a-long-name-' * 12}$x$", 3.4)
        assert all(style.inches(line) <= 3.4 for line in text.splitlines())
    assert text.startswith("one two\n") and r"\$x\$" in text.replace("\n", "")


def test_steps_of_an_older_version_are_drawn_without_localizability(tmp_path: Path) -> None:
    run = make_run(tmp_path / "old")
    path = run.path / "steps.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["localizability_min"]), path)
    table = folder.read_steps(run)
    assert table is not None and np.isnan(table.held).all() and len(table.scan) > 1
    assert steps.gaps(run) is not None
