"""What a run's rows add up to where scans matched nothing."""

from __future__ import annotations

import pytest

from rbtm_bench.core.types import StepRecord, StepTable
from rbtm_bench.metrics.summary import COLUMNS, summarise_steps

STATUS = {"r": "registered", "f": "fallback", "s": "skipped", "p": "predicted", "u": "unusable"}


def summary(words: str, restarts: tuple[int, ...] = ()) -> dict[str, float | int | None]:
    """A run of scans: the first, then a letter each."""
    records = [StepRecord(0, 0.0)]
    for scan, letter in enumerate(words, start=1):
        record = StepRecord(scan, 0.1 * scan, status=STATUS[letter], restart=scan in restarts)
        records.append(record)
    return summarise_steps(StepTable(records))


@pytest.mark.parametrize(
    ("words", "skipped", "longest", "coverage"),
    [
        ("rrrr", 0, 0, 1.0),
        ("ssss", 4, 4, 0.0),
        ("rssr", 2, 2, 0.5),
        ("ssrsss", 5, 3, 1 / 6),
        ("rspusf", 2, 4, 1 / 3),  # whatever the reason: each pose is a prediction
        ("", 0, 0, None),
    ],
)
def test_skips(words, skipped, longest, coverage) -> None:
    values = summary(words)
    assert (values["skipped"], values["longest_skip"]) == (skipped, longest)
    assert values["coverage"] == (None if coverage is None else pytest.approx(coverage))
    assert list(values) == list(COLUMNS)


def test_restarts_are_counted() -> None:
    assert summary("rssrrsr")["restarts"] == 0
    assert summary("rssrrsr", restarts=(4, 7))["restarts"] == 2


def test_an_unusable_first_scan_is_no_skip() -> None:
    assert summarise_steps(StepTable([StepRecord(0, 0.0, status="unusable")]))["longest_skip"] == 0


def test_what_registrations_hold_is_told_by_the_middle_one_and_by_who_is_below() -> None:
    """Of 0.002, 0.01, 0.04 and 0.5 the median is 0.025, and one is less than 0.01; what was not
    registered does not count."""
    held = [0.5, 0.002, 0.04, 0.01]
    records = [StepRecord(0, 0.0, localizability_min=0.3)]
    records += [
        StepRecord(i, 0.1 * i, status="registered", localizability_min=value, gap=i, fitness=0.5)
        for i, value in enumerate(held, start=1)
    ]
    records.append(StepRecord(5, 0.5, status="predicted", localizability_min=0.001, gap=99))
    values = summarise_steps(StepTable(records))
    assert values["localizability"] == pytest.approx(0.025)
    assert values["degenerate"] == 1 / 4
    assert (values["mean_gap"], values["mean_fitness"], values["coverage"]) == (2.5, 0.5, 4 / 5)
