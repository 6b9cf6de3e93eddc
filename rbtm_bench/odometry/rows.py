"""What the loop records: each scan's row, and what a block of rows is completed with at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rbtm_bench.core.types import Step, StepRecord
from rbtm_bench.odometry.degeneracy import unseen
from rbtm_bench.selection.base import Selection, Selector, Trial
from rbtm_bench.selection.window import Window


def fill(record: StepRecord, chosen: Trial, reason: str, threshold: float | None) -> None:
    """Write down the registration that a scan got its pose from."""
    candidate, result = chosen.candidate, chosen.result
    record.status = "fallback" if candidate.is_fallback else "registered"
    record.reason, record.recovered = reason, chosen.restart
    record.model, record.gap = candidate.model, record.scan - candidate.model
    record.score = candidate.score
    record.target_scans, record.target_points = chosen.target_scans, chosen.target_points
    record.converged = result.converged
    record.fitness, record.inlier_rmse_m = result.fitness, result.inlier_rmse
    record.iterations, record.reused = result.iterations, result.reused
    record.library_fitness, record.library_rmse_m = result.library_fitness, result.library_rmse
    record.search_seconds, record.search_score = result.search_seconds, result.search_score
    record.search_peak_ratio = result.search_peak_ratio
    if threshold is not None:
        record.kept_guess = unseen(result, threshold)
    if result.information is not None:
        record.information = result.information.ravel()
    record.localizability = result.localizability  # its axes: ``finished``


def first_pick(window: Window, selection: Selection, selector: Selector) -> str:
    """Which member a selector with scores would try first in a full window (one of
    ``step_columns.PICKS``), before any check; "" of any other."""
    members = len(window)
    if not selector.needs_scores or not window.is_full:
        return ""
    if selection.undefined == members:
        return "undefined"
    if not selection.chosen:
        return "none"
    position = window.position(next(iter(selection.candidates)).model)
    return "oldest" if position == 0 else "newest" if position == members - 1 else "middle"


def finished(steps: Sequence[Step]) -> Sequence[Step]:
    """The steps of a block, their rows completed with the axes of all localizabilities."""
    held = [step.record for step in steps if step.record.localizability is not None]
    by_side: dict[int, list[StepRecord]] = {}
    for record in held:
        by_side.setdefault(len(record.localizability.matrix), []).append(record)
    for rows in by_side.values():
        values, vectors = np.linalg.eigh(np.stack([r.localizability.matrix for r in rows]))
        values = np.maximum(values, 0.0)
        for record, smallest, shares, weak in zip(
            rows, values[:, 0].tolist(), values, vectors[:, :, 0], strict=True
        ):
            record.localizability_min = smallest
            record.localizability, record.weak_direction = shares, weak
    return steps
