"""How many registrations a grid of runs asks for, as far as that is known before it begins."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

from rbtm_bench.core.errors import RbtmBenchError
from rbtm_bench.engine import one_run
from rbtm_bench.runs import assembly
from rbtm_bench.runs.grid import Point
from rbtm_bench.runs.identity import node_key
from rbtm_bench.runs.plugins import class_of, is_system
from rbtm_bench.target.single import SingleScan


def check(points: Sequence[Point], rest: Sequence[Point] | str) -> int | str:
    """Check the data of ``points``; the most distinct registrations that ``rest`` asks for, or why
    nobody knows. Raises as ``one_run.check_data``."""
    scans = one_run.check_data(points)
    return rest if isinstance(rest, str) else registrations_at_most(rest, scans)


def registrations_at_most(points: Sequence[Point], scans: dict[str, int]) -> int | str:
    """The most distinct registrations that the runs of ``points`` ask for, or why nobody knows.

    Where the guess depends on the pair alone, runs that agree in data, backend and guess share
    every pair, and all they can ask for are the pairs within the widest window among them.
    ``scans``: how many a data set has, by ``node_key``.
    """
    widest: dict[tuple[str, str], float] = {}
    extra: dict[tuple[str, str], bool] = {}
    alone: Counter[tuple[str, str]] = Counter()
    for point in points:
        config, choices = point.settings.config, point.settings.choices
        if is_system(config):
            continue  # it registers by itself
        guess = class_of("guess", config["guess"])
        if not getattr(guess, "pure", False):
            return f"guess={choices['guess']} follows each run's trajectory"
        if class_of("target", config["target"]) is not SingleScan:
            return f"target={choices['target']} follows each run's trajectory"
        data = node_key(config["dataset"])
        if data not in scans:
            return "not every data set was opened"
        way = (data, node_key(assembly.backend_node(config), config["guess"]))
        reach = _reach(config["selector"])
        alone[way] += reach is None
        widest[way] = max(widest.get(way, 0.0), reach or 0.0)
        extra[way] = bool(getattr(guess, "needs_backend", False))  # it registers neighbours too
    count = 0
    for way, reach in widest.items():
        n = scans[way[0]]
        near = int(min(reach, n - 1))
        within = near * (n - 1) - near * (near - 1) // 2 + (n - 1) * alone[way]
        count += min(within, n * (n - 1) // 2) + (n - 1) * extra[way]
    return count


def _reach(node: dict[str, Any]) -> float | None:
    """How many scans the window of a selector holds, inf where it may hold any: with keyframes, or
    where scans are left out, runs remember different ones; None where it holds one keyframe, which
    is all that a scan can be registered to."""
    try:
        selector = assembly.build(node)
        if selector.fallback == "skip":
            return float("inf")
        if selector.window().keyframes is None:
            return float(selector.capacity)
        return None if selector.capacity == 1 else float("inf")
    except RbtmBenchError:  # random_gap, before its gaps are there
        return float("inf")
