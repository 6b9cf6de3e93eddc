"""Fixtures that every test may use."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from rbtm_bench.contract.plugin import hands_out_work
from rbtm_bench.runs.pinning import pin_to_free_core


def pytest_configure(config: pytest.Config) -> None:
    """Pin before any backend is imported: tests that compare bits need it. Where Ctrl-C is ignored
    (a background job of a shell), children would ignore it, too, and tests of it fail."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    if not hands_out_work(config):
        pin_to_free_core()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real logs: skipped without it, but never silently where CI runs."""
    folder = os.environ.get("RBTM_BENCH_DATA")
    if folder:
        return Path(folder)
    message = "RBTM_BENCH_DATA is not set: the folder with freiburg/, corrected/ and kitti/"
    if os.environ.get("CI") == "true":
        pytest.fail(message)
    pytest.skip(message)


@pytest.fixture(scope="session")
def cases_dir(data_dir: Path) -> Path:
    """The folder of small inputs that are easily read wrongly, beside that of real logs."""
    folder = data_dir.parent / "cases"
    if not folder.is_dir():
        pytest.skip(f"{folder}: the folder of small cases beside RBTM_BENCH_DATA is not there")
    return folder


@pytest.fixture(scope="session", autouse=True)
def compiled_kernels() -> None:
    """On a fresh machine kernels are compiled first: no time limit of a test is for that."""
    from rbtm_bench.odometry import judge

    judge.compile_kernels()
