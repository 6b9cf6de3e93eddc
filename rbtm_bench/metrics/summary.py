"""What a run's steps add up to: registrations, rejections, gaps, time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rbtm_bench.core.types import StepRecord
from rbtm_bench.metrics import cost
from rbtm_bench.metrics.base import Values
from rbtm_bench.odometry.degeneracy import DEGENERATE

COLUMNS = {
    "coverage": "share; scans with an accepted registration over all scans but the first; steps",
    "registrations": "count; calls of the backend, rejected ones included; steps",
    "rejected": "count; registrations that the check or the backend refused; steps",
    "fallbacks": "count; scans registered to the fallback; steps",
    "skipped": "count; scans left at their predicted pose by fallback=skip; steps",
    "longest_skip": "scans; most scans in a row without an accepted registration; steps",
    "restarts": "count; scans matched to an unmatched one before, after too many of them; steps",
    "undefined_scores": "count; similarities that were undefined (NaN); steps",
    "reused": "share; accepted registrations that were taken from memory or the pair store; steps",
    "mean_gap": "scans; mean of scan - model over registered scans; steps",
    "mean_fitness": "share; mean fitness over registered scans; our evaluator",
    "localizability": "share; median of the smallest eigenvalue over registered scans; evaluator",
    "degenerate": f"share; registered scans whose smallest eigenvalue is < {DEGENERATE}; evaluator",
    **cost.COLUMNS,
}


def summarise_steps(records: Sequence[StepRecord], peak_memory_mb: float | None = None) -> Values:
    """The keys of ``COLUMNS``; a mean over nothing is None."""
    registered = [r for r in records if r.status in ("registered", "fallback")]
    held = [r.localizability_min for r in registered if r.localizability_min is not None]
    gaps = [r.gap for r in registered if r.gap is not None]
    fitness = [r.fitness for r in registered if r.fitness is not None]
    reused = [r.reused for r in registered if r.reused is not None]
    return {
        "coverage": len(registered) / (len(records) - 1) if len(records) > 1 else None,
        "registrations": sum(r.registrations for r in records),
        "rejected": sum(r.rejected for r in records),
        "fallbacks": sum(r.status == "fallback" for r in records),
        "skipped": sum(r.status == "skipped" for r in records),
        "longest_skip": _longest_skip(records),
        "restarts": sum(r.restart for r in records),
        "undefined_scores": sum(r.undefined_scores for r in records),
        "reused": float(np.mean(reused)) if reused else None,
        "mean_gap": float(np.mean(gaps)) if gaps else None,
        "mean_fitness": float(np.mean(fitness)) if fitness else None,
        "localizability": float(np.median(held)) if held else None,
        "degenerate": float(np.mean(np.array(held) < DEGENERATE)) if held else None,
        **cost.cost(records, peak_memory_mb),
    }


def _longest_skip(records: Sequence[StepRecord]) -> int:
    """The most scans in a row, the first scan aside, whose pose is a prediction."""
    longest = here = 0
    for record in records[1:]:
        here = 0 if record.status in ("registered", "fallback") else here + 1
        longest = max(longest, here)
    return longest
