"""Reading a page's arrays back, as page/core.js does."""

from __future__ import annotations

import base64
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

DTYPES = {"i8": "<i1", "u8": "<u1", "i16": "<i2", "i32": "<i4", "f32": "<f4"}


def unpacked(packed: dict[str, Any]) -> NDArray[Any]:
    raw = zlib.decompress(base64.b64decode(packed["z"]), -15)
    values = np.frombuffer(raw, DTYPES[packed["t"]]).copy()
    stride = packed["d"]
    if stride:
        for i in range(stride, len(values)):
            values[i : i + 1] += values[i - stride : i - stride + 1]  # arrays wrap in silence
    return values
