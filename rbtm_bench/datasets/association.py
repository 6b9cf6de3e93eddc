"""What belongs together by time, and what times say of themselves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.types import Array


def nearest(stamps: Array, times: Array, tolerance_s: float) -> NDArray[np.intp]:
    """Index (R,) of the stamp (N,) nearest to each time (R,), -1 if none is within tolerance.

    ``stamps`` (s) in any order; of several equally near the earlier, then the first, is taken.
    """
    missing = np.full(len(times), -1, dtype=np.intp)
    if len(stamps) == 0:
        return missing
    order = np.argsort(stamps, kind="stable")
    ordered = stamps[order]
    after = np.searchsorted(ordered, times).clip(max=len(stamps) - 1)
    before = (after - 1).clip(min=0)
    # Equal stamps sort as they came: step to the first of those before.
    before = np.searchsorted(ordered, ordered[before])
    best = np.where(
        np.abs(ordered[before] - times) <= np.abs(ordered[after] - times), before, after
    )
    return np.where(np.abs(ordered[best] - times) <= tolerance_s, order[best], missing)


def span(stamps: Array) -> str:
    """First and last time, in words."""
    return f"{stamps.min():.3f} to {stamps.max():.3f} s"


def time_suspicions(stamps: Array, what: str = "scans") -> list[str]:
    """Steps back, repeated and whole-second stamps, a line each."""
    words = []
    back = int(np.count_nonzero(np.diff(stamps) < 0))
    if back:
        words.append(f"time steps back {back} times from {what[:-1]} to {what[:-1]}")
    repeated = len(stamps) - len(np.unique(stamps))
    if repeated:
        words.append(f"{repeated} of {len(stamps)} {what} repeat another one's stamp")
    if len(stamps) > 2 and repeated and np.array_equal(stamps, np.round(stamps)):
        words.append(f"the stamps of all {what} are whole seconds")
    return words
