"""KITTI's layout by KISS-ICP's loader: frames, truth in the laser's frame, and every damage."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from rbtm_bench.cli.commands import main
from rbtm_bench.core.errors import ConfigError, DataError, RbtmBenchError
from rbtm_bench.core.geometry import inverse, se2, transform, translation_norm
from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets import kiss_loader
from rbtm_bench.datasets.kitti import Kitti

COUNT = 5
POINTS = np.random.default_rng(0).uniform(-20, 20, (60, 3)).astype(np.float32)

TR = np.array([[0, -1, 0, -0.012], [0, 0, -1, -0.054], [1, 0, 0, -0.292], [0, 0, 0, 1.0]])
"""Camera from laser: the camera looks along the laser's x, with its y down."""


def laser_poses(count: int = COUNT) -> Array:
    return np.stack([se2(0.8 * i, 0.05 * i * i, 0.02 * i) for i in range(count)])


def rows(matrices: Array) -> str:
    return "\n".join(" ".join(f"{v:.6e}" for v in T[:3].ravel()) for T in matrices) + "\n"


@pytest.fixture
def kitti(tmp_path: Path) -> Path:
    """Sequence 4 with five scans of 60 points, and sequence 12, which has no poses."""
    for name in ("04", "12"):
        folder = tmp_path / "sequences" / name
        (folder / "velodyne").mkdir(parents=True)
        (folder / "calib.txt").write_text("P0: 1 0 0 0\n" + "Tr: " + rows(TR[None]))
        (folder / "times.txt").write_text("".join(f"{0.1 * i:.6e}\n" for i in range(COUNT)))
        for i in range(COUNT):
            scan = np.column_stack([POINTS + np.float32(i), np.ones(len(POINTS), np.float32)])
            scan.tofile(folder / "velodyne" / f"{i:06d}.bin")
    (tmp_path / "poses").mkdir()
    (tmp_path / "poses" / "04.txt").write_text(rows(TR @ laser_poses() @ np.linalg.inv(TR)))
    return tmp_path


def scan_file(kitti: Path, number: int = 2) -> Path:
    return kitti / "sequences" / "04" / "velodyne" / f"{number:06d}.bin"


def elevation(points: Array) -> Array:
    return np.degrees(np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])))


# --- what is read ---------------------------------------------------------------------------


def test_points_stamps_and_flags(kitti: Path) -> None:
    data = Kitti(str(kitti), 4, correct_scans=False)
    assert len(data) == COUNT and data.has_ground_truth
    assert not (data.planar or data.has_beams or data.has_odometry)
    for i, scan in enumerate(data):
        assert scan.index == i and scan.stamp == pytest.approx(0.1 * i)
        assert scan.points.dtype == np.float64
        np.testing.assert_array_equal(scan.points, POINTS + np.float32(i))
    with pytest.raises(IndexError):
        data[COUNT]


def test_correction_turns_points_up_by_0205_deg(kitti: Path) -> None:
    plain, corrected = Kitti(str(kitti), 4, correct_scans=False), Kitti(str(kitti), 4)
    change = elevation(corrected[0].points) - elevation(plain[0].points)
    np.testing.assert_allclose(change, 0.205, atol=1e-9)
    lengths = [np.linalg.norm(data[0].points, axis=1) for data in (plain, corrected)]
    np.testing.assert_allclose(*lengths, atol=1e-12)


def test_poses_are_brought_into_the_frame_of_the_laser(kitti: Path) -> None:
    truth = np.stack([scan.ground_truth for scan in Kitti(str(kitti), 4)])
    np.testing.assert_allclose(truth, laser_poses(), atol=2e-6)  # files have seven digits
    off = np.swapaxes(truth[:, :3, :3], 1, 2) @ truth[:, :3, :3] - np.eye(3)
    assert np.abs(off).max() < 1e-12


def test_truth_only_over_the_frames_that_are_asked_for(kitti: Path) -> None:
    data = Kitti(str(kitti), 4, ground_truth_frames=(1, 3))
    assert [scan.ground_truth is not None for scan in data] == [False, True, True, True, False]
    every_second = Kitti(str(kitti), 4, ground_truth_frames=(1, 3), stride=2)
    assert [scan.ground_truth is not None for scan in every_second] == [False, True, False]
    assert not Kitti(str(kitti), 4, ground_truth_frames=(3, 4), max_scans=2).has_ground_truth
    with pytest.raises(ConfigError, match=r"ground_truth_frames=\[3,1\]: expected first, last"):
        Kitti(str(kitti), 4, ground_truth_frames=(3, 1))


def test_sequences_from_11_on_have_no_truth(kitti: Path) -> None:
    data = Kitti(str(kitti), 12)
    assert len(data) == COUNT and not data.has_ground_truth and data[0].ground_truth is None


