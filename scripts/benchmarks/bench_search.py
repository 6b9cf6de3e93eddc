"""The correlative search on one core: what a window costs, and how often it needs no guess.

    python scripts/benchmarks/bench_search.py              both
    python scripts/benchmarks/bench_search.py --pairs 0    ms alone

CPU ms of `search=correlative` from a guess that is off, to a target seen before and to one of which
the table is made anew: the least of several. Then pairs of scans of cluttered rooms, each another
room, at most 2 m apart, turned by anything, at least half of each seen by the other: how many the
search and plicp bring within 0.1 m and 0.03 rad of the truth when nothing is known of the motion.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from rbtm_bench.backends.plicp import PointToLineICP
from rbtm_bench.core.geometry import inverse, rotation_angle, se2, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.base import beam_points
from rbtm_bench.datasets.environments import CLUTTERED, box
from rbtm_bench.datasets.raycast import scan_walls
from rbtm_bench.odometry import judge
from rbtm_bench.runs.pinning import pin_to_free_core
from rbtm_bench.search.correlative import CorrelativeSearch

BEAMS = 180
NOISE, RANGE = 0.01, 30.0
"""m."""
APART, OVERLAP, RADIUS = 2.0, 0.5, 0.2
NEAR_M, NEAR_RAD = 0.1, 0.03
WINDOWS = ((0.12, 2.0), (0.5, 20.0), (4.0, 90.0))
"""m and deg to either side."""


def room(rng: np.random.Generator) -> Array:
    """Walls (W, 2, 2) m of a room full of boxes, its middle at (0, 0)."""
    half = rng.uniform((3.0, 2.5), (6.0, 4.5))
    walls = [*box(-half[0], -half[1], half[0], half[1])]
    for _ in range(rng.integers(8, 16)):
        side = rng.uniform(0.2, 1.2, 2)
        corner = rng.uniform(-half, half - side)
        walls += box(*corner, *(corner + side))
    return np.array(walls, dtype=float)


def scan(walls: Array, T: Array, number: int, rng: np.random.Generator) -> Scan:
    """A planar scan all around from a pose."""
    angles = np.linspace(-np.pi, np.pi, BEAMS, endpoint=False)
    ranges = scan_walls(walls, T[None], angles, RANGE)[0] + rng.normal(0.0, NOISE, BEAMS)
    return Scan(number, 0.1 * number, beam_points(ranges, angles), True, ranges, angles)


def pairs(count: int, seed: int = 0) -> Iterator[tuple[Scan, Scan, Array]]:
    """Target, source and the true T_target_source of pairs, each in a room of its own."""
    backend = PointToLineICP()
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        walls = room(rng)
        while True:
            spread = 0.5 * np.abs(walls).max(axis=(0, 1))
            target, way = se2(*rng.uniform(-spread, spread), 0.0), rng.uniform(-np.pi, np.pi)
            far = APART * np.sqrt(rng.random())
            T = se2(far * np.cos(way), far * np.sin(way), rng.uniform(-np.pi, np.pi))
            a, b = scan(walls, target, 0, rng), scan(walls, target @ T, 1, rng)
            if min(len(a.points), len(b.points)) < BEAMS // 2:
                continue
            known = [backend.prepare(one) for one in (a, b)]
            seen = judge.evaluate(known[1], known[0], T, RADIUS).fitness
            back = judge.evaluate(known[0], known[1], inverse(T), RADIUS).fitness
            if min(seen, back) >= OVERLAP:
                yield a, b, T
                break


def share_found(count: int, seed: int = 0) -> float:
    """The share of pairs that search and plicp register without a guess."""
    backend = CorrelativeSearch(translation=APART, rotation_deg=180.0).before(PointToLineICP())
    good = 0
    for target, source, T in pairs(count, seed):
        one, other = backend.prepare(source), backend.prepare(target)
        off = inverse(T) @ backend.register(one, other, np.eye(4)).T_target_source
        good += bool(translation_norm(off) <= NEAR_M and rotation_angle(off) <= NEAR_RAD)
    return good / count


def least(call: Callable[[], object], times: int) -> float:
    """CPU ms of a call, the least of several."""
    call()
    spent = []
    for _ in range(times):
        started = time.process_time()
        call()
        spent.append(time.process_time() - started)
    return 1e3 * min(spent)


def costs(times: int) -> Iterator[str]:
    """A line a window."""
    rng, walls = np.random.default_rng(0), np.array(CLUTTERED.walls, dtype=float)
    start, T = se2(2.6, 0.2, 0.3), se2(0.25, 0.1, 0.2)
    backend = PointToLineICP()
    target = backend.prepare(scan(walls, start, 0, rng))
    source = backend.prepare(scan(walls, start @ T, 1, rng))
    for metres, degrees in WINDOWS:
        guess = T @ se2(-0.3 * metres, 0.2 * metres, np.deg2rad(0.4 * degrees))
        cells = []
        for apart in (None, 0.3):
            search = CorrelativeSearch(metres, degrees, sigmas=0.0, peak_apart=apart)

            def anew(search: CorrelativeSearch = search, guess: Array = guess) -> None:
                search.matcher.forget()
                search.start(source, target, guess)

            known = least(lambda s=search, g=guess: s.start(source, target, g), times)
            cells += [f"{known:.2f}", f"{least(anew, times):.2f}"]
        yield (
            f"+-{metres:g} m, +-{degrees:g} deg, {len(source.points)} beams: {cells[0]} ms, with "
            f"the table {cells[1]}; with a second peak {cells[2]}, {cells[3]}"
        )


def main(argv: Sequence[str] | None = None) -> None:
    """Print both."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(argv)
    pin_to_free_core()
    for line in costs(options.times):
        print(line, flush=True)
    if options.pairs:
        share = share_found(options.pairs, options.seed)
        print(f"without a guess: {share:.1%} of {options.pairs} pairs")


if __name__ == "__main__":
    main()
