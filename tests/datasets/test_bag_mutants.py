"""Damaged bags: refused in one line, or read with every beam and point accounted for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bag_writer import START, Messages, drive
from reader_mutants import POINTS, Format, cloud, mutated, outcome

from rbtm_bench.datasets.bag import Bag

FEW, MANY = 20, 200
KINDS = ("bag", "bag bz2", "db3", "mcap")


def form(kind: str, what: str) -> Format:
    make = Messages(kind.split()[0])

    def write(folder: Path) -> Path:
        times = [START + i * 10**8 for i in range(4)]
        scans = [make.cloud(time, cloud()) for time in times]
        if what == "laser":
            ranges = np.linspace(1, 20, POINTS)
            scans = [make.laser(time, ranges) for time in times]
        path = folder / ("a.bag" if make.kind == "bag" else "a")
        how = {}
        if kind.endswith("bz2"):
            from rosbags import rosbag1

            how = {"compression": rosbag1.Writer.CompressionFormat.BZ2}
        return make.write(path, drive(make, scans), **how)

    def find(folder: Path) -> Bag:
        return Bag(str(next(f for f in folder.rglob("a*") if f.is_file())))

    return Format(write, find)


def wrong(kind: str, what: str, folder: Path, count: int) -> dict[str, str]:
    made = form(kind, what)
    (folder / "good").mkdir()
    content = made.write(folder / "good").read_bytes()
    assert outcome(made, folder / "again", content) == "read"
    found = {}
    for seed in range(count):
        how, damaged = mutated(content, np.random.default_rng(seed))
        found[f"{how} {seed}"] = outcome(made, folder / "bad", damaged)
    return {name: text for name, text in found.items() if text not in ("read", "refused")}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("what", ["laser", "cloud"])
def test_damage_is_refused_or_accounted_for(kind: str, what: str, tmp_path: Path) -> None:
    assert not wrong(kind, what, tmp_path, FEW)


@pytest.mark.soak
@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("what", ["laser", "cloud"])
def test_much_damage_is_refused_or_accounted_for(kind: str, what: str, tmp_path: Path) -> None:
    assert not wrong(kind, what, tmp_path, MANY)