def test_poses_of_semantic_kitti_and_none(kitti: Path) -> None:
    before = np.stack([scan.ground_truth for scan in Kitti(str(kitti), 4)])
    (kitti / "poses" / "04.txt").rename(kitti / "sequences" / "04" / "poses.txt")
    after = np.stack([scan.ground_truth for scan in Kitti(str(kitti), 4)])
    np.testing.assert_array_equal(before, after)
    (kitti / "sequences" / "04" / "poses.txt").unlink()
    data = Kitti(str(kitti), 4)
    assert not data.has_ground_truth and data.readings[0].taken == "none"


def test_stride_max_scans_and_range(kitti: Path) -> None:
    thinned = Kitti(str(kitti), 4, stride=2, max_scans=2)
    assert [scan.stamp for scan in thinned] == pytest.approx([0.0, 0.2])
    near = Kitti(str(kitti), 4, min_range=5.0, max_range=15.0)[0].points
    distance = np.linalg.norm(POINTS.astype(float), axis=1)
    assert len(near) == np.count_nonzero((distance > 5.0) & (distance < 15.0)) > 0


def test_a_part_of_a_sequence_keeps_its_numbers(kitti: Path) -> None:
    for number in (0, 1):
        scan_file(kitti, number).unlink()
    data = Kitti(str(kitti), 4)
    assert len(data) == 3 and data[0].index == 0 and data[0].stamp == pytest.approx(0.2)
    np.testing.assert_allclose(data[0].ground_truth, laser_poses()[2], atol=2e-6)


def test_points_that_are_not_finite_are_dropped(kitti: Path) -> None:
    scan = np.ones((4, 4), np.float32) * np.arange(1, 5, dtype=np.float32)[:, None]
    scan[1, 2], scan[3, 0] = np.nan, np.inf
    scan.tofile(scan_file(kitti))
    assert len(Kitti(str(kitti), 4)[2].points) == 2
    np.full((3, 4), np.nan, np.float32).tofile(scan_file(kitti))
    with pytest.raises(
        DataError, match=r"000002\.bin: no point within range \(3 points in the file\)"
    ):
        Kitti(str(kitti), 4)[2]


def test_fingerprint(kitti: Path) -> None:
    first = Kitti(str(kitti), 4).fingerprint()
    assert first == Kitti(str(kitti), 4).fingerprint()
    others = [
        Kitti(str(kitti), 12).fingerprint(),
        Kitti(str(kitti), 4, correct_scans=False).fingerprint(),
        Kitti(str(kitti), 4, stride=2).fingerprint(),
        Kitti(str(kitti), 4, max_range=9.0).fingerprint(),
        Kitti(str(kitti), 4, ground_truth_frames=(0, 2)).fingerprint(),
    ]
    for name in ("velodyne/000002.bin", "calib.txt", "times.txt"):
        path = kitti / "sequences" / "04" / name
        before = path.read_bytes()
        changed = before.replace(b"2.", b"2.1", 1) if name == "times.txt" else before
        changed = before.replace(b"-1.2", b"-1.3", 1) if name == "calib.txt" else changed
        path.write_bytes(changed if changed != before else before + 16 * b"\0")
        others.append(Kitti(str(kitti), 4).fingerprint())
        path.write_bytes(before)
    assert len({first, *others}) == len(others) + 1


# --- what is wrong with it ------------------------------------------------------------------


def remove(name: str) -> Callable[[Path], object]:
    def change(kitti: Path) -> None:
        path = kitti / name
        if path.is_dir():
            for file in path.iterdir():
                file.unlink()
            path.rmdir()
        else:
            path.unlink()

    return change


def write(name: str, text: str) -> Callable[[Path], object]:
    return lambda kitti: (kitti / name).write_text(text)


