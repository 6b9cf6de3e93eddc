"""A drive through the simulated hall, as scans and as a folder of clouds with poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from rbtm_bench.core.trajectory import Trajectory
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.simulated import SimulatedPlace

FORMATS = ("ply", "pcd", "bin", "npy")


def hall(scans: int = 40, step: float = 0.15, noise: float = 0.01) -> SimulatedPlace:
    """Sixteen rings of 1000 points in a closed room; nothing but noise is against it."""
    return SimulatedPlace(
        place="hall", scans=scans, step=step, range_noise=noise, beams=16, azimuths=1000,
        dropout=0.0, sway_deg=0.0,
    )  # fmt: skip


def write_cloud(path: Path, points: Array) -> None:
    """Write points (N, 3) m in the format of the file's suffix."""
    if path.suffix == ".npy":
        np.save(path, points)
    elif path.suffix == ".bin":
        rows = np.zeros((len(points), 4), dtype=np.float32)
        rows[:, :3] = points
        rows.tofile(path)
    else:
        import open3d as o3d

        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        assert o3d.io.write_point_cloud(path, cloud)


def write_hall(
    folder: Path, scans: int = 40, step: float = 0.15, noise: float = 0.01, suffix: str = "ply"
) -> None:
    """Clouds and ``poses.tum`` in a new folder."""
    drive = hall(max(scans, 2), step, noise)
    folder.mkdir(parents=True)
    for index in range(scans):
        write_cloud(folder / f"{index:06d}.{suffix}", drive[index].points)
    stamps = np.array([0.1 * index for index in range(scans)])
    Trajectory(stamps=stamps, T_world_scan=drive.ground_truth[:scans]).write_tum(
        folder / "poses.tum"
    )
