"""Which runs stand beside each other: the standard method and RBTM, all else equal."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from rbtm_bench.plots import labels
from rbtm_bench.runs.stored import Run

SAME = ("dataset", "backend")
"""What two runs that are compared must share."""
BETTER_SAME = ("guess", "search", "check", "recovery", "target")
"""What they should share as well; where none do, the figure names the difference."""


@dataclass(frozen=True, eq=False)
class RunPair:
    """``remarks`` name, for each of the two, what else differs."""

    standard: Run
    rbtm: Run
    stem: str
    remarks: tuple[str, str] = ("", "")


def standard_and_rbtm(runs: Sequence[Run]) -> list[RunPair]:
    """A pair for every data set and backend (and guess, check and target) that has both.

    Not for backend "none", which registers nothing: whatever the model scan, its map is the same.
    Of several seeds the lowest that both have, of several settings of rbtm the first.
    """
    chosen: list[tuple[Run, Run, bool]] = []
    real = [run for run in runs if labels.choice(run, "backend") != "none"]
    for members in _grouped(real, SAME):
        pairs = [_pair(m) for m in _grouped(members, BETTER_SAME)]
        exact = [p for p in pairs if p is not None]
        loose = None if exact else _pair(members)
        chosen += [(*p, len(_seeds(members)) > 1) for p in exact or ([loose] if loose else [])]
    stems = _stems([(rbtm, many) for _, rbtm, many in chosen])
    out = []
    for (standard, rbtm, _), stem in zip(chosen, stems, strict=True):
        words = labels.distinctions([standard, rbtm], BETTER_SAME)
        remarks = (", ".join(words[standard]), ", ".join(words[rbtm]))
        out.append(RunPair(standard, rbtm, stem, remarks))
    return out


def _grouped(runs: Sequence[Run], groups: tuple[str, ...]) -> list[list[Run]]:
    out: dict[str, list[Run]] = {}
    for run in runs:
        out.setdefault(labels.key_of(run, groups), []).append(run)
    return list(out.values())


def _pair(runs: Sequence[Run]) -> tuple[Run, Run] | None:
    """Standard and rbtm, at the lowest seed that has both."""
    by_selector = {
        name: [run for run in runs if labels.choice(run, "selector") == name]
        for name in ("previous", "rbtm")
    }
    seeds = _seeds(by_selector["previous"]) & _seeds(by_selector["rbtm"])
    if not seeds:
        return None
    standard, rbtm = (
        [run for run in members if labels.seed_order(run) == min(seeds)]
        for members in by_selector.values()
    )
    return standard[0], rbtm[0]


def _seeds(runs: Sequence[Run]) -> set[float]:
    return {labels.seed_order(run) for run in runs}


def _stems(runs: Sequence[tuple[Run, bool]]) -> list[str]:
    """File names that differ: data set and backend, then what else tells the pairs apart, then
    the seed if the pair was one of several."""
    out: list[str] = []
    for run, many_seeds in runs:
        names = [labels.choice(run, group) for group in SAME]
        alike = [r for r, _ in runs if [labels.choice(r, group) for group in SAME] == names]
        words = labels.distinctions(alike, (*SAME, *BETTER_SAME))[run]
        seed = [f"seed{run.record.get('seed')}"] if many_seeds else []
        stem = re.sub(r"[^\w.=+-]+", "_", "-".join([*names, *words, *seed]))
        twice = sum(other == stem or other.startswith(f"{stem}-again") for other in out)
        out.append(f"{stem}-again{twice + 1}" if twice else stem)
    return out
