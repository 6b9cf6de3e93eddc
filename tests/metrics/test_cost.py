"""Times and memory: sums worked out by hand, and what does not exist."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.types import StepRecord, StepTable
from rbtm_bench.metrics.cost import COLUMNS, cost, peak_memory_mb
from rbtm_bench.metrics.summary import summarise_steps


def record(scan: int, stamp: float | None = None, **times_ms: float) -> StepRecord:
    seconds: dict[str, Any] = {f"t_{name}_s": 1e-3 * ms for name, ms in times_ms.items()}
    return StepRecord(scan, 0.1 * scan if stamp is None else stamp, **seconds)


def test_stages_by_hand():
    rows = [
        record(0, prepare=2, describe=1),
        record(1, prepare=2, describe=1, guess=4, select=3, register=10, check=5),
        record(2, prepare=5, describe=1, guess=2, select=0, register=20, check=7),
    ]
    values = cost(StepTable(rows))
    assert list(values) == list(COLUMNS)
    assert values == pytest.approx(
        {
            "ms_per_scan": (3 + 20 + 28) / 3,  # without the check
            "ms_p50": 20.0,
            "ms_p95": 20 + 0.9 * 8,  # linear between the order statistics
            "ms_p99": 20 + 0.98 * 8,
            "ms_prepare": 3.0,
            "ms_describe": 1.0,
            "ms_guess": 2.0,
            "ms_select": 1.0,
            "ms_register": 10.0,
            "ms_check": 4.0,
            "real_time_factor": 100 / 17,
            "peak_memory_mb": None,
        }
    )
    parts = ("prepare", "describe", "guess", "select", "register")
    assert sum(values[f"ms_{part}"] for part in parts) == pytest.approx(values["ms_per_scan"])


def test_a_stage_that_never_took_place_has_no_time():
    values = cost(StepTable([record(0), record(1, register=3), record(2, register=5)]))
    assert values["ms_describe"] is values["ms_prepare"] is values["ms_check"] is None
    assert values["ms_register"] == values["ms_per_scan"] == pytest.approx(8 / 3)


def test_without_scans_there_is_no_time():
    assert set(cost(StepTable([])).values()) == {None}


@pytest.mark.parametrize(
    ("stamps", "interval_s"),
    [
        ((0.0, 0.1, 0.2, 0.3, 5.0), 0.1),  # a gap is not the rate
        ((0.0, 0.2, 0.1, 0.3, 0.4), 0.1),  # a log that steps back in time
        ((7.0, 7.0, 7.0, 7.0, 7.0), None),
        ((0.0, 0.0, 0.0, 0.0, 9.0), None),
        ((0.0, 0.1, np.nan, 0.3, 0.4), None),
        ((3.0,), None),
    ],
)
def test_real_time_factor_is_the_sensor_s_interval_over_the_time_a_scan(stamps, interval_s):
    records = [record(i, stamp, register=20) for i, stamp in enumerate(stamps)]
    expected = None if interval_s is None else pytest.approx(interval_s / 0.020)
    assert cost(StepTable(records))["real_time_factor"] == expected


def test_no_time_no_factor():
    assert cost(StepTable([record(0), record(1)]))["real_time_factor"] is None


def test_peak_memory_is_this_process_s_and_never_falls():
    before = peak_memory_mb()
    assert before is not None and before > 20
    block = np.ones(int(before * 1e6 / 8) + 20_000_000)  # more than ever: 160 MB beyond the peak
    during = peak_memory_mb()
    assert during is not None and during >= 1e-6 * block.nbytes
    del block
    assert peak_memory_mb() == pytest.approx(during, rel=0.05)


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere it is what the system says")
def test_peak_memory_is_not_inherited():
    """``ru_maxrss`` would give a child the peak of the process that started it."""
    block = np.ones(75_000_000)
    code = "from rbtm_bench.metrics.cost import peak_memory_mb; print(peak_memory_mb())"
    answer = subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    )
    assert 10 < float(answer.stdout) < 1e-6 * block.nbytes / 2


def test_a_run_s_summary_has_them():
    values = summarise_steps(StepTable([record(0), record(1, register=4)]), 123.0)
    assert values["peak_memory_mb"] == 123.0
    assert {key: values[key] for key in COLUMNS} == cost(
        StepTable([record(0), record(1, register=4)]), 123.0
    )
