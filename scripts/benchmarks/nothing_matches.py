"""What becomes of a run when nothing matches: a gap cut out of a log, scans replaced by noise.

    python scripts/benchmarks/nothing_matches.py

RBTM in the corridor with a turn and, where RBTM_BENCH_DATA is set, on the first 600 scans of ACES,
with each fallback. Prints the Markdown table of docs/selection.md; half a minute.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from rbtm_bench.core.geometry import inverse, translation_norm
from rbtm_bench.core.types import Array, Scan, Step, StepTable
from rbtm_bench.datasets.base import Dataset, beam_points
from rbtm_bench.metrics.summary import summarise_steps
from rbtm_bench.odometry.loop import odometry
from rbtm_bench.runs.assembly import instantiate
from rbtm_bench.runs.settings import compose_settings

RBTM = ("selector=rbtm_verified", "selector.threshold=0.7")
METHODS = {
    "previous": (*RBTM, "selector.fallback=previous"),
    "previous, check=gated": (*RBTM, "selector.fallback=previous", "check=gated"),
    "skip, no restart": (*RBTM, "selector.fallback=skip", "selector.restart_after=1000000"),
    "skip": (*RBTM, "selector.fallback=skip"),
}
GUESS_ALONE = ("selector=previous", "backend=none")
AFTER = 20
"""Scans after the event up to which the motion across it is judged."""


@dataclass(frozen=True)
class Event:
    """Scans ``first`` ... ``last`` - 1 of a data set are ``gone``, or else replaced by noise."""

    name: str
    first: int
    last: int
    gone: bool = False


def disturbed(dataset: Dataset, event: Event, longest: float, seed: int = 0) -> Iterator[Scan]:
    """The scans with their own numbers: some left out, or with ranges uniform in 0.5 ...
    ``longest`` m that have nothing to do with the place or with one another."""
    random = np.random.default_rng(seed)
    for scan in dataset:
        if not event.first <= scan.index < event.last:
            yield scan
        elif not event.gone:
            assert scan.ranges is not None and scan.angles is not None
            ranges = random.uniform(0.5, longest, len(scan.ranges))
            yield replace(scan, ranges=ranges, points=beam_points(ranges, scan.angles))


def run(words: list[str], event: Event, longest: float) -> list[Step]:
    """The steps of a run on the disturbed data."""
    parts = instantiate(compose_settings(words))
    return list(odometry(disturbed(parts.dataset, event, longest), parts.method))


def across(poses: dict[int, Array], event: Event) -> Array:
    """The motion (4, 4) from the last scan before an event to the ``AFTER``-th after it."""
    return inverse(poses[event.first - 1]) @ poses[event.last + AFTER - 1]


def poses_of(steps: list[Step]) -> dict[int, Array]:
    """T_world_scan (4, 4) by scan number."""
    return {step.record.scan: step.T_world_scan for step in steps}


def off(known: Array, estimated: Array) -> float:
    """The distance (m) between where two motions lead."""
    return float(translation_norm(inverse(known) @ estimated))


def table(name: str, words: list[str], events: list[Event], longest: float) -> list[str]:
    """A row for every event and fallback."""
    calm = Event("nothing", events[0].first, events[0].first)
    dataset = instantiate(compose_settings([*words, *GUESS_ALONE])).dataset
    if dataset.has_ground_truth:
        known = {scan.index: scan.ground_truth for scan in dataset if scan.ground_truth is not None}
    else:
        known = poses_of(run([*words, *METHODS["previous"]], calm, longest))
    lines = []
    for event in [calm, *events]:
        guessed = poses_of(run([*words, *GUESS_ALONE], event, longest))
        predicted = off(across(known, event), across(guessed, event))
        for method, more in METHODS.items():
            steps = run([*words, *more], event, longest)
            sums = summarise_steps(StepTable(step.record for step in steps))
            noise = sum(
                step.record.model is not None and event.first <= step.record.model < event.last
                for step in steps
            )
            error = off(across(known, event), across(poses_of(steps), event))
            cells = [name, event.name, method, f"{sums['coverage']:.2f}"]
            cells += [str(sums[key]) for key in ("skipped", "longest_skip", "restarts")]
            cells += [str(noise), f"{error:.3f}", f"{predicted:.3f}"]
            lines.append(f"| {' | '.join(cells)} |")
    return lines


CORRIDOR = ["dataset=corridor", "dataset.environment=l_turn", "dataset.scans=301", "guess=odometry"]
CORRIDOR_EVENTS = [
    Event("gap of 50", 100, 150, gone=True),
    Event("10 of noise", 150, 160),
    Event("30 of noise", 150, 180),
]
ACES_EVENTS = [
    Event("gap of 100", 200, 300, gone=True),
    Event("10 of noise", 300, 310),
    Event("30 of noise", 300, 330),
]
HEAD = (
    "| data | event | fallback | coverage | skipped | longest skip | restarts "
    "| matched to noise | error across (m) | prediction's (m) |"
)


def aces_words(folder: Path) -> list[str]:
    """The settings for the first 600 scans of ACES."""
    log = folder / "freiburg" / "aces.clf.gz"
    return [
        "dataset=carmen",
        f"dataset.path='{log}'",
        "dataset.max_scans=600",
        "guess=odometry",
        "similarity=curvature_circular",
    ]


def main() -> int:
    """Print the table."""
    print(HEAD)
    print("|---" * 10 + "|")
    print(*table("corridor", CORRIDOR, CORRIDOR_EVENTS, 4.0), sep="\n", flush=True)
    data = os.environ.get("RBTM_BENCH_DATA")
    if data:
        print(*table("ACES", aces_words(Path(data)), ACES_EVENTS, 8.0), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
