"""What the test of a knee finds: how often a sharp rise of the errors is called one, and how often
a gradual one is (docs/calibration.md).

    python scripts/benchmarks/bench_knee.py                 200 experiments a cell, 5 minutes
    python scripts/benchmarks/bench_knee.py --experiments 20 --pairs 400

Scores are uniform from 0 to 1, log10 errors normal around a level that doubles or is three times as
large below 0.5, also on top of a gradual rise; their spread (0.35) and that of the blocks (0.1, 30
of them) are those of registrations on the public logs. ``smallest`` is the median of what a
calibration says that it would have found four times in five.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

import numpy as np
import pandas as pd

from rbtm_bench.calibration.knee import knee
from rbtm_bench.core.types import Array

SHAPES = (
    *("none", "line", "smooth"),
    *("doubling", "doubling on a line", "threefold", "threefold, 0.1 wide"),
)
SPREAD, OF_BLOCKS, BLOCKS = 0.35, 0.1, 30


def level(shape: str, s: Array) -> Array:
    """log10 of the median error at scores (K,)."""
    below = s < 0.5
    return {
        "none": 0.0 * s,
        "line": -0.6 * s,
        "smooth": -0.3 * np.tanh(2.0 * (s - 0.5)),
        "doubling": np.log10(2.0) * below,
        "doubling on a line": np.log10(2.0) * below - 0.6 * s,
        "threefold": np.log10(3.0) * below,
        "threefold, 0.1 wide": np.log10(3.0) / (1.0 + np.exp(2.0 * np.log(9.0) * (s - 0.5) / 0.1)),
    }[shape]


def experiment(shape: str, pairs: int, seed: int) -> tuple[Array, Array, Array]:
    """Scores, errors (m) and blocks (K,)."""
    random = np.random.default_rng([seed, pairs])
    s, block = random.uniform(0.0, 1.0, pairs), np.arange(pairs) * BLOCKS // pairs
    y = level(shape, s) + random.normal(0.0, SPREAD, pairs)
    return s, 10 ** (y + random.normal(0.0, OF_BLOCKS, BLOCKS)[block] - 1.5), block


def row(shape: str, pairs: int, experiments: int) -> dict[str, str]:
    knees = [knee(*experiment(shape, pairs, seed)) for seed in range(experiments)]
    rises = [k.rise.value for k in knees if k.present and k.rise is not None]
    return {
        "errors": shape,
        "pairs": str(pairs),
        "called a knee": f"{np.mean([k.present for k in knees]):.1%}",
        "its rise": f"{np.median(rises):.2f}" if rises else "",
        "smallest": f"{np.median([k.smallest for k in knees]):.2f}",
    }


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--experiments", type=int, default=200, help="a cell (default 200)")
    parser.add_argument("--pairs", default="400,1500", help="numbers of pairs (default 400,1500)")
    options = parser.parse_args(argv)
    pairs = [int(word) for word in options.pairs.split(",")]
    rows = [row(shape, n, options.experiments) for n in pairs for shape in SHAPES]
    print(pd.DataFrame(rows).to_markdown(index=False))
    return 0


if __name__ == "__main__":
    sys.exit(main())
