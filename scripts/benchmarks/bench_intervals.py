"""How often intervals that say 95% hold the truth, on errors drawn to be like real ones.

Medians of seeds are drawn lognormal. Relations keep the real logs' times and so their clusters;
their errors are a lognormal number a cluster (sigma 1) times one a relation (sigma 0.3).

    python scripts/benchmarks/bench_intervals.py freiburg        the folder of *.relations
    python scripts/benchmarks/bench_intervals.py freiburg 300    so many trials
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from rbtm_bench.datasets.carmen_log import parse_relations
from rbtm_bench.report.intervals import cluster_interval, interval, relation_clusters

LOGS = ("aces", "intel", "mit-csail")
WITHIN = 0.3


def seeds(trials: int) -> None:
    """Medians and means of 3 to 20 seeds."""
    rng = np.random.default_rng(0)
    print("seeds   median     mean")
    for n in (3, 4, 5, 6, 10, 20):
        draws = rng.lognormal(0, 1, (trials, n))
        median = sum(not interval(x).excludes(1.0) for x in draws)
        mean = sum(not interval(x, "mean").excludes(np.exp(0.5)) for x in draws)
        print(f"{n:>5} {median / trials:>8.0%} {mean / trials:>8.0%}")


def long_relations(folder: Path, trials: int) -> None:
    """The mean over the long relations of a log, by cluster and as if each stood for itself."""
    rng = np.random.default_rng(0)
    print("log        relations  clusters  by cluster  by relation")
    for log in LOGS:
        path = folder / f"{log}.relations"
        relations = parse_relations(str(path), path.read_bytes())
        long = np.abs(relations.end - relations.start) > 30.0
        start, end = relations.start[long], relations.end[long]
        labels = relation_clusters(start, end, np.zeros(len(start), bool))
        count = int(labels.max()) + 1
        hits = np.zeros(2, int)
        for _ in range(trials):
            noise = rng.lognormal(-(WITHIN**2) / 2, WITHIN, len(labels))
            errors = rng.lognormal(0, 1, count)[labels] * noise
            for i, clusters in enumerate((labels, np.arange(len(labels)))):
                over = cluster_interval(errors, clusters, np.zeros(len(labels)))
                hits[i] += not over.excludes(np.exp(0.5))
        shares = hits / trials
        print(f"{log:<10} {len(labels):>9} {count:>9} {shares[0]:>11.0%} {shares[1]:>12.0%}")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, help="holds the .relations of " + ", ".join(LOGS))
    parser.add_argument("trials", type=int, nargs="?", default=300)
    options = parser.parse_args()
    seeds(options.trials)
    long_relations(options.folder, options.trials)


if __name__ == "__main__":
    main()
