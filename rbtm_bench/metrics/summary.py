"""What a run's steps add up to: registrations, rejections, gaps, time."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from rbtm_bench.core.columns import DEGENERATE, family
from rbtm_bench.core.step_columns import DECIDED, PICKS
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

    asked = len(steps) - 1 - status.count("still")
    held, gaps = of_registered("localizability_min"), of_registered("gap")
    fitness, reused = of_registered("fitness"), of_registered("reused")
    return {
        "coverage": len(registered) / asked if asked > 0 else None,
        "registrations": sum(steps["registrations"]),
        "rejected": sum(steps["rejected"]),
        "still": status.count("still"),
        "recovered": sum(bool(name) for name in steps["recovered"]),
        "fallbacks": status.count("fallback"),
        "skipped": status.count("skipped"),
        "longest_skip": _longest_skip(status),
        "restarts": sum(steps["restart"]),
        **_picks(steps["pick"]),
        "undefined_scores": sum(steps["undefined_scores"]),
        "reused": float(np.mean(reused)) if reused else None,
        "mean_gap": float(np.mean(gaps)) if gaps else None,
        "mean_fitness": float(np.mean(fitness)) if fitness else None,
        "localizability": float(np.median(held)) if held else None,
        "degenerate": float(np.mean(np.array(held) < DEGENERATE)) if held else None,
        **cost.cost(steps, peak_memory_mb),
    }


def why_unregistered(steps: StepTable) -> str:
    """The most frequent reason of the scans without a registration, numbers aside, by example."""
    where = zip(steps["status"][1:], steps["reason"][1:], strict=True)
    reasons = [
        reason for status, reason in where if status not in (*REGISTERED, "still") and reason
    ]
    kinds = [re.sub(r"[\d.]+", "0", reason) for reason in reasons]
    return reasons[kinds.index(max(kinds, key=kinds.count))] if reasons else ""


def _picks(first: Sequence[str]) -> Values:
    """Shares of the first picks, and of those that the threshold decided; None without any."""
    known = [pick for pick in first if pick]
    shares = {f"pick_{name}": known.count(name) / len(known) if known else None for name in PICKS}
    decided = sum(pick in DECIDED for pick in known)
    return {**shares, "decided": decided / len(known) if known else None}


def _longest_skip(status: Sequence[str]) -> int:
    """The most scans in a row, the first scan aside, whose pose is a prediction."""
    longest = current = 0
    for one in status[1:]:
        if one != "still":
            current = 0 if one in REGISTERED else current + 1
        longest = max(longest, current)
    return longest
