"""What a run costs: time a scan and its spread, stage by stage, against the sensor, and memory."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from rbtm_bench.core.columns import family
from rbtm_bench.core.types import StepTable
from rbtm_bench.metrics.base import Values

STAGES = ("prepare", "describe", "guess", "select", "register")
"""What a scan has to go through: their times add up to its time. What is left out is ours: the
check, in which every result is evaluated anew."""

PERCENTILES = (50, 95, 99)

COLUMNS = family("cost")


def cost(steps: StepTable, peak_memory_mb: float | None = None) -> Values:
    """The keys of ``COLUMNS``. Times are None without scans, a stage's where no scan came by."""
    stages = {name: np.array(steps[f"t_{name}_s"], dtype=float) for name in (*STAGES, "check")}
    total = 1e3 * sum((stages[name] for name in STAGES), start=np.zeros(len(steps)))
    mean = float(total.mean()) if len(total) else None
    interval = _interval(steps["stamp"])
    values: Values = {"ms_per_scan": mean}
    for p in PERCENTILES:
        values[f"ms_p{p}"] = float(np.percentile(total, p)) if len(total) else None
    for name, seconds in stages.items():
        values[f"ms_{name}"] = 1e3 * float(seconds.mean()) if seconds.any() else None
    values["real_time_factor"] = 1e3 * interval / mean if interval and mean else None
    values["peak_memory_mb"] = peak_memory_mb
    return values


def peak_memory_mb() -> float | None:
    """The most memory that this process has had resident so far, in MB (10^6 bytes).

    None where the operating system does not say. Linux's ``ru_maxrss`` will not do: a process
    inherits it from the one that started it (measured: 807 MB for a bare Python).
    """
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii", errors="replace")
        kilobytes = next(row.split()[1] for row in status.splitlines() if row.startswith("VmHWM:"))
        return 1024e-6 * int(kilobytes)
    except (OSError, StopIteration):
        pass
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1e-6 if sys.platform == "darwin" else 1024e-6)


def _interval(given: list[float]) -> float | None:
    """The median time between scans in s, None where the stamps do not say: put in order first,
    because there are logs that step back in time."""
    stamps = np.sort(given)
    if len(stamps) < 2 or not np.isfinite(stamps).all():
        return None
    interval = float(np.median(np.diff(stamps)))
    return interval if interval > 0.0 else None
