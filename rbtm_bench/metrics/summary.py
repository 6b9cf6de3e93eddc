"""What a run's steps add up to: registrations, rejections, gaps, time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rbtm_bench.core.columns import DEGENERATE, family
from rbtm_bench.core.types import StepTable
from rbtm_bench.metrics import cost
from rbtm_bench.metrics.base import Values

COLUMNS = {**family("steps"), **cost.COLUMNS}

REGISTERED = ("registered", "fallback")
"""The statuses of a scan whose pose a registration gave."""


def summarise_steps(steps: StepTable, peak_memory_mb: float | None = None) -> Values:
    """The keys of ``COLUMNS``; a mean over nothing is None."""
    status = steps["status"]
    registered = [i for i, s in enumerate(status) if s in REGISTERED]

    def of_registered(name: str) -> list[float]:
        column = steps[name]
        return [column[i] for i in registered if column[i] is not None]

    held, gaps = of_registered("localizability_min"), of_registered("gap")
    fitness, reused = of_registered("fitness"), of_registered("reused")
    return {
        "coverage": len(registered) / (len(steps) - 1) if len(steps) > 1 else None,
        "registrations": sum(steps["registrations"]),
        "rejected": sum(steps["rejected"]),
        "fallbacks": status.count("fallback"),
        "skipped": status.count("skipped"),
        "longest_skip": _longest_skip(status),
        "restarts": sum(steps["restart"]),
        "undefined_scores": sum(steps["undefined_scores"]),
        "reused": float(np.mean(reused)) if reused else None,
        "mean_gap": float(np.mean(gaps)) if gaps else None,
        "mean_fitness": float(np.mean(fitness)) if fitness else None,
        "localizability": float(np.median(held)) if held else None,
        "degenerate": float(np.mean(np.array(held) < DEGENERATE)) if held else None,
        **cost.cost(steps, peak_memory_mb),
    }


def _longest_skip(status: Sequence[str]) -> int:
    """The most scans in a row, the first scan aside, whose pose is a prediction."""
    longest = current = 0
    for one in status[1:]:
        current = 0 if one in REGISTERED else current + 1
        longest = max(longest, current)
    return longest
