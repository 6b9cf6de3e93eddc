"""Files made to hang, fill or end a reader: each is one line, and soon."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from stat_helpers import MM, make_run

from rbtm_bench.cli.commands import main
from rbtm_bench.core import bounded
from rbtm_bench.core.errors import DataError

LAUGHS = "a0: &a0 [lol, lol, lol, lol, lol, lol, lol, lol, lol]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)
"""9^12 times "lol" in half a kilobyte."""


def fifo(path: Path) -> None:
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def folder(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.mkdir()


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(10_000_000_000)  # takes no room on the disk


def written(text: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(text)


ATTACKS: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "fifo": ("run.json", fifo, "not a regular file"),
    "fifo of metrics": ("metrics.json", fifo, "not a regular file"),
    "device": ("run.json", lambda p: (p.unlink(), p.symlink_to("/dev/zero")), "not a regular file"),
    "folder": ("config.yaml", folder, "not a regular file"),
    "sparse": ("run.json", sparse, "10000000000 bytes"),
    "deep json": ("run.json", written("[" * 1_000_000), "not readable as JSON"),
    "no object": ("run.json", written("[1]"), "expected an object"),
    "not text": ("metrics.json", lambda p: p.write_bytes(b"\xff\xfe{"), "not UTF-8"),
    "alias bomb": ("config.yaml", written(LAUGHS), "aliases are not read"),
    "deep yaml": ("config.yaml", written("[" * 1_000_000), "nested deeper than 100 levels"),
    "deep blocks": ("config.yaml", written("- " * 20_000 + "x"), "nested deeper"),
    "yaml of a class": ("config.yaml", written("!!python/object/apply:os.system [ls]"), "YAML"),
}  # fmt: skip


@pytest.mark.parametrize("name", ATTACKS)
@pytest.mark.parametrize("command", ["table", "show", "plot", "gate", "export", "diff"])
def test_an_attack_is_one_line_or_a_row(
    name: str, command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, attack, words = ATTACKS[name]
    run = make_run(tmp_path / "bad", "rbtm", {MM: 1.0})
    good = make_run(tmp_path / "good", "previous", {MM: 2.0})
    attack(run / file)
    arguments = {
        "show": [run], "export": [run, "--to", "csv"], "diff": [run, good],
        "gate": [tmp_path, "--max", f"{MM}=9"],
    }  # fmt: skip
    code = main([command, *map(str, arguments.get(command, [tmp_path]))])
    told = capsys.readouterr()
    assert "Traceback" not in told.out + told.err
    if command in ("table", "gate"):
        assert "unreadable" in told.out or words in told.out
    else:
        assert code == 2 and told.err.strip().splitlines()[-1].startswith("rbtm-bench: ")
        assert command == "plot" or words in told.err


def test_a_parquet_bomb_is_refused_before_it_unpacks(tmp_path: Path) -> None:
    path = tmp_path / "bomb.parquet"
    zeros = pa.table({"gap": np.zeros(12_000_000, np.int64)})
    pq.write_table(zeros, path, compression="zstd", use_dictionary=False)
    assert path.stat().st_size < 1_000_000
    with pytest.raises(DataError, match=r"12000000 rows, \d+ bytes in a file of \d+: refused"):
        bounded.read_parquet(path)


def test_parquet_of_ours_is_read_and_damaged_is_one_line(tmp_path: Path) -> None:
    path = tmp_path / "steps.parquet"
    pq.write_table(pa.table({"gap": [1, 2], "scan": [0, 1]}), path)
    assert bounded.read_parquet(path, ["gap", "not there"]).to_pydict() == {"gap": [1, 2]}
    content = path.read_bytes()
    length = struct.pack("<I", 2**31 - 1)
    for bad in (content[:-8] + length + b"PAR1", content[:20], b"", b"PAR1" * 9):
        path.write_bytes(bad)
        with pytest.raises(DataError, match="not a readable table"):
            bounded.read_parquet(path)


def test_yaml_is_read_as_omegaconf_does(tmp_path: Path) -> None:
    path = tmp_path / "config.yaml"
    path.write_text("a: 1e-5\nb: 2020-01-02\nc: {d: '*', e: 'x & y'}\n")
    assert bounded.read_yaml(path) == {"a": 1e-5, "b": "2020-01-02", "c": {"d": "*", "e": "x & y"}}
    path.write_text(json.dumps({"x": list(range(5000))}))
    assert len(bounded.read_yaml(path)["x"]) == 5000
