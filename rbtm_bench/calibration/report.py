"""The results of a calibration, in plain words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.calibration import guesses
from rbtm_bench.calibration.analysis import ALL, EQUAL, PREDICTORS, Measured
from rbtm_bench.calibration.parts import PARTS
from rbtm_bench.calibration.plan import CalibrationPlan
from rbtm_bench.calibration.rates import Rate, rate
from rbtm_bench.calibration.sampling import (
    GAP,
    REVISIT,
    REVISIT_M,
    REVISIT_TRAVELLED_M,
    Sample,
)
from rbtm_bench.calibration.tables import Findings, one_area
from rbtm_bench.calibration.trial import Trial, Verdict
from rbtm_bench.report.intervals import FEWEST_UNITS

if TYPE_CHECKING:
    import pandas as pd

TRUTH = {
    "poses": "the data set's true poses",
    "relations": "the log's relations",
}
FEW_BLOCKS = 8


def text(
    measured: Measured,
    samples: Sequence[Sample],
    findings: Findings,
    verdicts: Mapping[str, Verdict],
    plan: CalibrationPlan,
    data: Sequence[str],
) -> str:
    """The whole report; the advice last."""
    parts = [
        _pairs(measured, samples, plan, data),
        _success(measured),
        *(_areas(measured, findings, kind) for kind in (GAP, REVISIT)),
        _knees(findings),
        _gaps(findings),
        _notes(measured, samples),
        *(_advice(backend, verdict) for backend, verdict in verdicts.items()),
    ]
    return "\n\n".join("\n".join(lines) for lines in parts if lines)


def _pairs(
    measured: Measured, samples: Sequence[Sample], plan: CalibrationPlan, data: Sequence[str]
) -> list[str]:
    conditions = samples[0].conditions
    metres, degrees = plan.within
    lines = [f"Pairs of {', '.join(data)}"]
    truth = TRUTH[conditions["truth"]]
    if conditions["truth"] == "relations":
        truth += f", up to {plan.chain} in a row as one"
    lines.append(f"  truth      {truth}")
    lines.append(
        f"  success    the registration ends within {metres:g} m and {degrees:g} deg of it"
    )
    guess = guesses.DESCRIPTIONS[conditions["guess"]]
    if conditions["disturbed"]:
        guess += f", disturbed by {conditions['disturbed']} in a random direction"
    lines.append(f"  guess      {guess}")
    lines.append("  two parts  calibration and reported: first and second half; nothing in both")
    counts = {key: sum(s.counts.get(key, 0) for s in samples) for s in samples for key in s.counts}
    lines.append(
        "  counts     "
        + ", ".join(f"{n} {name}" for name, n in counts.items() if n or "pairs" in name)
    )
    across = measured.pairs[measured.pairs["kind"] == GAP]
    gaps = across.groupby("group").size()
    if conditions["truth"] == "relations":
        ends = [0, *gaps.index]
        words = [
            f"{b}: {n}" if b - a == 1 else f"{a + 1}-{b}: {n}"
            for a, b, n in zip(_before(ends, plan), gaps.index, gaps, strict=True)
        ]
    else:
        words = [f"{gap}: {n}" for gap, n in gaps.items()]
    lines.append("  gaps       " + ", ".join(words) + " pairs (scans back: pairs of both parts)")
    if (measured.pairs["kind"] == REVISIT).any():
        lines.append(_revisits(conditions["truth"], plan))
    blocks = measured.pairs.loc[measured.pairs["kind"] == GAP, "cluster"].nunique()
    lines.append(
        f"  intervals  95%, from {blocks} blocks of {conditions['block_s']} s: neighbouring pairs "
        "are not independent"
    )
    return lines


def _before(ends: Sequence[int], plan: CalibrationPlan) -> list[int]:
    """The end of the group before each of the groups that have pairs."""
    every = [0, *plan.model_gaps]
    return [every[every.index(int(end)) - 1] for end in ends[1:]]


def _revisits(truth: str, plan: CalibrationPlan) -> str:
    metres, degrees = plan.revisit_error
    what = f"scans at most {REVISIT_M:g} m apart after at least {REVISIT_TRAVELLED_M:g} m of path"
    if truth == "relations":
        what = "relations over more than 30 s"
    return (
        f"  revisits   {what}; odometry is off by metres there, so their guess is the true motion "
        f"disturbed by {metres:g} m and {degrees:g} deg; kept apart"
    )


def _success(measured: Measured) -> list[str]:
    lines = ["Success and error of all pairs (50%, 90% of the errors are at most)"]
    for kind in (GAP, REVISIT):
        inside = (measured.pairs["kind"] == kind).to_numpy()
        if not inside.any():
            continue
        clusters = measured.pairs["cluster"].to_numpy()[inside]
        for name, outcome in measured.outcomes.items():
            rows = outcome[inside]
            success = rate(rows["success"], clusters)
            failed = int(rows["error_m"].isna().sum())
            lines.append(
                f"  {name:<28} {'revisits' if kind == REVISIT else 'across gaps':<12} "
                f"{_share(success)} of {success.n}; {_errors(rows)}"
                + (f"; {failed} failed" if failed else "")
            )
    return lines


def _errors(rows: pd.DataFrame) -> str:
    e = np.where(rows["error_m"].isna(), np.inf, rows["error_m"])
    d = np.where(rows["error_deg"].isna(), np.inf, rows["error_deg"])
    m = [f"{q:.3f}" for q in np.quantile(e, [0.5, 0.9], method="inverted_cdf")]
    g = [f"{q:.2f}" for q in np.quantile(d, [0.5, 0.9], method="inverted_cdf")]
    return f"{m[0]}, {m[1]} m; {g[0]}, {g[1]} deg"


def _areas(measured: Measured, findings: Findings, kind: str) -> list[str]:
    roc = findings.roc
    if not (roc["pairs"] == kind).any():
        return []
    what = "pairs across gaps" if kind == GAP else "revisits"
    lines = [
        f"How well is success predicted beforehand: area under the ROC curve, {what} (0.5: chance)"
    ]
    wide = max(26, *(len(name) for name in (*measured.scores, *PREDICTORS.values())))
    for backend in measured.outcomes:
        heads = f"{ALL:<20} {EQUAL:<20} {'minus gap, all':<22}" if kind == GAP else f"{'area':<20}"
        lines.append(f"  {backend:<{wide}} {heads} cost a pair")
        others = PREDICTORS if kind == GAP else ("distance_m", "rotation_deg")
        for name in (*measured.scores, *others):
            every = one_area(roc, backend, name, ALL, kind=kind)
            if not every:
                continue
            words = f"{_of_area(every):<20}"
            if kind == GAP:
                words += f" {_of_area(one_area(roc, backend, name, EQUAL, kind=kind)):<20}"
                words += f" {_of_area(every, 'minus_gap', sign=True):<22}"
            cost = f" {every['score_us']:.3g} us" if name in measured.scores else ""
            lines.append(f"    {PREDICTORS.get(name, name):<{wide - 2}} {words}{cost}".rstrip())
    if kind == GAP:
        lines += _in_words(measured, findings)
    return lines


def _in_words(measured: Measured, findings: Findings) -> Iterator[str]:
    """What the areas at equal gap mean, a line a similarity."""
    for name in measured.scores:
        by_verdict: dict[str, list[str]] = {}
        for backend in measured.outcomes:
            row = one_area(findings.roc, backend, name, EQUAL)
            by_verdict.setdefault(_verdict(row), []).append(backend)
        for verdict, backends in by_verdict.items():
            who = "" if len(by_verdict) == 1 else f" ({', '.join(backends)})"
            yield f"  At equal gap {name} {verdict}{who}."


def _verdict(row: Mapping[str, Any]) -> str:
    value, low, high = (row.get(key) for key in ("auc", "auc_low", "auc_high"))
    if value is None or not math.isfinite(value):
        return "cannot be judged: all succeed or all fail"
    if low is None or high is None or not math.isfinite(low) or not math.isfinite(high):
        return "cannot be judged: too few blocks"
    if low > 0.5:
        return "tells successes from failures better than chance"
    if high < 0.5:
        return "is higher for failures than for successes"
    return "tells nothing that could not be chance"


def _of_area(row: Mapping[str, Any], key: str = "auc", sign: bool = False) -> str:
    value = row.get(key)
    if value is None or not math.isfinite(value):
        return "" if sign else "-"
    plus = "+" if sign else ""
    low, high = row.get(f"{key}_low"), row.get(f"{key}_high")
    if low is None or high is None or not math.isfinite(low):
        return f"{value:{plus}.2f}"
    return f"{value:{plus}.2f} [{low:{plus}.2f}, {high:{plus}.2f}]"


def _knees(findings: Findings) -> list[str]:
    lines = ["Is there a similarity below which errors rise abruptly? (the paper's knee)"]
    for (backend, similarity), knee in findings.knees.items():
        lines.append(f"  {backend}, {similarity}: {knee.why}")
    return lines


def _gaps(findings: Findings) -> list[str]:
    """What each gap's errors predict at the end of the calibration part."""
    lines = ["Drift over the calibration part that the pairs of a gap predict (m)"]
    for backend, gaps in findings.gaps.items():
        lines.append(f"  {backend}")
        for g in gaps:
            interval = f"[{g.drift.low:.3g}, {g.drift.high:.3g}]" if g.drift.low is not None else ""
            unsure = f"; cannot predict: {g.unsure}" if g.unsure else ""
            lines.append(f"    gap {g.gap:<4} {g.drift.value:.3g} {interval}{unsure}")
    return lines if any(findings.gaps.values()) else []


