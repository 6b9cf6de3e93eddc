"""What a run's rows add up to where scans matched nothing."""

from __future__ import annotations

import pytest

from rbtm_bench.core.types import StepRecord
from rbtm_bench.metrics.summary import COLUMNS, summarise_steps

STATUS = {"r": "registered", "f": "fallback", "s": "skipped", "p": "predicted", "u": "unusable"}


def summary(words: str, restarts: tuple[int, ...] = ()) -> dict[str, float | int | None]:
    """A run of scans: the first, then a letter each."""
    records = [StepRecord(0, 0.0)]
    for scan, letter in enumerate(words, start=1):
        record = StepRecord(scan, 0.1 * scan, status=STATUS[letter], restart=scan in restarts)
        records.append(record)
    return summarise_steps(records)


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
    assert summarise_steps([StepRecord(0, 0.0, status="unusable")])["longest_skip"] == 0
