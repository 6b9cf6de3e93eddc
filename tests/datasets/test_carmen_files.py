"""CARMEN logs and relations: what is refused, and how the message says where."""

from __future__ import annotations

import bz2
import gzip
from pathlib import Path

import numpy as np
import pytest
from carmen_writer import Write, drive, flaser

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.datasets.carmen import Carmen

# --- files ----------------------------------------------------------------------------------


def test_packed_files_are_told_by_their_content(tmp_path: Path) -> None:
    content = "\n".join(flaser(pose, i) for i, pose in enumerate(drive(3))).encode()
    packed = [content, gzip.compress(content), bz2.compress(content)]
    logs = []
    for name, data in zip(("a.gz", "b.log", "c"), packed, strict=True):
        (tmp_path / name).write_bytes(data)
        logs.append(Carmen(str(tmp_path / name)))
    for log in logs[1:]:
        np.testing.assert_array_equal(log.ranges, logs[0].ranges)
        np.testing.assert_array_equal(log.odometry, logs[0].odometry)
        assert log.fingerprint() == logs[0].fingerprint()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (gzip.compress(flaser((0, 0, 0)).encode())[:-30], "truncated archive"),
        (bz2.compress(flaser((0, 0, 0)).encode())[:-30], "truncated archive"),
        (b"\x1f\x8bjunk that is no archive", "damaged or truncated archive"),
        (gzip.compress(b"", mtime=0), "file is empty"),
        (b"", "file is empty"),
        (b" \n\n", "file is empty"),
        (bytes(range(256)) * 40, "binary data"),
        (b"ODOM 0 0 0 0 0 0 0 h 0\n", "no FLASER line"),
        (b"once upon a time\n", "no FLASER line"),
    ],
)
def test_files_that_are_no_logs(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "robot.log"
    path.write_bytes(content)
    with pytest.raises(DataError, match=message) as caught:
        Carmen(str(path))
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="found a folder"):
        Carmen(str(tmp_path))
    with pytest.raises(DataError, match="No such file"):
        Carmen(str(tmp_path / "nothing.log"))
    with pytest.raises(DataError, match="Not a directory"):
        (tmp_path / "file").touch()
        Carmen(str(tmp_path / "file" / "below.log"))


GOOD = flaser((0, 0, 0), 1.0)
LATER = [flaser((0, 0, 0), float(i)) for i in range(1, 5)]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (GOOD[:400], "FLASER: expected 191 words for 180 readings"),
        (GOOD + " 1.0", "FLASER: expected 191 words for 180 readings, 192 found"),
        ("FLASER", "number of readings: expected a count from 1 on, none found"),
        (flaser((0, 0, 0), ranges=[1.0] * 179), "expected 180 as before, '179' found"),
        (GOOD.replace(" 180 ", " many ", 1), "expected a count from 1 on, 'many' found"),
        (flaser((0, 0, 0), ranges=[1.0] * 181), "expected 180 as before, '181' found"),
        (GOOD.replace(" 1.5 ", " 1,5 "), "range: expected a number, '1,5' found"),
        (flaser((0, 0, 0), float("nan")), "ipc_timestamp: expected a finite number, 'nan'"),
        (flaser((float("inf"), 0, 0)), "pose: expected a finite number, 'inf' found"),
        (flaser((0, 0, 0), robot=(0, 0, float("nan"))), "pose: expected a finite number"),
        ("ODOM 0 0 0", "ODOM: expected 10 words, 4 found"),
        ("ODOM 0 0 x 0 0 0 0 host 0", "pose: expected a number, 'x' found"),
        ("PARAM robot_front_laser_max far", "robot_front_laser_max: expected a number"),
    ],
)
def test_malformed_lines(write: Write, line: str, message: str) -> None:
    path = write("# header", GOOD, line, GOOD)
    with pytest.raises(DataError, match=message) as caught:
        Carmen(path)
    assert str(caught.value).startswith(f"{path}, line 3, ")
    log = Carmen(path, on_error="skip")
    assert (len(log), log.skipped) == (2, 1)


def test_nothing_left_after_skipping(write: Write) -> None:
    path = write(GOOD[:300], GOOD[:200])
    with pytest.raises(
        DataError, match=r"no usable line with readings, 2 malformed; .* line 1, FLASER"
    ):
        Carmen(path, on_error="skip")


def test_fingerprint(write: Write) -> None:
    lines = [flaser(pose, i) for i, pose in enumerate(drive(3))]
    path = write(*lines)
    base = Carmen(path).fingerprint()
    assert base == Carmen(write(*lines, name="elsewhere.log")).fingerprint()
    relations = write("0 1 0.1 0 0 0 0 0.05", name="relations")
    others = [
        Carmen(write(*lines[:2], name="shorter.log")),
        Carmen(path, max_range=5.0),
        Carmen(path, min_range=0.5),
        Carmen(path, stride=2),
        Carmen(path, min_distance=0.01),
        Carmen(path, max_scans=2),
        Carmen(path, order="time"),
        Carmen(path, relations=relations),
    ]
    assert len({base, *(log.fingerprint() for log in others)}) == len(others) + 1
    assert base == Carmen(path, corrected=False).fingerprint()


# --- relations ------------------------------------------------------------------------------


def test_relations(write: Write) -> None:
    """Roll turns y to z, pitch turns x to -z, yaw turns x to y; roll is done first."""
    half = np.pi / 2
    rows = [f"1 2 0.1 0.2 0.3 {half} 0 0", f"2 3 0 0 0 0 {half} 0", f"3 4 0 0 0 {half} 0 {half}"]
    log = Carmen(write(*LATER), relations=write("# t1 t2 ...", *rows, name="relations"))
    relations = log.relations
    assert relations is not None and len(relations) == 3
    assert relations.start.tolist() == [1, 2, 3] and relations.end.tolist() == [2, 3, 4]
    R = relations.T_start_end[:, :3, :3]
    np.testing.assert_allclose(relations.T_start_end[0, :3, 3], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(R[0] @ [0, 1, 0], [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(R[1] @ [1, 0, 0], [0, 0, -1], atol=1e-15)
    np.testing.assert_allclose(R[2] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(R[2] @ [0, 1, 0], [0, 0, 1], atol=1e-15)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1 2 3 4 5 6 7", "line 2, relation: expected 8 numbers .*, 7 words found"),
        ("1 2 3 4 5 6 7 8 9", "9 words found"),
        ("1 2 x 4 5 6 7 8", "line 2, relation: expected a number, 'x' found"),
        ("1 2 nan 4 5 6 7 8", "line 2, relation: expected a finite number"),
    ],
)
def test_malformed_relations(write: Write, line: str, message: str) -> None:
    relations = write("1 2 3 4 5 6 7 8", line, name="relations")
    with pytest.raises(DataError, match=message):
        Carmen(write(GOOD), relations=relations)


def test_no_relations(write: Write, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="no relation in the file"):
        Carmen(write(GOOD), relations=write("# nothing", name="relations"))
    with pytest.raises(DataError, match="No such file"):
        Carmen(write(GOOD), relations=str(tmp_path / "nothing"))
    lost = write(*(flaser((i, 0, 0), 1.0) for i in range(4)), name="lost.log")
    with pytest.raises(ConfigError, match="lost its times"):
        Carmen(lost, relations=write("1 2 3 4 5 6 7 8", name="relations"))