def _advice(backend: str, verdict: Verdict) -> list[str]:
    """What was run, and what to take."""
    metric = verdict.tried[0].metric
    lines = [f"{backend}: settings run on the calibration part; {metric}: median [quartiles] worst"]
    lines += _of_trials(sorted(verdict.tried, key=lambda t: t.median), verdict)
    if not np.isfinite(min(t.median for t in verdict.tried)):
        lines.append("  no setting has an error there: nothing could be chosen")
    lines.append(f"{backend}: the advice beside the references on the reported part")
    lines += _of_trials(verdict.shown, verdict)
    advice, instead = verdict.advice, verdict.instead
    for other, comparison in zip(verdict.shown[1:], verdict.comparisons, strict=True):
        lines.append(f"  against {other.name}: {comparison.words(advice.name)}")
    if verdict.kept:
        lines.append(f"  ADVICE for {backend}: {advice.name}")
    else:
        times = advice.median / instead.median
        lines.append(
            f"  ADVICE for {backend} withdrawn: {advice.name} has {times:.3g} times the error of "
            f"{instead.name} on the reported part: take {instead.name}"
        )
    return lines


def _of_trials(trials: Sequence[Trial], verdict: Verdict) -> Iterator[str]:
    wide = max(len(t.name) for t in trials)
    for t in trials:
        q1, q3 = np.quantile(t.values, [0.25, 0.75], method="inverted_cdf")
        star = "*" if t.candidate.words == verdict.advice.candidate.words else " "
        wheels = "" if t.of_wheels is None else f"; {t.of_wheels:.3g} of wheels' relations"
        drift = t.candidate.drift
        predicted = "" if drift is None else f"; predicted drift {drift.value:.3g} m"
        yield (
            f"  {star} {t.name:<{wide}} {t.median:.3g} [{q1:.3g}, {q3:.3g}] {t.values.max():.3g}; "
            f"mean gap {t.mean('mean_gap'):.3g}; {t.cost:.2g} registrations, "
            f"{t.mean('ms_per_scan'):.2g} ms a scan{wheels}{predicted}"
        )