FOUR = "sequences/04"
DAMAGES: dict[str, tuple[Callable[[Path], object], str]] = {
    "no scans": (remove(f"{FOUR}/velodyne"), "velodyne: no such folder: expected the scans"),
    "no calibration": (remove(f"{FOUR}/calib.txt"), "calib.txt: no such file: expected the line"),
    "no times": (remove(f"{FOUR}/times.txt"), "times.txt: no such file: expected"),
    "empty scan": (write(f"{FOUR}/velodyne/000002.bin", ""), "000002.bin: the file is empty"),
    "truncated scan": (
        lambda kitti: scan_file(kitti).write_bytes(scan_file(kitti).read_bytes()[:-3]),
        "957 bytes are no whole number of records of 16 bytes",
    ),
    "no Tr": (write(f"{FOUR}/calib.txt", "P0: 1 0\n"), "calib.txt: expected a line Tr: with 12"),
    "short Tr": (write(f"{FOUR}/calib.txt", "Tr: 1 0 0\n"), "line 1, Tr: expected 12 numbers, 3"),
    "word in Tr": (write(f"{FOUR}/calib.txt", "Tr: a 0 0\n"), "line 1, Tr: expected a number"),
    "Tr no motion": (write(f"{FOUR}/calib.txt", "Tr: " + "1 " * 12), "expected a rigid motion"),
    "word in times": (write(f"{FOUR}/times.txt", "0\nx\n"), "times.txt, line 2, time: expected a"),
    "few times": (write(f"{FOUR}/times.txt", "0\n1\n"), "2 times, but the last scan is 000004"),
    "few poses": (write("poses/04.txt", rows(np.eye(4)[None])), "1 poses, but the last scan is"),
    "bad poses": (write("poses/04.txt", "1 2 3\n"), "04.txt, line 1, pose: expected 8 columns"),
    "odd name": (
        lambda kitti: scan_file(kitti).rename(scan_file(kitti).with_name("two.bin")),
        "two.bin: expected a frame's number as its name",
    ),
    "odd digits": (
        lambda kitti: scan_file(kitti).rename(scan_file(kitti).with_name("2.bin")),
        "velodyne: expected names of one length",
    ),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_one_line_that_says_where(kitti: Path, damage: str) -> None:
    change, named = DAMAGES[damage]
    change(kitti)
    with pytest.raises(DataError) as caught:
        Kitti(str(kitti), 4)
    text = str(caught.value)
    assert named in text and str(kitti) in text and len(text.splitlines()) == 1


def test_no_such_sequence_no_such_folder(kitti: Path) -> None:
    with pytest.raises(DataError, match=r"sequences/07: no such sequence; found 04, 12"):
        Kitti(str(kitti), 7)
    with pytest.raises(DataError, match=r"nowhere/sequences: no such folder: expected KITTI's"):
        Kitti(str(kitti / "nowhere"))
    empty = kitti / "sequences" / "04" / "velodyne"
    for file in empty.iterdir():
        file.unlink()
    with pytest.raises(DataError, match=r"velodyne: no \.bin file"):
        Kitti(str(kitti), 4)


def test_what_the_check_does_not_see_the_loader_says(kitti: Path) -> None:
    path = kitti / FOUR / "calib.txt"
    path.write_text("P0: one two\n" + path.read_text())
    with pytest.raises(DataError, match=r"loader kitti cannot read it: ValueError: could not con"):
        Kitti(str(kitti), 4)


# --- loaders that print and exit ------------------------------------------------------------


def test_prints_and_exits_become_errors(capsys: pytest.CaptureFixture[str]) -> None:
    def leave() -> None:
        print("[ERROR] no such\n topic")
        sys.exit(1)

    def lack() -> None:
        raise ModuleNotFoundError("No module named 'natsort'")

    def chat() -> int:
        print("Indexing ...")
        return 7

    with pytest.raises(DataError, match=r"^a\.bag: KISS-ICP's loader rosbag .*no such topic$"):
        kiss_loader.quietly("rosbag", "a.bag", leave)
    with pytest.raises(DataError, match=r"it exited with 1$"):
        kiss_loader.quietly("rosbag", "a.bag", lambda: sys.exit(1))
    with pytest.raises(ConfigError, match="loader ncd needs a package: No module"):
        kiss_loader.quietly("ncd", "a", lack)
    assert kiss_loader.quietly("ouster", "a", chat) == 7
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("name", ["apollo", "generic", "helipr", "mulran", "rosbag", "tum"])
def test_every_loader_fails_by_our_errors(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(RbtmBenchError) as caught:
        kiss_loader.open_loader(name, tmp_path, sequence="0", topic="/points")
    assert len(str(caught.value).splitlines()) == 1 and name in str(caught.value)
    assert capsys.readouterr().out == ""


# --- the command line -----------------------------------------------------------------------


def test_mistakes_are_exit_code_2(
    kitti: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["dataset=kitti", f"dataset.path='{kitti}'", "backend=none", "pin=false"]
    for word, named in (
        ("dataset.sequence=7", "no such sequence"),
        ("dataset.sequence=-1", "dataset.sequence=-1: "),
        ("dataset.ground_truth_frames=[1]", "dataset.ground_truth_frames=[1]: "),
        ("dataset.path=nowhere", "nowhere/sequences: no such folder"),
    ):
        assert main(["run", *given, f"out='{tmp_path / 'out'}'", word]) == 2
        error = capsys.readouterr().err
        assert named in error and len(error.splitlines()) == 1
        assert not (tmp_path / "out").exists()


def test_metrics_are_of_the_frames_with_truth(kitti: Path, tmp_path: Path) -> None:
    """No registration, no motion: the error is the true motion over the frames with truth."""
    words = ["dataset=kitti", f"dataset.path='{kitti}'", "dataset.sequence=4", "pin=false"]
    frames = "dataset.ground_truth_frames=[1,3]"
    more = ["backend=none", "selector=previous", "guess=identity"]
    assert main(["run", *words, frames, *more, f"out='{tmp_path / 'out'}'"]) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    true = inverse(laser_poses()[1]) @ laser_poses()
    steps = translation_norm(inverse(true[1:3]) @ true[2:4])
    assert metrics["final_translation_error_mm"] == pytest.approx(
        1e3 * translation_norm(true[3]), abs=0.1
    )
    assert metrics["ape_max_m"] == pytest.approx(translation_norm(true[3]), abs=1e-4)
    expected = float(np.sqrt(np.mean(steps**2)))
    assert metrics["rpe_translation_rmse_m"] == pytest.approx(expected, abs=1e-4)
    assert not (tmp_path / "out" / "ground_truth.tum").exists()  # it cannot say "not known"


# --- the real frames ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def real(data_dir: Path) -> Kitti:
    return Kitti(str(data_dir / "kitti"), 0, ground_truth_frames=(14, 19))


def test_real_frames(real: Kitti) -> None:
    assert len(real) == 20 and real[0].stamp == 0.0
    assert real[19].stamp == pytest.approx(1.968, abs=0.05)
    sizes = [len(real[i].points) for i in (0, 10, 19)]
    assert sizes == [124668, 121018, 124301]
    assert [real[i].ground_truth is not None for i in (0, 13, 14, 19)] == [False, False, True, True]
    # the road lies 1.73 m below the laser, level once the scans are corrected
    points = real[19].points
    near = points[(np.hypot(points[:, 0], points[:, 1]) < 10) & (np.abs(points[:, 1]) < 3)]
    assert np.median(near[near[:, 2] < -1.2][:, 2]) == pytest.approx(-1.73, abs=0.08)


def test_the_first_true_poses_are_doubted(real: Kitti, data_dir: Path, kitti: Path) -> None:
    (doubt,) = Kitti(str(data_dir / "kitti")).suspicions
    assert "frames 0 to 14 make the same step of 0.860 m, 14 times" in doubt
    assert "dataset.ground_truth_frames=[14,19]" in doubt
    assert real.suspicions == () and Kitti(str(kitti), 4).suspicions == ()


def test_real_poses_agree_with_calib(real: Kitti, data_dir: Path) -> None:
    words = (data_dir / "kitti" / "sequences" / "00" / "calib.txt").read_text().split()
    Tr = np.vstack([np.array(words[1:13], dtype=float).reshape(3, 4), [0, 0, 0, 1]])
    camera = np.loadtxt(data_dir / "kitti" / "poses" / "00.txt").reshape(-1, 3, 4)
    for i in (14, 19):
        expected = np.linalg.inv(Tr) @ np.vstack([camera[i], [0, 0, 0, 1]]) @ Tr
        np.testing.assert_allclose(real[i].ground_truth, expected, atol=2e-6)


def test_real_truth_moves_points_onto_points(real: Kitti) -> None:
    """Frames 14 and 19 fit by the truth, which forgotten or inverted calibration would spoil."""
    from scipy.spatial import cKDTree

    first, last = real[14], real[19]
    assert first.ground_truth is not None and last.ground_truth is not None
    motion = inverse(first.ground_truth) @ last.ground_truth
    assert motion[0, 3] == pytest.approx(4.36, abs=0.02) and abs(motion[1, 3]) < 0.3
    walls = [s.points[s.points[:, 2] > -1.0] for s in (first, last)]
    tree = cKDTree(walls[0])
    apart = [
        np.median(tree.query(transform(T, walls[1]))[0])
        for T in (motion, inverse(motion), np.eye(4))
    ]
    assert apart[0] < 0.1 and apart[0] < 0.5 * min(apart[1:])


def test_real_run_is_scored_over_frames_14_to_19(data_dir: Path, tmp_path: Path) -> None:
    words = ["dataset=kitti", f"dataset.path='{data_dir / 'kitti'}'", "pin=false"]
    frames = ["dataset.ground_truth_frames=[14,19]", "backend=none", "selector=previous"]
    assert main(["run", *words, *frames, "pictures=false", f"out='{tmp_path / 'out'}'"]) == 0
    metrics = json.loads((tmp_path / "out" / "metrics.json").read_text())
    assert metrics["final_translation_error_mm"] == pytest.approx(4363, abs=20)  # the whole way
    assert len(Trajectory.read_tum(tmp_path / "out" / "trajectory.tum")) == 20
