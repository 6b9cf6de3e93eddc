"""steps.parquet holds what pyarrow itself makes of the records."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rbtm_bench.core.step_columns import STEPS
from rbtm_bench.core.types import StepRecord, StepTable
from rbtm_bench.runs.steps import write_steps

KINDS = {
    "int": pa.int64(),
    "float": pa.float64(),
    "str": pa.string(),
    "bool": pa.bool_(),
    "list": pa.list_(pa.float64()),
}
FULL = {
    "int": lambda n: n - 3,
    "float": lambda n: [math.pi, -0.0, math.nan, math.inf][n % 4],
    "str": lambda n: "größer"[: n % 7],
    "bool": lambda n: n % 3 == 0,
    "list": lambda n: [0.1 * k for k in range(n % 4)],
}


def record(number: int, missing: bool) -> StepRecord:
    made = StepRecord(number, 0.5 * number)
    for place, column in enumerate(STEPS[2:]):
        if not (missing and (place + number) % 2):
            setattr(made, column.name, FULL[column.type](number + place))
    return made


@pytest.mark.parametrize("missing", [False, True])
@pytest.mark.parametrize("count", [1, 8, 21])
def test_the_table_is_pyarrows_own(tmp_path: Path, count: int, missing: bool) -> None:
    records = [record(number, missing) for number in range(count)]
    write_steps(tmp_path / "steps.parquet", StepTable(records))
    table = pq.read_table(tmp_path / "steps.parquet")
    table.validate(full=True)
    schema = pa.schema([(column.name, KINDS[column.type]) for column in STEPS])
    expected = pa.Table.from_pylist([one.as_dict() for one in records], schema=schema)
    assert table.schema == expected.schema
    for name in schema.names:
        ours, theirs = table[name].combine_chunks(), expected[name].combine_chunks()
        assert ours.null_count == theirs.null_count, name
        assert repr(ours.to_pylist()) == repr(theirs.to_pylist()), name  # NaN and -0.0 too


def test_numbers_of_numpy_are_taken(tmp_path: Path) -> None:
    made = StepRecord(np.int64(3), np.float64(0.25))
    made.converged = np.bool_(True)
    write_steps(tmp_path / "steps.parquet", StepTable([made]))
    row = pq.read_table(tmp_path / "steps.parquet").to_pylist()[0]
    assert (row["scan"], row["stamp"], row["converged"]) == (3, 0.25, True)


def test_half_a_count_is_refused(tmp_path: Path) -> None:
    made = StepRecord(0, 0.0)
    made.iterations = 2.5  # type: ignore[assignment]
    with pytest.raises(ValueError, match="no whole number"):
        write_steps(tmp_path / "steps.parquet", StepTable([made]))


def test_pandas_stays_away(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; "
        "from rbtm_bench.core.types import StepRecord, StepTable; "
        "from rbtm_bench.runs.steps import write_steps; "
        f"write_steps(Path({str(tmp_path / 'steps.parquet')!r}), StepTable([StepRecord(0, 0.0)])); "
        "sys.exit('pandas' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
