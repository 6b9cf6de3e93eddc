"""Arrays as text in a page: little-endian, deflated, base64. page/core.js unpacks them."""

from __future__ import annotations

import base64
import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

TYPES = {"i8": "u1", "u8": "u1", "i16": "u2", "i32": "u4", "f32": "f4"}
"""Kinds of numbers by their names in the page, and how they are written."""
INT16 = 32767
MISSING = -32768
"""Of a NaN among 16-bit integers."""


def packed(values: ArrayLike, kind: str, stride: int = 0) -> dict[str, Any]:
    """An array as ``{"t": kind, "d": stride, "z": text}``.

    With a ``stride`` integers are written as differences (modulo their size) to the value so
    many places before, which deflates better: points of a scan follow one another.
    """
    flat = np.asarray(values).ravel()
    if kind == "f32":
        data = flat.astype("<f4")
    else:
        signed = flat.astype(np.int64)
        if stride:
            signed[stride:] -= signed[:-stride].copy()
        data = (signed & (2 ** (8 * int(TYPES[kind][1])) - 1)).astype(f"<{TYPES[kind]}")
    press = zlib.compressobj(9, zlib.DEFLATED, -15)
    text = base64.b64encode(press.compress(data.tobytes()) + press.flush()).decode()
    return {"t": kind, "d": stride, "z": text}


def quantised(values: NDArray[Any], scale: float) -> NDArray[np.int16]:
    """Values over ``scale`` as 16-bit integers, ``MISSING`` for NaN."""
    known = np.isfinite(values)
    whole = np.clip(np.round(np.where(known, values, 0.0) / scale), -INT16, INT16)
    return np.where(known, whole, MISSING).astype(np.int16)


def as_script(payload: Any) -> str:
    """JSON that ends no script element and begins no other, whatever its strings hold."""
    text = json.dumps(payload, allow_nan=False, separators=(",", ":"))  # ASCII alone
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")