def _share(success: Rate) -> str:
    if success.n == 0:
        return "no pairs"
    return f"{success.value:.0%} [{success.low:.0%}, {success.high:.0%}]"


def _notes(measured: Measured, samples: Sequence[Sample]) -> list[str]:
    lines = []
    inside = (measured.pairs["kind"] == GAP).to_numpy()
    for name, outcome in measured.outcomes.items():
        good = outcome["success"].to_numpy(bool)[inside]
        if good.all() or not good.any():
            middle = float(np.nanmedian(outcome["error_m"][inside])) if good.any() else math.nan
            hint = (
                f"; half of the errors are below {middle:.3g} m: see --within" if good.all() else ""
            )
            what = "succeed" if good.all() else "fail"
            lines.append(
                f"{name}: all pairs across gaps {what}, nothing is there to predict{hint}."
            )
        reasons = outcome.loc[outcome["reason"] != "", "reason"].value_counts()
        if len(reasons):
            lines.append(
                f"{name}: {int(reasons.sum())} registrations failed, most often: {reasons.index[0]}"
            )
    for name, scores in measured.scores.items():
        undefined = int(np.isnan(scores).sum())
        if undefined:
            lines.append(
                f"{name}: {undefined} of {len(scores)} scores are undefined; they never pass a "
                "threshold and count as the lowest in the areas."
            )
    block_s = samples[0].conditions["block_s"]
    for part in PARTS:
        some = measured.pairs[inside & (measured.pairs["part"] == part).to_numpy()]
        blocks = some["cluster"].nunique()
        if blocks < FEWEST_UNITS:
            lines.append(
                f"The {part} part has {blocks} independent blocks: no interval can be trusted."
            )
        elif blocks < FEW_BLOCKS or float(block_s) < 30:
            lines.append(
                f"The {part} part is short ({blocks} blocks of {block_s} s): "
                "intervals are rather too short."
            )
    return [f"Note: {line}" for line in dict.fromkeys(lines)]
