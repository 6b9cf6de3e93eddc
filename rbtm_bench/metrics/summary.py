"""What a run's steps add up to: registrations, rejections, gaps, time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rbtm_bench.core.columns import DEGENERATE, family
from rbtm_bench.core.types import StepRecord
from rbtm_bench.metrics import cost
from rbtm_bench.metrics.base import Values

COLUMNS = {**family("steps"), **cost.COLUMNS}


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
    longest = current = 0
    for record in records[1:]:
        current = 0 if record.status in ("registered", "fallback") else current + 1
        longest = max(longest, current)
    return longest
