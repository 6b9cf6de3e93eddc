"""Figures of paths and of the error along them: what is drawn, and of which runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from figure_helpers import TURN, N, data_of, lines, make_run, scaled, texts

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.metrics.ape import Ape
from rbtm_bench.metrics.relation_errors import FILE, RelationErrors
from rbtm_bench.plots import groups, growth, looks, spans, style, trajectories
from rbtm_bench.runs.stored import Run

# --- runs by data set, backend and method


def test_methods_gather_their_seeds_and_count_failures(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / f"r{seed}", seed=seed, window=4) for seed in (2, 1)]
    runs += [make_run(tmp_path / "bad", seed=3, window=4, error=None)]
    runs += [make_run(tmp_path / "w8", window=8), make_run(tmp_path / "p", "previous", "gicp")]
    runs += [make_run(tmp_path / "n", "previous", "none")]
    data = data_of(*runs)
    assert (data.stem, data.name) == ("corridor", "Corridor")
    assert [panel.name for panel in data.panels] == ["gicp", "p2p"]
    four, eight = data.panels[1].methods
    assert four.runs == [runs[1], runs[0]] and four.failed == 1
    assert eight.runs == [runs[3]] and data.guess is runs[5]
    assert list(data.methods.values()) == ["previous", "rbtm", "rbtm"]


def test_settings_outside_every_group_make_methods_of_their_own(tmp_path: Path) -> None:
    runs = [
        make_run(tmp_path / str(share), "previous", shared={"guess_along_degenerate": share})
        for share in (None, 0.01)
    ]
    names = [method.name for method in data_of(*runs).panels[0].methods]
    assert names == [
        "Previous (guess\N{NO-BREAK SPACE}along\N{NO-BREAK SPACE}degenerate\N{NO-BREAK SPACE}None)",
        "Previous (guess\N{NO-BREAK SPACE}along\N{NO-BREAK SPACE}degenerate\N{NO-BREAK SPACE}0.01)",
    ]


def test_of_many_settings_lines_show_the_first_of_every_selector(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / f"w{w}", window=w, error=20.0 - w) for w in range(2, 8)]
    data = data_of(*runs)
    assert data.few() == (data, "")
    data = data_of(*runs, make_run(tmp_path / "x", "previous", error=30.0))
    few, note = data.few()
    assert [m.runs[0] for m in few.panels[0].methods] == [data.runs[-1], runs[0], runs[-1]]
    assert note == "of several settings of a strategy the first, and the best of all"
    (figure,) = trajectories.draw(data)
    assert note in texts(figure)


def test_logs_are_named_by_their_files(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / name, data={"path": f"logs/{name}.clf.gz"}) for name in "ab"]
    named = groups.data_sets(runs)
    assert [data.stem for data in named] == ["corridor-a", "corridor-b"]
    assert [data.name for data in named] == ["a", "b"]


def test_methods_differ_without_colour() -> None:
    known = [*looks.SELECTORS.values(), *looks.OTHERS]
    for attribute in ("line", "marker"):
        words = [str(getattr(look, attribute)) for look in known]
        assert len(set(words)) == len(words)
    shapes = [(str(look.dashes), look.width) for look in looks.SELECTORS.values()]
    assert len(set(shapes)) == len(shapes)
    several = looks.looks({"a": "rbtm", "b": "rbtm", "c": "previous", "d": "mine"})
    assert several["a"] is looks.SELECTORS["rbtm"] and several["c"] is looks.SELECTORS["previous"]
    assert len({look.marker for look in several.values()}) == 4


def test_a_backend_has_one_colour_and_clashes_a_free_one() -> None:
    own = looks.colours(["mine", "plicp", "open3d_p2plane", "plicp"])
    assert own["plicp"] == looks.BACKENDS["plicp"] and len(set(own.values())) == 3
    assert looks.colours(["mine", "plicp"])["plicp"] == own["plicp"]
    assert len(looks.colours(map(str, range(20)))) == 20


def test_every_backend_of_ours_has_a_colour() -> None:
    from rbtm_bench.runs.settings import members

    assert set(looks.BACKENDS) <= set(members("backend"))


# --- trajectories


def test_paths_lie_upon_the_truth_from_the_same_first_pose(tmp_path: Path) -> None:
    moved = se2(5.0, 6.0, np.pi / 2)
    runs = [
        make_run(tmp_path / "p", "previous", poses=scaled(0.9), truth=moved @ TURN),
        make_run(tmp_path / "r", poses=scaled(1.1), truth=moved @ TURN, window=4),
        make_run(tmp_path / "n", "previous", "none", poses=scaled(0.5)),
    ]
    (figure,) = trajectories.draw(data_of(*runs))
    (ax,) = figure.axes
    drawn = lines(figure)
    for name, factor in (("Previous", 0.9), ("RBTM (window\N{NO-BREAK SPACE}4)", 1.1)):
        assert np.allclose(drawn[name].get_xydata(), scaled(factor)[:, :2, 3])
    truth = next(line for line in ax.lines if line.get_linewidth() == looks.TRUTH["lw"])
    assert np.allclose(truth.get_xydata(), TURN[:, :2, 3])
    assert truth.get_zorder() < min(line.get_zorder() for line in drawn.values())
    guess = next(line for line in ax.lines if line.get_color() == looks.GUESS["color"])
    assert np.allclose(guess.get_xydata(), scaled(0.5)[:, :2, 3])
    assert (ax.get_xlabel(), ax.get_ylabel(), ax.get_aspect()) == ("x (m)", "y (m)", 1.0)
    assert {"ground truth", "no registration", "start"} <= set(texts(figure).split("\n"))


def test_a_flat_path_keeps_its_proportions(tmp_path: Path) -> None:
    straight = np.stack([se2(0.1 * i, 0.001 * i, 0.0) for i in range(N)])
    truth = np.stack([se2(0.1 * i, 0.0, 0.0) for i in range(N)])
    runs = [make_run(tmp_path / s, s, poses=straight, truth=truth) for s in ("previous", "rbtm")]
    (figure,) = trajectories.draw(data_of(*runs))
    (ax,) = figure.axes
    assert ax.get_aspect() == 1.0 and "stretched" not in texts(figure)
    assert 0.15 < np.ptp(ax.get_ylim()) / np.ptp(ax.get_xlim()) < 0.3  # still a panel


def test_a_lost_path_does_not_decide_the_view_and_ends_at_its_border(tmp_path: Path) -> None:
    lost = np.stack([se2(1.3**i - 1, 0.0, 0.0) for i in range(N)])
    runs = [
        make_run(tmp_path / "p", "previous", poses=lost, truth=TURN),
        make_run(tmp_path / "r", poses=scaled(1.05), truth=TURN),
    ]
    (figure,) = trajectories.draw(data_of(*runs))
    x0, x1 = figure.axes[0].get_xlim()
    assert -0.5 < x0 < 0 and 1.05 < x1 < 1.5
    drawn = lines(figure)["Previous"].get_xdata()
    assert len(drawn) == 4 and (drawn[:-1] < x1).all() and drawn[-1] > x1
    assert "leave the view: Previous" in texts(figure)


def test_paths_are_of_the_lowest_seed_that_all_methods_have(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / f"p{s}", "previous", seed=s, poses=scaled(s)) for s in (1, 2, 3)]
    runs += [make_run(tmp_path / f"r{s}", seed=s, poses=scaled(s)) for s in (2, 3, 4)]
    (figure,) = trajectories.draw(data_of(*runs))
    assert "seed 2" in texts(figure)
    for line in lines(figure).values():
        assert np.allclose(line.get_xydata(), scaled(2)[:, :2, 3])
    assert not list(trajectories.draw(data_of(runs[0])))  # a single method: its map shows more


def test_many_backends_have_equal_panels_and_pages(tmp_path: Path) -> None:
    runs = [
        make_run(tmp_path / f"{s}{b}", s, f"backend{b:02d}")
        for b in range(11)
        for s in ("previous", "rbtm")
    ]
    figures = list(trajectories.draw(data_of(*runs)))
    assert len(figures) > 1
    assert sum(len(figure.axes) for figure in figures) == 11
    assert all(figure.get_figheight() <= style.TALLEST + 0.5 for figure in figures)
    assert len({ax.get_xlim() + ax.get_ylim() for figure in figures for ax in figure.axes}) == 1


# --- error over the path


def test_the_error_over_the_path_is_what_the_metric_sums_up(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    poses = TURN.copy()
    poses[:, :2, 3] += rng.normal(0, 0.02, (N, 2))
    for align in ("origin", "umeyama", "none"):
        run = make_run(tmp_path / align, poses=poses, align=align)
        (figure,) = growth.draw(data_of(run))
        (line,) = lines(figure).values()
        stamps = np.arange(N, dtype=float)
        metric = Ape(align).evaluate(Trajectory(stamps, poses), Trajectory(stamps, TURN))
        x, y = line.get_data()
        assert np.sqrt(np.mean(y**2)) == pytest.approx(1e3 * metric["ape_rmse_m"])
        assert np.allclose(x, 0.1 * np.arange(N))
        assert growth.ALIGNED[align] in texts(figure)
    (ax,) = figure.axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("true path (m)", "position error (mm)")


def test_lines_are_medians_and_bands_hold_all_seeds(tmp_path: Path) -> None:
    factors = (1.1, 1.2, 1.5)
    runs = [make_run(tmp_path / str(f), seed=s, poses=scaled(f)) for s, f in enumerate(factors)]
    (figure,) = growth.draw(data_of(*runs))
    (line,) = lines(figure).values()
    away = np.linalg.norm(TURN[:, :2, 3], axis=1)
    assert np.allclose(line.get_ydata(), 1e3 * 0.2 * away)
    (band,) = figure.axes[0].collections
    corners = band.get_paths()[0].vertices[:, 1]
    assert corners.max() == pytest.approx(1e3 * 0.5 * away.max())
    assert "median of 3 seeds" in texts(figure) and "smallest to largest" in texts(figure)
    runs += [make_run(tmp_path / f"w{w}", window=w) for w in (2, 3, 4)]
    (figure,) = growth.draw(data_of(*runs))  # four methods: bands would not stay distinct
    assert not figure.axes[0].collections and "smallest to largest" not in texts(figure)


def test_errors_far_apart_have_a_log_axis_and_large_ones_metres(tmp_path: Path) -> None:
    runs = [make_run(tmp_path / "p", "previous", poses=scaled(1.5)), make_run(tmp_path / "r")]
    runs[1] = make_run(tmp_path / "s", poses=scaled(1.1))
    (figure,) = growth.draw(data_of(*runs))
    assert figure.axes[0].get_yscale() == "linear" and figure.axes[0].get_ylim()[0] == 0
    runs.append(make_run(tmp_path / "k", "keyframe", poses=scaled(11.0)))
    (figure,) = growth.draw(data_of(*runs))
    (ax,) = figure.axes
    assert ax.get_yscale() == "log" and ax.get_ylabel() == "position error (m)"
    assert ax.get_ylim()[0] == pytest.approx(0.1 * 0.1 * np.sqrt(2))


def test_no_motion_is_drawn_over_time_and_no_truth_not_at_all(tmp_path: Path) -> None:
    still = np.tile(np.eye(4), (N, 1, 1))
    (figure,) = growth.draw(data_of(make_run(tmp_path / "still", poses=scaled(0.1), truth=still)))
    (line,) = lines(figure).values()
    assert figure.axes[0].get_xlabel() == "time (s)"
    assert np.allclose(line.get_xdata(), 0.5 * np.arange(N))
    assert not list(growth.draw(data_of(make_run(tmp_path / "blind", truth=None))))
    short = make_run(tmp_path / "short", truth=TURN)
    Trajectory(np.arange(3.0), TURN[:3]).write_tum(short.path / "ground_truth.tum")
    with pytest.raises(DataError, match=r"ground_truth.tum: 3 poses, expected 21"):
        list(growth.draw(data_of(short)))


def test_replicates_that_begin_elsewhere_are_binned_along_the_path(tmp_path: Path) -> None:
    """They have fewer scans; every one of them counts, over what all of them drove."""
    long = np.stack([se2(0.01 * i, 0.0, 0.0) for i in range(200)])
    runs = []
    for number, skipped in enumerate((0, 3, 9)):
        truth = long[skipped:]
        off = truth.copy()
        off[1:, 1, 3] += 0.1 * (number + 1)
        runs.append(make_run(tmp_path / str(number), seed=number, poses=off, truth=truth))
    (figure,) = growth.draw(data_of(*runs))
    (line,) = lines(figure).values()
    x, y = line.get_data()
    assert len(x) <= growth.BINS and x[-1] < 1.91
    assert np.allclose(y[2:], 200.0) and "median of 3 seeds" in texts(figure)


# --- relation error over span


def with_relations(path: Path, errors: Array, spans_s: Array, selector: str = "rbtm") -> Run:
    run = make_run(path, selector, truth=None)
    local = np.abs(spans_s) <= 30
    RelationErrors(np.zeros(len(errors)), spans_s, local, errors, errors).write(path / FILE)
    return run


def test_relations_are_binned_by_span_local_and_long_apart(tmp_path: Path) -> None:
    spans_s = np.concatenate([np.full(20, 1.0), np.full(20, -9.0), np.full(25, 3600.0)])
    errors = np.concatenate([np.full(20, 0.01), np.full(20, 0.03), np.full(25, 2.0)])
    errors[-1] = np.nan  # an end without a pose: not used
    curve = spans.curve(with_relations(tmp_path / "r", errors, spans_s))
    assert curve is not None
    assert curve.span.tolist() == [1.0, 9.0, 3600.0]
    assert curve.error.tolist() == [0.01, 0.03, 2.0]


def test_relation_errors_are_drawn_with_the_guess(tmp_path: Path) -> None:
    spans_s = np.linspace(1.0, 20.0, 40)
    runs = [
        with_relations(tmp_path / "a", np.full(40, 0.1), spans_s),
        with_relations(tmp_path / "b", np.full(40, 0.2), spans_s, "previous"),
    ]
    (figure,) = spans.draw(data_of(*runs))
    drawn = lines(figure)
    assert [drawn[name].get_ydata().tolist() for name in ("RBTM", "Previous")] == [
        [0.1, 0.1],
        [0.2, 0.2],
    ]
    assert "relation error (m)" in texts(figure) and "local up to 30 s" in texts(figure)


def test_few_relations_or_none_are_not_drawn(tmp_path: Path) -> None:
    few = with_relations(tmp_path / "a", np.full(19, 0.1), np.linspace(1, 2, 19))
    assert spans.curve(few) is None
    assert list(spans.draw(data_of(few, make_run(tmp_path / "b", "previous")))) == []


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.5, "0.5 s"), (10, "10 s"), (90, "1.5 min"), (7200, "2 h")]
)
def test_spans_are_told_in_time_s_own_units(seconds: float, words: str) -> None:
    assert spans._time(seconds, 0).replace("\N{NO-BREAK SPACE}", " ") == words
