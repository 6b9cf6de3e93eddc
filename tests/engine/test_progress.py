"""The bar of a sweep: what it says."""

from __future__ import annotations

from rbtm_bench.engine.progress import Bar, RunBar


def test_the_bar_counts_and_estimates() -> None:
    now = 0.0
    bar = RunBar(Bar(), 12, reused=2, clock=lambda: now)
    assert bar.text() == "0 done, 2 reused"
    now = 20.0
    bar.ended("a", True)
    bar.part("b", 5, 10)
    assert bar.text() == "1 done, 2 reused, 1:53 left"  # 1.5 of 10 in 20 s
    bar.ended("b", False)
    assert bar.text() == "1 done, 2 reused, 1 failed, 1:20 left"
    bar.ended("c", True, registrations=300, shared=0.5)
    bar.ended("d", True, registrations=100, shared=1.0)
    assert bar.text() == "3 done, 2 reused, 1 failed, 62% of registrations shared, 0:30 left"
    now = 3600.0
    assert bar.text().endswith("1 failed, 62% of registrations shared, 1:30:00 left")
    assert RunBar(Bar(), None).text() == "0 done"
