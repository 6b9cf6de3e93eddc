"""Write a simulated 3D drive: a folder of clouds and poses.tum, ready for dataset=cloud_folder."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from rbtm_bench.core.errors import RbtmBenchError
from rbtm_bench.datasets.simulated_hall import FORMATS, RING_ELEVATIONS_DEG, write_hall


def main(argv: Sequence[str] | None = None) -> int:
    """Parse the command line, simulate and say what was written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path, metavar="OUT", help="a new or empty folder")
    parser.add_argument("--scans", type=_count, default=40, help="number of clouds (%(default)s)")
    parser.add_argument("--seed", type=_whole, default=0, help="of the noise (%(default)s)")
    parser.add_argument("--step", type=_length, default=0.15, help="m a scan (%(default)s)")
    parser.add_argument("--noise", type=_length, default=0.01, help="m, std (%(default)s)")
    parser.add_argument("--format", choices=FORMATS, default="ply", help="(%(default)s)")
    parser.add_argument("--rings", type=int, choices=RING_ELEVATIONS_DEG, default=16)
    args = parser.parse_args(argv)
    try:
        sizes = write_hall(
            args.out, args.scans, args.seed, args.step, args.noise, args.format, args.rings
        )
    except (RbtmBenchError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_code if isinstance(error, RbtmBenchError) else 1
    print(f"{args.out}: {len(sizes)} clouds of {min(sizes)} to {max(sizes)} points, poses.tum")
    return 0


def _whole(text: str) -> int:
    if (value := int(text)) < 0:
        raise argparse.ArgumentTypeError("expected 0 or more")
    return value


def _count(text: str) -> int:
    if (value := int(text)) < 1:
        raise argparse.ArgumentTypeError("expected 1 or more")
    return value


def _length(text: str) -> float:
    if not 0.0 <= (value := float(text)) < float("inf"):
        raise argparse.ArgumentTypeError("expected 0 or more metres")
    return value


if __name__ == "__main__":
    sys.exit(main())
