"""The basin of convergence: how often a backend finds the motion from a wrong initial guess.

A table a backend (rows: error of the guess in m, columns: in deg, cells: share of registrations
that end within 0.1 m and 2 deg of the truth), and a figure of them all. The same pairs and the same
wrong guesses for every backend; settings are the backends' defaults at one correspondence distance.

    python scripts/benchmarks/bench_basin.py              simulated scans, exact truth
    python scripts/benchmarks/bench_basin.py dataset=carmen dataset.path=intel-corrected.log.gz
    python scripts/benchmarks/bench_basin.py dataset=kitti dataset.path=kitti dataset.sequence=0 \\
        dataset.ground_truth_frames=[14,19] --pairs 5 --metres 0 1 2 --degrees 0 5 15

Simulated scans come from three environments of the corridor; --gap scans lie between target and
source, so that they overlap as they do on a robot.
"""

from __future__ import annotations

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from rbtm_bench.backends.base import Backend
from rbtm_bench.calibration.known_pairs import KnownPair, disturbed, pairs_of, register_all
from rbtm_bench.core.files import make_folder, write_atomically
from rbtm_bench.core.types import Array
from rbtm_bench.engine.progress import bar
from rbtm_bench.plots import basins, style
from rbtm_bench.runs import assembly, plugins, settings
from rbtm_bench.runs.pinning import pin_to_free_core

ENVIRONMENTS = ("paper", "cluttered", "l_turn")
"""A bare corridor has no right answer along its axis."""
METRES, DEGREES = (0.0, 0.1, 0.25, 0.5, 1.0), (0.0, 5.0, 10.0, 20.0, 40.0)
NEAR_M, NEAR_DEG = 0.1, 2.0


def options_of(argv: Sequence[str] | None) -> tuple[argparse.Namespace, list[str]]:
    """The command line: our options, and overrides as they are."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--backends", default=None, help="names, by commas (default: all that fit)")
    parser.add_argument("--pairs", type=int, default=30, help="pairs of scans a data set")
    parser.add_argument("--gap", type=int, default=None, help="scans from target to source")
    parser.add_argument("--metres", type=float, nargs="+", default=METRES)
    parser.add_argument("--degrees", type=float, nargs="+", default=DEGREES)
    parser.add_argument("--distance", type=float, default=None, help="correspondence distance, m")
    parser.add_argument("--seed", type=int, default=0, help="of the wrong guesses")
    parser.add_argument("--out", type=Path, default=Path("results/basin"))
    return parser.parse_known_args(argv)


def load(options: argparse.Namespace, words: list[str]) -> tuple[list[KnownPair], list[str]]:
    """The pairs, and the words that backends are built with."""
    distance = options.distance
    if any(word.startswith("dataset=") for word in words):
        composed = settings.compose_settings(words)
        pairs = pairs_of(
            assembly.build(composed.config["dataset"]), options.gap or 1, options.pairs
        )
    else:
        pairs = []
        for place in ENVIRONMENTS:
            word = f"dataset.environment={place}"
            composed = settings.compose_settings([*words, word])
            dataset = assembly.build(composed.config["dataset"])
            pairs += pairs_of(dataset, options.gap or 20, -(-options.pairs // len(ENVIRONMENTS)))
    if distance is None:
        distance = 1.0
    return pairs, [*words, f"registration.max_correspondence_distance={distance}"]


def backends_for(names: str | None, planar: bool, words: list[str]) -> dict[str, Backend]:
    """The backends that register such scans, and whose libraries are there."""
    needed, backends = "2d" if planar else "3d", {}
    for name in names.split(",") if names else settings.members("backend"):
        node = settings.compose_settings([*words, f"backend={name}"]).config["backend"]
        cls = plugins.locate(f"backend={name}", node["_target_"])
        fits = isinstance(cls, type) and issubclass(cls, Backend) and needed in cls.dimensions
        if fits and not cls.is_baseline:
            backends[name] = assembly.build(node)
    return backends


def shares(
    backend: Backend, pairs: list[KnownPair], guesses: dict[tuple[float, float], list[Array]]
) -> dict[tuple[float, float], float]:
    """The share of right answers for every size of the guess's error."""
    return {
        size: float(
            np.mean([o.within(NEAR_M, NEAR_DEG) for o in register_all(backend, pairs, wrong)])
        )
        for size, wrong in guesses.items()
    }


def show(name: str, shares_of: dict[tuple[float, float], float]) -> str:
    """One backend's table."""
    rows, columns = sorted({m for m, _ in shares_of}), sorted({d for _, d in shares_of})
    lines = [f"\n{name:<18}" + "".join(f"{d:>6g} deg" for d in columns)]
    lines += [f"{m:>15g} m " + "".join(f"{shares_of[m, d]:>9.0%} " for d in columns) for m in rows]
    return "\n".join(lines)


def write(shares_of: dict[str, dict[tuple[float, float], float]], count: int, out: Path) -> Path:
    """All shares as CSV."""

    def fill(path: Path) -> None:
        with open(path, "w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(["backend", "guess_off_m", "guess_off_deg", "success", "pairs"])
            for name, values in shares_of.items():
                rows.writerows([name, m, d, share, count] for (m, d), share in values.items())

    make_folder(out)
    write_atomically(out / "basin.csv", fill)
    return out / "basin.csv"


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print, draw."""
    options, words = options_of(argv)
    pin_to_free_core()
    pairs, words = load(options, words)
    random = np.random.default_rng(options.seed)
    guesses = {
        (m, d): [disturbed(pair, m, d, random) for pair in pairs]
        for m in options.metres
        for d in options.degrees
    }
    backends = backends_for(options.backends, pairs[0].source.planar, words)
    shares_of = {}
    with bar("backends", len(backends)) as progress:
        for name, backend in backends.items():
            shares_of[name] = shares(backend, pairs, guesses)
            progress.step(name)
            print(show(name, shares_of[name]), flush=True)
    path = write(shares_of, len(pairs), options.out)
    title = f"{len(pairs)} pairs, found: within {NEAR_M:g} m and {NEAR_DEG:g} deg of the truth"
    with style.paper():
        files = style.save(basins.draw(shares_of, title), options.out, "basin")
    print(f"\n{title}\n{path}\n" + "\n".join(map(str, files)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
