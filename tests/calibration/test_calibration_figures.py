"""Figures of a calibration: what they say, and with empty and undefined parts."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from rbtm_bench.calibration.analysis import Measured, roc_rows, summary_rows
from rbtm_bench.plots import calibration, style


def measured(score: float | None = None) -> Measured:
    random = np.random.default_rng(0)
    count = 200
    error = 10 ** random.uniform(-3, 0, count)
    pairs = pd.DataFrame(
        {
            "data": 0,
            "target": np.arange(count),
            "source": np.arange(count) + 1,
            "gap": np.arange(count) % 2 + 1,
            "group": np.arange(count) % 2 + 1,
            "kind": np.where(np.arange(count) < 150, "gap", "revisit"),
            "part": np.where(np.arange(count) % 4 < 2, "calibration", "reported"),
            "cluster": np.arange(count) // 10,
            "travelled_m": np.nan,
            "distance_m": random.random(count),
            "rotation_deg": random.random(count),
        }
    )
    outcome = pd.DataFrame({"error_m": error, "error_deg": 0.1, "success": error < 0.1})
    scores = -np.log10(error) / 3 if score is None else np.full(count, score)
    windows = pairs[["data", "target", "source", "group", "part"]]
    return Measured(
        pairs,
        {"one": outcome, "two": outcome.assign(success=error < 0.2)},
        {"mine": scores},
        windows,
        {"mine": scores},
        {"mine": (1e-6, 2e-6)},
    )


def figures(of: Measured) -> dict[str, Figure]:
    rows = [of.pairs.join(o).assign(backend=b) for b, o in of.outcomes.items()]
    with style.paper():
        drawn = calibration.figures(
            pd.concat(rows, ignore_index=True), of.scores, summary_rows(of), roc_rows(of),
            (0.1, 2.0), "a log",
        )  # fmt: skip
        for _, figure in drawn:
            figure.draw_without_rendering()
    return dict(drawn)


def test_titles_and_panels() -> None:
    drawn = figures(measured())
    assert list(drawn) == ["error-mine", "success-mine", "roc_areas-gap", "roc_areas-revisit"]
    assert all(f.get_suptitle().startswith("a log\n") for f in drawn.values())
    error = drawn["error-mine"]
    assert [ax.get_title() for ax in error.axes] == ["one", "two"]
    assert {ax.get_yscale() for ax in error.axes} == {"log"}
    assert error.axes[0].get_ylabel() == "translation error (m)"
    assert [ax.get_title() for ax in drawn["success-mine"].axes] == ["all gaps", "at equal gap"]
    assert [ax.get_title() for ax in drawn["roc_areas-gap"].axes] == ["all gaps", "equal gap"]
    assert [ax.get_title() for ax in drawn["roc_areas-revisit"].axes] == ["revisits"]


def test_a_perfect_score_has_area_one_and_a_line_from_0_to_1() -> None:
    of = measured()
    roc = roc_rows(of).query("backend == 'one' and predictor == 'mine' and part == 'all'")
    np.testing.assert_allclose(roc["auc"], 1.0)
    assert "travelled_m" not in set(roc_rows(of)["predictor"])  # not known: left out
    line = figures(of)["success-mine"].axes[0].lines[0]
    assert line.get_ydata()[0] == 0.0 and line.get_ydata()[-1] == 1.0


@pytest.mark.parametrize("score", [np.nan, 0.5])
def test_scores_that_say_nothing_are_drawn(score: float) -> None:
    of = measured(score)
    drawn = figures(of)
    rows = roc_rows(of).query("predictor == 'mine'")
    np.testing.assert_allclose(rows["auc"], 0.5)
    assert "error-mine" in drawn
    undefined = summary_rows(of).query("gap == 'all' and bin == 'undefined' and backend == 'one'")
    assert undefined["n"].tolist() == ([150, 50] if np.isnan(score) else [])
