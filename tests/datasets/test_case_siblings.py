"""Other inputs of the same kinds as ``test_cases``: made from its right ones, each read rightly,
or refused, or loudly doubted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from carmen_writer import flaser, odom
from scipy.spatial.transform import Rotation

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.geometry import inverse, se3, transform
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.carmen import Carmen
from rbtm_bench.datasets.cloud_folder import CloudFolder

Poses = list[list[float]]


# --- clouds


@pytest.fixture(scope="module")
def right(cases_dir: Path) -> CloudFolder:
    base = cases_dir / "baseline"
    return CloudFolder(str(base / "clouds"), poses=str(base / "poses.tum"))


def rows(right: CloudFolder) -> Array:
    """t x y z qx qy qz qw of the eight clouds."""
    assert right.ground_truth is not None
    T = right.ground_truth
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    return np.column_stack([0.1 * np.arange(8), T[:, :3, 3], quaternions])


def written(
    folder: Path,
    clouds: list[Array],
    poses: Array | bytes,
    names: list[str] | None = None,
    **settings: object,
) -> CloudFolder:
    (folder / "clouds").mkdir()
    for index, cloud in enumerate(clouds):
        np.save(folder / "clouds" / f"{names[index] if names else f'{index:06d}'}.npy", cloud)
    if isinstance(poses, bytes):
        (folder / "poses.tum").write_bytes(poses)
    else:
        np.savetxt(folder / "poses.tum", poses, fmt="%.9f")
    return CloudFolder(str(folder / "clouds"), poses=str(folder / "poses.tum"), **settings)  # type: ignore[arg-type]


EPOCH = 1700000000
NAMES = {
    "whole numbers among decimals": [str(EPOCH + i // 2) + ".5" * (i % 2) for i in range(8)],
    "before and after zero": [f"{0.1 * i - 0.4:.1f}" for i in range(8)],
    "seconds and nanoseconds": [f"{EPOCH}_{100_000_000 * i:09d}" for i in range(8)],
    "numbers padded to ten digits": [f"{i:010d}" for i in range(8)],
}
TIMES = {
    "whole numbers among decimals": EPOCH + 0.5 * np.arange(8),
    "before and after zero": 0.1 * np.arange(8) - 0.4,
    "seconds and nanoseconds": EPOCH + 0.1 * np.arange(8),
    "numbers padded to ten digits": 0.1 * np.arange(8),
}


@pytest.mark.parametrize("kind", NAMES)
def test_names_that_are_times_sort_and_count_as_such(
    right: CloudFolder, tmp_path: Path, kind: str
) -> None:
    poses = rows(right)
    poses[:, 0] = TIMES[kind]
    data = written(tmp_path, [scan.points for scan in right], poses, NAMES[kind])
    assert len(data) == 8
    np.testing.assert_allclose(data.stamps, TIMES[kind], atol=1e-6)
    for scan, expected in zip(data, right, strict=True):
        np.testing.assert_array_equal(scan.points, expected.points)
        np.testing.assert_allclose(scan.ground_truth, expected.ground_truth, atol=1e-6)


def text(values: Array) -> str:
    return "".join(" ".join(f"{v:.9f}" for v in row) + "\n" for row in values)


@pytest.mark.parametrize(
    "file",
    [
        lambda t: t.encode("utf-16"),
        lambda t: ("\ufefftimestamp;x;y;z;qx;qy;qz;qw\n" + t.replace(" ", ";")).encode(),
        lambda t: t.replace("\n", "\r").encode(),
    ],
    ids=["utf-16", "semicolons, names and a mark", "old ends of lines"],
)
def test_trajectories_as_other_programs_write_them(
    right: CloudFolder, tmp_path: Path, file: Callable[[str], bytes]
) -> None:
    data = written(tmp_path, [s.points for s in right], file(text(rows(right))))
    np.testing.assert_allclose(data.ground_truth, right.ground_truth, atol=1e-6)


def inverted(poses: Array) -> Array:
    T = np.array([se3(p[1:4], Rotation.from_quat(p[4:]).as_matrix()) for p in poses])
    back = inverse(T)
    return np.column_stack(
        [poses[:, 0], back[:, :3, 3], Rotation.from_matrix(back[:, :3, :3]).as_quat()]
    )


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        (lambda p: p * [1, 1000, 1000, 1000, 1, 1, 1, 1], "poses in mm"),
        (inverted, "poses are inverse"),
        (lambda p: p[:, [0, 1, 2, 3, 7, 4, 5, 6]] + 0.0, "quaternions are qw qx qy qz"),
    ],
)
def test_poses_that_do_not_fit_the_clouds(
    right: CloudFolder, tmp_path: Path, change: Callable[[Array], Array], doubt: str
) -> None:
    poses = change(rows(right))[1:]  # the first, no turn, would give the order away
    data = written(tmp_path, [scan.points for scan in right][1:], poses)
    assert any(doubt in word for word in data.suspicions), data.suspicions


@pytest.mark.parametrize(("unit", "scale"), [("feet", 0.3048), ("dm", 0.1)])
def test_points_in_another_unit_than_the_poses(
    right: CloudFolder, tmp_path: Path, unit: str, scale: float
) -> None:
    data = written(tmp_path, [scan.points / scale for scan in right], rows(right))
    assert any(f"points in {unit} (dataset.scale={scale})" in w for w in data.suspicions)
    data = CloudFolder(data.files[0].parent.as_posix(), poses=f"{tmp_path}/poses.tum", scale=scale)
    assert data.suspicions == ()


def test_points_in_one_frame_near_the_origin(right: CloudFolder, tmp_path: Path) -> None:
    world = [transform(scan.ground_truth, scan.points) for scan in right]
    data = written(tmp_path, world, rows(right))
    assert any("dataset.frame=world" in word for word in data.suspicions)
    data = CloudFolder(f"{tmp_path}/clouds", poses=f"{tmp_path}/poses.tum", frame="world")
    assert data.suspicions == ()
    for scan, expected in zip(data, right, strict=True):
        np.testing.assert_allclose(scan.points, expected.points, atol=1e-6)


def test_single_precision_far_from_the_origin(right: CloudFolder, tmp_path: Path) -> None:
    far = np.array([512345.0, 5403205.0, 312.0])
    world = [transform(s.ground_truth, s.points) + far for s in right]
    data = written(tmp_path, [cloud.astype(np.float32) for cloud in world], rows(right))
    assert any("0.5 m apart at least" in word for word in data.suspicions)


def test_the_right_ones_are_not_doubted(right: CloudFolder, data_dir: Path) -> None:
    figure8 = data_dir / "figure8"
    data = CloudFolder(str(figure8 / "scans"), poses=str(figure8 / "trajectory.tum"))
    assert right.suspicions == () and data.suspicions == ()


# --- logs


class Base:
    """The right log in parts: readings (60, 181) m, poses (60, 3), times (60,) s."""

    def __init__(self, cases: Path) -> None:
        words = [
            line.split()
            for line in (cases / "c_base" / "log.clf").read_text().splitlines()
            if line.startswith("FLASER")
        ]
        self.ranges = np.array([w[2:183] for w in words], float)
        self.poses = np.array([w[186:189] for w in words], float)
        self.times = np.array([w[189] for w in words], float)
        self.relations = str(cases / "c_base" / "log.relations")

    def pose(self, time: float) -> list[float]:
        """Where the robot is at a time."""
        theta = np.unwrap(self.poses[:, 2])
        return [float(np.interp(time, self.times, v)) for v in (*self.poses[:, :2].T, theta)]

    def scans(self, ranges: Array | None = None, first: Array | None = None) -> list[str]:
        """FLASER lines; ``first`` (60, 3) are the first triples."""
        ranges = self.ranges if ranges is None else ranges
        first = self.poses if first is None else first
        rows = zip(first, self.times, ranges, self.poses, strict=True)
        return [flaser(laser, float(t), r, robot=robot.tolist()) for laser, t, r, robot in rows]

    def odom(self) -> list[str]:
        """ODOM lines just before the scans."""
        return [odom(self.pose(t - 0.01), float(t - 0.01)) for t in self.times]


@pytest.fixture(scope="module")
def base(cases_dir: Path) -> Base:
    return Base(cases_dir)


def opened(folder: Path, lines: list[str], relations: str | None = None) -> Carmen:
    (folder / "log.clf").write_text("\n".join(lines) + "\n")
    return Carmen(str(folder / "log.clf"), relations)


def alternating(*parts: list[str]) -> list[str]:
    return [line for lines in zip(*parts, strict=True) for line in lines]


def ahead(poses: Array, distance: float) -> Array:
    step = distance * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    return np.column_stack([poses[:, :2] + step, poses[:, 2]])


def test_a_laser_ahead_of_the_robot_in_both_triples_is_no_correction(
    base: Base, tmp_path: Path
) -> None:
    laser = ahead(base.poses, 0.2)
    rows = zip(laser, base.times, base.ranges, strict=True)
    scans = [flaser(p, float(t), r) for p, t, r in rows]
    data = opened(tmp_path, alternating(base.odom(), scans))
    assert not data.corrected and data.has_odometry and not data.has_ground_truth
    np.testing.assert_allclose(data.odometry[:, :2, 3], laser[:, :2])  # type: ignore[index]


def drifting(base: Base) -> Array:
    share = np.linspace(0, 1, len(base.poses))[:, None]
    noise = np.random.default_rng(0).normal(0, [0.004, 0.004, 0.002], base.poses.shape)
    return np.asarray(base.poses + np.cumsum(noise, axis=0) + share * [0.3, 0.2, 0.1])


def test_triples_the_other_way_round(base: Base, tmp_path: Path) -> None:
    """Odometry first and the corrected poses second."""
    truth = drifting(base)
    rows = zip(base.poses, base.times, base.ranges, truth, strict=True)
    scans = [flaser(p, float(t), r, robot=second.tolist()) for p, t, r, second in rows]
    data = opened(tmp_path, alternating(base.odom(), scans))
    assert data.corrected and data.ground_truth is not None and data.odometry is not None
    np.testing.assert_allclose(data.ground_truth[:, :2, 3], truth[:, :2])
    np.testing.assert_allclose(data.odometry[:, :2, 3], base.poses[:, :2])


def test_nothing_tells_odometry_from_a_corrected_path(base: Base, tmp_path: Path) -> None:
    data = opened(tmp_path, base.scans())
    assert any("no ODOM line tells" in word for word in data.suspicions)


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        ([1000, 1000, 1], "millimetres or centimetres"),
        ([100, 100, 1], "millimetres or centimetres"),
        ([1, 1, 180 / np.pi], "degrees, not radians"),
    ],
)
def test_poses_in_other_units(base: Base, tmp_path: Path, change: list[float], doubt: str) -> None:
    poses = base.poses * change
    rows = zip(poses, base.times, base.ranges, strict=True)
    lines = [x for p, t, r in rows for x in (odom(p, float(t) - 0.01), flaser(p, float(t), r))]
    data = opened(tmp_path, lines)
    assert any(doubt in word for word in data.suspicions)


@pytest.mark.parametrize("value", [0.0, -1.0, 0.02, 0.05, 30.0])
def test_values_that_mean_no_return(base: Base, tmp_path: Path, value: float) -> None:
    lost = np.random.default_rng(1).random(base.ranges.shape) < 0.08
    data = opened(tmp_path, base.scans(np.where(lost, value, base.ranges)))
    np.testing.assert_array_equal(np.isnan(data.ranges), lost)


def test_readings_in_a_band_far_beyond_all_others_are_doubted(base: Base, tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    lost = rng.random(base.ranges.shape) < 0.08
    noisy = np.where(lost, rng.uniform(79.7, 80, lost.shape).round(3), base.ranges)
    data = opened(tmp_path, base.scans(noisy))
    assert any("no return? dataset.max_range=78.9" in word for word in data.suspicions)


@pytest.mark.parametrize(
    ("params", "ends"),
    [
        (["laser_laser1_resolution 0.5", "laser_laser1_fov 90"], (-45, 45)),
        (["laser_front_laser_fov 1.5707963"], (-45, 45)),
        (["laser_front_laser_flipped on"], (90, -90)),
        (["laser_front_laser_flipped off"], (-90, 90)),
    ],
)
def test_params_by_other_names_and_words(
    base: Base, tmp_path: Path, params: list[str], ends: tuple[float, float]
) -> None:
    old = np.arange(-90.0, 91.0)
    new = np.linspace(*ends, 181)
    ranges = np.array([np.interp(new, old, scan) for scan in base.ranges])
    data = opened(tmp_path, [*(f"PARAM {p} host 0" for p in params), *base.scans(ranges)])
    np.testing.assert_allclose(np.rad2deg(data.angles[[0, -1]]), ends, atol=1e-4)


def test_a_message_that_contradicts_itself_is_refused(base: Base, tmp_path: Path) -> None:
    head = f"ROBOTLASER1 0 {-np.pi / 2} {np.pi} {np.pi / 360} 81.83 0.01 0 181"
    lines = [
        f"{head} {' '.join(map(str, r))} 0 {' '.join(map(str, [*p, *p]))} 0 0 0 0 0 {t} h {t}"
        for r, p, t in zip(base.ranges[:2], base.poses, base.times, strict=False)
    ]
    with pytest.raises(DataError, match=r"\[-90,0\.5\].*settings.*\[-90,1\].*field of view"):
        opened(tmp_path, lines)


@pytest.mark.parametrize(
    ("change", "doubt"),
    [
        (lambda w: [w[1], w[0], *w[2:]], "from the second time to the first"),
        (lambda w: [*w[:2], *(1000 * v for v in w[2:5]), *w[5:]], "in millimetres"),
        (lambda w: [w[0] + 5000 * (int(w[0]) % 2), *w[1:]], "only 5 of 10 relations"),
    ],
)
def test_relations_that_do_not_fit(
    base: Base, tmp_path: Path, change: Callable[[list[float]], list[float]], doubt: str
) -> None:
    given = np.loadtxt(base.relations)
    file = tmp_path / "log.relations"
    np.savetxt(file, [change(row.tolist()) for row in given], fmt="%.6f")
    data = opened(tmp_path, alternating(base.odom(), base.scans()), str(file))
    assert any(doubt in word for word in data.suspicions), data.suspicions


def test_relations_in_degrees(base: Base, tmp_path: Path) -> None:
    given = np.loadtxt(base.relations)
    given[:, 5:] = np.rad2deg(given[:, 5:])
    np.savetxt(tmp_path / "log.relations", given, fmt="%.6f")
    with pytest.raises(DataError, match="degrees found"):
        opened(tmp_path, base.scans(), str(tmp_path / "log.relations"))


def test_the_right_log_is_not_doubted(base: Base, tmp_path: Path) -> None:
    data = opened(tmp_path, alternating(base.odom(), base.scans()), base.relations)
    assert data.suspicions == ()
