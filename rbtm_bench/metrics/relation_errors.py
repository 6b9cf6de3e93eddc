"""The error of every reference relation of a run: what its mean and spread are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rbtm_bench.core.bounded import read_parquet
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.files import write_atomically
from rbtm_bench.core.trajectory import Mask
from rbtm_bench.core.types import Array

FILE = "relations.parquet"
COLUMNS = ("start", "end", "local", "translation_m", "rotation_deg")


@dataclass(frozen=True, eq=False)
class RelationErrors:
    """The relations of a data set (R,), in its order, with their errors.

    ``start`` and ``end`` in s; ``local``: the ends are close in time; errors in m and deg, NaN
    where an end has no estimated pose.
    """

    start: Array
    end: Array
    local: Mask
    translation_m: Array
    rotation_deg: Array

    def __len__(self) -> int:
        return len(self.start)

    @property
    def used(self) -> Mask:
        """(R,) which of them have an error."""
        return ~np.isnan(self.translation_m)

    def write(self, path: Path) -> None:
        """A parquet file, a row a relation; an error that does not exist is null."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        columns = {name: pa.array(getattr(self, name), from_pandas=True) for name in COLUMNS}
        table = pa.table(columns)
        write_atomically(path, lambda p: pq.write_table(table, p, compression="zstd"))

    @classmethod
    def read(cls, path: Path) -> RelationErrors:
        """Read it back. Raises ``DataError`` for a file that is missing or damaged."""
        try:
            table = read_parquet(path, COLUMNS)
            columns = {name: table[name].to_numpy() for name in COLUMNS}
            local = columns.pop("local").astype(bool)
            return cls(local=local, **{k: v.astype(np.float64) for k, v in columns.items()})
        except (KeyError, TypeError, ValueError) as error:
            text = " ".join(str(error).split()) or type(error).__name__
            raise DataError(f"{path}: errors of relations cannot be read: {text}") from error
