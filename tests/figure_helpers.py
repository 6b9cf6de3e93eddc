"""Small run folders for the tests of figures, and what is read off a figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.text import Text

from rbtm_bench.core.files import write_json, write_text
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.plots import groups
from rbtm_bench.runs import stored

N = 21
TURN = np.stack([se2(min(i, 10) * 0.1, max(i - 10, 0) * 0.1, 0.0) for i in range(N)])
"""1 m along x, then 1 m along y."""


def make_run(
    path: Path,
    selector: str = "rbtm",
    backend: str = "p2p",
    seed: int = 0,
    *,
    error: float | None = 10.0,
    ms: float | None = 1.0,
    poses: Array = TURN,
    truth: Array | None = TURN,
    align: str = "origin",
    data: dict[str, Any] | None = None,
    shared: dict[str, Any] | None = None,
    **settings: Any,
) -> stored.Run:
    """The files of a run that these figures are made of; without an error it failed."""
    path.mkdir(parents=True)
    config = {"seed": seed, "dataset": {"environment": "paper", "seed": seed, **(data or {})}}
    config |= {"backend": {}, "selector": settings, "metrics": {"ape": {"align": align}}}
    write_text(path / "config.yaml", json.dumps(config | (shared or {})))
    choices = {"dataset": "corridor", "backend": backend, "selector": selector}
    status = "failed" if error is None else "done"
    write_json(path / "run.json", {"status": status, "choices": choices, "seed": seed})
    if error is not None:
        metrics = {"final_translation_error_mm": error, "ms_per_scan": ms}
        write_json(path / "metrics.json", metrics)
        stamps = 0.5 * np.arange(len(poses))
        Trajectory(stamps, poses).write_tum(path / "trajectory.tum")
        if truth is not None:
            Trajectory(stamps, truth).write_tum(path / "ground_truth.tum")
    return stored.read_run(path)


def scaled(factor: float) -> Array:
    """The turn with its positions multiplied."""
    T = TURN.copy()
    T[:, :3, 3] *= factor
    return T


def data_of(*runs: stored.Run) -> groups.Data:
    (data,) = groups.data_sets(runs)
    return data


def texts(figure: Figure) -> str:
    """All words, in lines of one text each."""
    words = [artist.get_text().replace("\n", " ") for artist in figure.findobj(Text)]
    return "\n".join(words).replace("\N{NO-BREAK SPACE}", " ")


def lines(figure: Figure, panel: int = 0) -> dict[str, Any]:
    """The lines of a panel that have a name."""
    found = figure.axes[panel].lines
    return {str(x.get_label()): x for x in found if not str(x.get_label()).startswith("_")}
