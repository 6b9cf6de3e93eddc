"""May a change pass? Limits on numbers, and regressions against runs of before.

A regression is what ``report.better`` calls worse: over replicates (or six data sets and more),
after Holm over all that is compared, beyond the placebo margin. One run never fails for being
higher than another: it is not judged.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from rbtm_bench.core import escape
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.wording import suggestion
from rbtm_bench.report import better
from rbtm_bench.report.best_settings import ERRORS
from rbtm_bench.report.better import Comparison
from rbtm_bench.report.frame import MethodRuns
from rbtm_bench.report.margin import margin_of
from rbtm_bench.report.render import is_empty, three_digits
from rbtm_bench.report.verdict import label, rule

PASSED, FAILED, NOT_JUDGED = "passed", "failed", "not judged"


@dataclass(frozen=True)
class Finding:
    """One thing that was asked of a method, and what came of it."""

    method: str
    data: str
    asked: str
    value: str
    outcome: str
    why: str = ""


def limits(words: Sequence[str], option: str) -> dict[str, float]:
    """``KEY=NUMBER`` words as numbers. Raises ``ConfigError`` for others."""
    values = {}
    for word in words:
        key, _, number = word.partition("=")
        try:
            values[key] = float(number)
        except ValueError:
            values[key] = float("nan")
        if not key or values[key] != values[key]:
            raise ConfigError(f"{option} {word}: expected KEY=NUMBER")
    return values


def within(
    methods: Sequence[MethodRuns], most: Mapping[str, float], least: Mapping[str, float]
) -> list[Finding]:
    """Whether every run was done, and every method's medians keep the limits.

    Raises ``ConfigError`` for a number that no method has.
    """
    numbers = {k for m in methods for k, v in m.row.items() if isinstance(v, int | float)}
    for option, keys in (("--max", most), ("--min", least)):
        for key in keys:
            if key not in numbers:
                raise ConfigError(f"{option} {key}: no such number.{_near(key, numbers)}")
    findings = []
    for method in methods:
        failed = [run for run in method.runs if not run.done]
        if failed:
            why = str(failed[0].record.get("reason") or failed[0].record.get("status"))
            count = f"{len(failed)} of {len(method.runs)} failed"
            findings.append(Finding(*_names(method), "runs done", count, FAILED, why))
        bounds = [(k, "at most", v, operator.le) for k, v in most.items()]
        bounds += [(k, "at least", v, operator.ge) for k, v in least.items()]
        for key, words, bound, holds in bounds:
            value = method.row.get(key)
            is_known = value is not None and not is_empty(value)
            outcome = PASSED if is_known and holds(float(value or 0), bound) else FAILED
            shown = three_digits(float(value or 0)) if is_known else "none"
            asked = f"{key} {words} {bound:g}"
            findings.append(Finding(*_names(method), asked, shown, outcome))
    return findings


def regressions(
    methods: Sequence[MethodRuns], before: Sequence[MethodRuns], keys: Sequence[str] = ()
) -> tuple[list[Finding], list[str]]:
    """How every method compares with itself in ``before``, by ``keys`` or else its main error; and
    notes: the rule, what is new, what is gone.

    Raises ``DataError`` if no method is in both, ``ConfigError`` for a key that none has.
    """
    old = {method.runs[0].method: method for method in before}
    both = [(m, old[m.runs[0].method]) for m in methods if m.runs[0].method in old]
    if not both:
        raise DataError("--baseline: none of its methods has the settings of one of these")
    compared: list[tuple[MethodRuns, str, Comparison | None]] = []
    for now, then in both:
        beside = [m for m in before if m.row["data"] == then.row["data"]]
        for key in keys or _main(now):
            one = better.compare(now, then, key, margin_of(beside, key))
            compared.append((now, key, one))
    if keys and not any(one for _, _, one in compared):
        raise ConfigError(f"--metric {','.join(keys)}: no method has it on the same data in both")
    adjusted = iter(better.adjusted([one for _, _, one in compared if one is not None]))
    known = [(m, key, None if one is None else next(adjusted)) for m, key, one in compared]
    notes = rule([one for _, _, one in known if one is not None])
    mine = {m.runs[0].method for m in methods}
    notes += _listed("not in the baseline", [m for m in methods if m.runs[0].method not in old])
    notes += _listed("in the baseline alone", [m for m in before if m.runs[0].method not in mine])
    return [_finding(method, key, one) for method, key, one in known], notes


def comment(findings: Sequence[Finding], notes: Sequence[str]) -> str:
    """One comment for a pull request, in Markdown: failures first."""
    order = (FAILED, NOT_JUDGED, PASSED)
    rows = sorted(findings, key=lambda finding: order.index(finding.outcome))
    counts = [(outcome, sum(f.outcome == outcome for f in rows)) for outcome in order]
    summary = ", ".join(f"{count} {outcome}" for outcome, count in counts if count)
    verdict = FAILED if counts[0][1] else PASSED
    lines = [f"### rbtm-bench gate: {verdict}", "", f"{summary or 'nothing was asked'}.", ""]
    lines += ["| | data | method | asked | value | why |", "|---|---|---|---|---|---|"]
    for f in rows:
        outcome = f"**{f.outcome}**" if f.outcome == FAILED else f.outcome
        cells = (f.data, f.method, f.asked, f.value, f.why)
        lines.append(f"| {outcome} | {' | '.join(map(escape.markdown, cells))} |")
    return "\n".join(
        [*lines, *(["", *(f"- {escape.markdown(note)}" for note in notes)] if notes else [])]
    )


def _finding(method: MethodRuns, key: str, one: Comparison | None) -> Finding:
    asked = f"{key} not worse than the baseline"
    if one is None:
        return Finding(*_names(method), asked, "none", NOT_JUDGED, "no data that both have it on")
    value = f"{three_digits(one.ours)}, was {three_digits(one.theirs)}"
    if one.unit == better.RUNS and not one.equal:
        count = "one run" if one.n == 1 else f"{one.n} runs"
        return Finding(*_names(method), asked, value, NOT_JUDGED, f"{count}: not judged")
    outcome = FAILED if one.holds == "worse" else PASSED
    return Finding(*_names(method), asked, value, outcome, one.words("it"))


def _main(method: MethodRuns) -> list[str]:
    return [key for key, *_ in ERRORS if not is_empty(method.row.get(key))][:1]


def _names(method: MethodRuns) -> tuple[str, str]:
    return f"{method.row['backend']} {label(method.row)}", str(method.row["data"])


def _listed(what: str, methods: Sequence[MethodRuns]) -> list[str]:
    names = [f"{_names(m)[0]} ({_names(m)[1]})" for m in methods]
    return [f"{what}: {', '.join(names)}"] if names else []


def _near(key: str, numbers: set[Any]) -> str:
    return suggestion(key, sorted(map(str, numbers)))
