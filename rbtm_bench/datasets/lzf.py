"""LZF, the compression of PCD files (binary_compressed)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.kernels import kernel

BEST_RATIO = 90
"""Bytes that a packed byte may stand for: three bytes copy 264."""


def unpack(packed: bytes, size: int) -> NDArray[np.uint8] | None:
    """The ``size`` bytes that were packed, None if ``packed`` does not unpack to just these."""
    if size > BEST_RATIO * len(packed) + BEST_RATIO:
        return None
    out = np.empty(size, np.uint8)
    return out if _unpack(np.frombuffer(packed, np.uint8), out) else None


@kernel
def _unpack(packed: NDArray[np.uint8], out: NDArray[np.uint8]) -> bool:
    at, to, end, size = 0, 0, len(packed), len(out)
    while at < end:
        control = int(packed[at])
        at += 1
        if control < 32:  # that many bytes and one more as they are
            count = control + 1
            if at + count > end or to + count > size:
                return False
            for _ in range(count):
                out[to] = packed[at]
                at += 1
                to += 1
            continue
        count = control >> 5
        if count == 7:
            if at >= end:
                return False
            count += int(packed[at])
            at += 1
        if at >= end:
            return False
        back = to - ((control & 31) << 8) - int(packed[at]) - 1
        at += 1
        count += 2
        if back < 0 or to + count > size:
            return False
        for _ in range(count):  # byte by byte: what is copied may overlap where it goes
            out[to] = out[back]
            back += 1
            to += 1
    return to == size
