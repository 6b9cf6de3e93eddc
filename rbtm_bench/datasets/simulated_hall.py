"""A spinning 3D lidar driven through a simulated hall, written as a folder of clouds with poses."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.open3d_library import open3d
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.environments import arc
from rbtm_bench.datasets.raycast import Mesh, box_mesh, make_scene, merge, pillar_mesh, scan_cloud

SENSOR_HEIGHT = 1.2
MAX_RANGE = 60.0
STEP_SECONDS = 0.1
DRIVE_RADIUS = 5.0
"""m; the robot drives in circles, so that no number of scans takes it out of the hall."""

RAYS = 16_000
RING_ELEVATIONS_DEG = {16: (-15.0, 15.0), 32: (-25.0, 15.0)}

FORMATS = ("ply", "pcd", "bin", "npy")


def hall_mesh() -> Mesh:
    """A hall of 30 m x 20 m x 6 m, floor at z = 0, with boxes and pillars off the circular way."""
    boxes = [
        ((-15.0, -10.0, 0.0), (15.0, 10.0, 6.0)),
        ((-12.5, 6.0, 0.0), (-9.0, 8.5, 2.0)),
        ((-13.5, -7.0, 0.0), (-11.5, -4.0, 3.0)),
        ((-6.0, -9.0, 0.0), (-2.5, -7.5, 1.5)),
        ((3.0, 7.0, 0.0), (6.5, 9.0, 2.5)),
        ((8.5, -3.0, 0.0), (10.0, 0.5, 1.2)),
        ((11.0, 3.5, 0.0), (13.5, 5.0, 4.0)),
        ((5.5, -8.5, 0.0), (8.0, -7.0, 0.8)),
        ((-1.5, -0.8, 0.0), (1.0, 1.2, 1.6)),
    ]
    pillars = [(-8.0, 2.0), (-8.0, -2.5), (0.0, 7.5), (7.5, 5.5), (7.0, -5.0), (1.5, -2.2)]
    return merge(
        [box_mesh(low, high) for low, high in boxes]
        + [pillar_mesh(center, 0.3, 0.0, 6.0) for center in pillars]
    )


def lidar_directions(rings: int) -> Array:
    """Unit vectors (R, 3) of one turn of a lidar with 16 or 32 rings, about 16,000 in all."""
    if rings not in RING_ELEVATIONS_DEG:
        raise ConfigError(f"rings={rings}: expected one of {list(RING_ELEVATIONS_DEG)}")
    elevation = np.deg2rad(np.linspace(*RING_ELEVATIONS_DEG[rings], rings))[:, None]
    azimuth = np.linspace(-np.pi, np.pi, RAYS // rings, endpoint=False)[None, :]
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    z = np.broadcast_to(np.sin(elevation), x.shape)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def drive(scans: int, step: float) -> Array:
    """T_world_sensor (scans, 4, 4) every ``step`` m along a circle around the hall's middle."""
    start = np.eye(4)
    start[:3, 3] = 0.0, -DRIVE_RADIUS, SENSOR_HEIGHT
    return np.stack([start @ arc(i * step, 1.0 / DRIVE_RADIUS) for i in range(scans)])


def simulate(poses: Array, rings: int, noise: float, seed: int) -> Iterator[Array]:
    """The cloud (N, 3) m in the sensor frame at each pose, gaussian ``noise`` (m) on the ranges.

    A cloud is taken at one instant: nothing moves while the lidar turns.
    """
    scene = make_scene(hall_mesh())
    directions = lidar_directions(rings)
    rng = np.random.default_rng(seed)
    for pose in poses:
        ranges = scan_cloud(scene, pose, directions, MAX_RANGE)
        ranges += noise * rng.standard_normal(len(ranges))
        hit = np.isfinite(ranges)
        yield directions[hit] * ranges[hit, None]


def write_cloud(path: Path, points: Array) -> None:
    """Write points (N, 3) m in the format of the file's suffix."""
    if path.suffix == ".npy":
        np.save(path, points)
    elif path.suffix == ".bin":
        rows = np.zeros((len(points), 4), dtype=np.float32)
        rows[:, :3] = points
        rows.tofile(path)
    else:
        o3d = open3d()

        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        if not o3d.io.write_point_cloud(path, cloud):
            raise OSError(f"{path}: Open3D could not write the cloud")


def write_poses(path: Path, poses: Array) -> None:
    """Write planar-rotation poses (N, 4, 4) as a TUM trajectory, 0.1 s apart."""
    half_yaw = 0.5 * np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    zero = np.zeros(len(poses))
    stamps = STEP_SECONDS * np.arange(len(poses))
    rows = [stamps, *poses[:, :3, 3].T, zero, zero, np.sin(half_yaw), np.cos(half_yaw)]
    np.savetxt(path, np.column_stack(rows), fmt="%.9f")


def write_hall(
    folder: Path,
    scans: int = 40,
    seed: int = 0,
    step: float = 0.15,
    noise: float = 0.01,
    suffix: str = "ply",
    rings: int = 16,
) -> list[int]:
    """Simulate a drive into a new or empty folder: clouds and ``poses.tum``.

    Returns the number of points of each cloud. Raises ``ConfigError`` if the folder holds
    anything, since clouds of two drives in one folder would be read as one.
    """
    if suffix not in FORMATS:
        raise ConfigError(f"format={suffix}: expected one of {', '.join(FORMATS)}")
    poses = drive(scans, step)
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: expected a folder, found a file")
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise ConfigError(f"{folder}: the folder is not empty")
    sizes = []
    for index, points in enumerate(simulate(poses, rings, noise, seed)):
        write_cloud(folder / f"{index:06d}.{suffix}", points)
        sizes.append(len(points))
    write_poses(folder / "poses.tum", poses)
    return sizes
