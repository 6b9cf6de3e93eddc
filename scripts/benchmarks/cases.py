"""Small inputs that are easily read wrongly: what comes of each now, as a table.

    python scripts/benchmarks/cases.py FOLDER

A row a case: every log, folder of clouds, trajectory and damaged file below FOLDER is read as
`rbtm-bench data` would (trajectories and relations with the right clouds and the right log), every
scan of it. tests/datasets/test_cases.py holds them to the right values; here one sees the words.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from pathlib import Path

from rbtm_bench.core.errors import RbtmBenchError
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.cloud_files import read_points
from rbtm_bench.datasets.cloud_folder import CloudFolder
from rbtm_bench.datasets.kitti import Kitti

TELLING = ("truth", "odometry", "angles", "no return", "layout", "frame", "unit", "relations")
"""Readings that the cases are about."""


def outcomes(root: Path) -> Iterator[tuple[str, str]]:
    """The name of every case and what comes of it."""
    for case in sorted(path for path in root.iterdir() if path.is_dir()):
        name = case.name
        if (case / "log.clf").is_file():
            relations = case / "log.relations"
            given = str(relations) if relations.is_file() else None
            yield name, read(lambda c=case, g=given: Carmen(str(c / "log.clf"), g))
        elif (case / "clouds").is_dir():
            yield name, read(lambda c=case: clouds(c / "clouds", c / "poses.tum"))
        elif name == "relations":
            for file in sorted(case.iterdir()):
                log = str(root / "c_base" / "log.clf")
                yield f"{name}/{file.name}", read(lambda g=log, f=file: Carmen(g, str(f)))
        elif name == "tum":
            for file in sorted(case.iterdir()):
                base = root / "baseline" / "clouds"
                yield f"{name}/{file.name}", read(lambda b=base, f=file: clouds(b, f))
        elif name == "kitti_layout":
            for place in sorted(case.iterdir()):
                yield f"{name}/{place.name}", read(lambda p=place: Kitti(str(p)))
        elif name == "damaged":
            for file in sorted(case.glob("*.[np][cpl][dy]")):
                yield f"{name}/{file.name}", damaged(file)
        else:
            for place in sorted(path for path in case.iterdir() if path.is_dir()):
                yield f"{name}/{place.name}", read(lambda p=place: CloudFolder(str(p)))


def clouds(folder: Path, poses: Path) -> CloudFolder:
    """A folder of clouds with its truth."""
    return CloudFolder(str(folder), poses=str(poses))


def read(open_it: object) -> str:
    """What comes of a data set, all of it read."""
    try:
        data: Dataset = open_it()  # type: ignore[operator]
        points = sum(len(scan.points) for scan in data)
    except RbtmBenchError as error:
        return f"refused: {error}"
    words = [f"{len(data)} scans, {points} points"]
    words += [f"{r.what} {r.taken}" for r in data.readings if r.what in TELLING]
    words += [f"CAUTION {text}" for text in data.suspicions]
    return "; ".join(words)


def damaged(file: Path) -> str:
    """What comes of one file of points."""
    try:
        return f"read: {len(read_points(file))} points"
    except RbtmBenchError as error:
        return f"refused: {error}"


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    if not folder.is_dir():
        print(f"{folder}: no such folder", file=sys.stderr)
        return 2
    print("| case | now |\n|---|---|")
    for name, words in outcomes(folder):
        print(f"| {name} | {words.replace(str(folder) + '/', '').replace('|', ' ')} |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
