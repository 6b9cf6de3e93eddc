"""The file with the error of every relation."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import se2
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.datasets.base import Relations
from rbtm_bench.metrics.relation_errors import RelationErrors
from rbtm_bench.metrics.relations import RelationError


def test_errors_by_hand() -> None:
    """A straight path of 1 m a second, 3 m of it known as 2.5 m, a turn that was not made."""
    stamps = np.arange(100.0)
    estimate = Trajectory(stamps, np.stack([se2(t, 0, 0) for t in stamps]))
    motions = np.stack([se2(2.5, 0, 0), se2(90, 0, np.pi / 2), se2(1, 0, 0)])
    relations = Relations(np.array([1.0, 2, 98]), np.array([4.0, 92, 99.5]), motions)
    errors = RelationError().errors(estimate, relations)
    assert errors.translation_m[:2] == pytest.approx([0.5, 0.0])
    assert errors.rotation_deg[:2] == pytest.approx([0.0, 90.0])
    assert np.isnan(errors.translation_m[2]) and np.isnan(errors.rotation_deg[2])  # no 99.5 s
    assert errors.local.tolist() == [True, False, True]
    assert errors.used.tolist() == [True, True, False]
    values = RelationError().evaluate(estimate, None, relations)
    assert values["relations_translation_mean_m"] == pytest.approx(0.25)
    assert values["relations_long_rotation_mean_deg"] == pytest.approx(90.0)
    assert values["relations_local_used"] == 1 and values["relations_local_total"] == 2


def test_the_file_reads_back(tmp_path: Path) -> None:
    missing = np.array([0.1, np.nan, 1 / 3])
    times = np.array([1125.000001, 2.0, 3.0])
    errors = RelationErrors(times, times + 60, np.array([True, False, True]), missing, missing)
    errors.write(tmp_path / "relations.parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["relations.parquet"]
    read = RelationErrors.read(tmp_path / "relations.parquet")
    for name in ("start", "end", "local"):
        assert np.array_equal(getattr(read, name), getattr(errors, name))
    for name in ("translation_m", "rotation_deg"):
        assert np.array_equal(getattr(read, name), getattr(errors, name), equal_nan=True)
    table = pq.read_table(tmp_path / "relations.parquet")
    assert table["translation_m"].null_count == 1  # for other readers: missing, not NaN


def test_damaged_files(tmp_path: Path) -> None:
    path = tmp_path / "relations.parquet"
    with pytest.raises(DataError, match=r"relations\.parquet: cannot be read: No such file"):
        RelationErrors.read(path)
    path.write_bytes(b"PAR1 and then nothing")
    with pytest.raises(DataError, match="not a readable table"):
        RelationErrors.read(path)
    pq.write_table(pa.table({"start": [1.0]}), path)
    with pytest.raises(DataError, match="cannot be read"):
        RelationErrors.read(path)


def test_a_run_keeps_what_its_means_are_made_of(data_dir: Path, tmp_path: Path) -> None:
    log = data_dir / "freiburg" / "mit-csail"
    out = tmp_path / "run"
    words = [f"dataset.path={log}.clf.gz", f"dataset.relations={log}.relations"]
    words += ["dataset=carmen", "backend=none", "selector=previous", "pictures=false"]
    assert main(["run", *words, "dataset.max_scans=1200", "pin=false", f"out='{out}'"]) == 0
    metrics = json.loads((out / "metrics.json").read_text())
    errors = RelationErrors.read(out / "relations.parquet")
    assert len(errors) == metrics["relations_total"] == 1172
    assert errors.used.sum() == metrics["relations_used"] < 1172
    long = errors.used & ~errors.local
    assert errors.translation_m[errors.used].mean() == metrics["relations_translation_mean_m"]
    assert errors.rotation_deg[long].mean() == metrics["relations_long_rotation_mean_deg"]
    assert main(["run", "dataset.scans=5", "backend=none", f"out='{out}'", "overwrite=true"]) == 0
    assert not (out / "relations.parquet").exists()  # an earlier run's are not this one's
