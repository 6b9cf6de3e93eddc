"""What is said of a sweep before it begins, and while it runs."""

from __future__ import annotations

import pytest

from rbtm_bench.engine.progress import LINE_S, UNTIL_DONE, Bar, Plan, RunBar


def test_the_bar_counts_and_estimates() -> None:
    now = 0.0
    bar = RunBar(Bar(), Plan(12, reused=2), clock=lambda: now)
    assert bar.text() == "0 done, 2 reused"
    now = 10.0
    bar.part("a", 5, 10)
    assert bar.text() == "0 done, 2 reused, running a"  # no time before a run is done
    now = 20.0
    bar.ended("a", True)
    bar.part("b", 5, 10)
    assert bar.text() == "1 done, 2 reused, running b, 1:53 left"  # 1.5 of 10 in 20 s
    bar.began("c")
    bar.began("d")
    assert "running b and 2 more, " in bar.text()
    bar.ended("b", False)
    assert bar.text() == "1 done, 2 reused, 1 failed, running c and 1 more, 1:20 left"
    bar.ended("c", True, registrations=300, shared=0.5)
    bar.ended("d", True, registrations=100, shared=1.0)
    assert bar.text() == "3 done, 2 reused, 1 failed, 62% of registrations shared, 0:30 left"
    now = 3600.0
    assert bar.text().endswith("1 failed, 62% of registrations shared, 1:30:00 left")
    assert RunBar(Bar(), Plan(None)).text() == "0 done"


def test_a_failed_run_tells_no_time() -> None:
    bar = RunBar(Bar(), Plan(3))
    bar.ended("a", False)
    assert bar.text() == "0 done, 1 failed"


def test_earlier_runs_tell_the_time() -> None:
    plan = Plan(12, reused=2, workers=2, run_seconds=30.0, most=7)
    bar = RunBar(Bar(), plan, clock=lambda: 0.0)
    assert bar.text() == "0 done, 2 reused, 2:30 left"
    assert Plan(3, 2, workers=2, run_seconds=30.0).seconds(1) == 30.0  # one run has one worker
    assert Plan(3, 2, workers=None, run_seconds=30.0).seconds(1) is None


@pytest.mark.parametrize(
    ("plan", "said"),
    [
        (Plan(1, most=9), f"1 run, all new; at most 9 distinct registrations; {UNTIL_DONE}"),
        (
            Plan(24, 4, 2, 7.0, "a reason"),
            "24 runs: 20 new, 4 done before; number of distinct registrations unknown: a reason; "
            "about 1:10",
        ),
        (
            Plan(24, 4, None, 7.0, 0),
            f"4 done before; at most 0 distinct registrations; {UNTIL_DONE}",
        ),
        (Plan(3, 3, 1, 7.0), "3 runs: 0 new, 3 done before"),
        (Plan(None), f"nobody knows how many runs: the sweeper makes them up; {UNTIL_DONE}"),
    ],
)
def test_the_opening_line(plan: Plan, said: str) -> None:
    assert plan.opening().endswith(said)


def test_lines_where_nobody_sees_a_bar(capsys: pytest.CaptureFixture[str]) -> None:
    now = 0.0
    bar = RunBar(Bar(), Plan(10), clock=lambda: now)
    for number in range(10):
        now += 0.4 * LINE_S
        bar.part(str(number), 1, 2)
        bar.ended(str(number), True)
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in lines] == [f"{n} of 10 runs" for n in (1, 4, 7)]
    assert lines[0] == "1 of 10 runs: 1 done, 3:36 left"
    RunBar(Bar(RichBar()), Plan(10)).ended("a", True)
    assert capsys.readouterr().err == ""


class RichBar:
    """Stands for the library's."""

    def update(self, task: object, **values: object) -> None:
        pass
