"""``steps.parquet``: a row a scan.

Its columns are made of buffers: pyarrow would import pandas to look at a list or a numpy array,
which takes longer than a short run.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from rbtm_bench.core.files import write_atomically
from rbtm_bench.core.step_columns import STEPS
from rbtm_bench.core.types import StepTable


def write_steps(path: Path, steps: StepTable) -> None:
    """Write the columns of ``STEPS``; None is a missing value. Raises ``WriteError``."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = [_column(steps[column.name], column.type) for column in STEPS]
    table = pa.Table.from_arrays(columns, names=[column.name for column in STEPS])
    write_atomically(path, lambda p: pq.write_table(table, p))


def _column(values: Any, kind: str) -> Any:
    """The arrow array of values of one of the kinds of ``StepColumn``."""
    import pyarrow as pa

    there = [value is not None for value in values]
    mask = None if all(there) else _bits(there)
    if kind in ("int", "float"):
        given = np.asarray(values)
        if mask is not None:
            given = np.array([0 if value is None else value for value in values])
        plain = given.astype(f"{kind}64")
        if kind == "int" and (plain != given).any():
            raise ValueError("a step's count is no whole number")
        type_ = pa.int64() if kind == "int" else pa.float64()
        return pa.Array.from_buffers(type_, len(values), [mask, pa.py_buffer(plain)])
    if kind == "bool":
        return pa.Array.from_buffers(pa.bool_(), len(values), [mask, _bits(values)])
    items: list[Any] = [() if value is None else value for value in values]
    if kind == "str":
        items = [str(item or "").encode() for item in items]
    ends = pa.py_buffer(np.array([0, *accumulate(map(len, items))], dtype=np.int32))
    if kind == "str":
        buffers = [mask, ends, pa.py_buffer(b"".join(items))]
        return pa.Array.from_buffers(pa.string(), len(values), buffers)
    inner = _column(np.concatenate([np.zeros(0), *items]), "float")
    type_ = pa.list_(pa.float64())
    return pa.Array.from_buffers(type_, len(values), [mask, ends], children=[inner])


def _bits(values: Sequence[Any]) -> Any:
    """Truth values as arrow packs them."""
    import pyarrow as pa

    return pa.py_buffer(np.packbits(np.array(values, dtype=bool), bitorder="little"))
