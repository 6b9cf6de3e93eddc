"""Read one cloud file (.ply, .pcd, .bin, .npy, .las, .laz, text), or say what is wrong with it.

Headers are read first and held against the file's size; the points follow from what they say.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets import las_file, pcd_file, ply_file
from rbtm_bench.datasets.binary_layouts import LAYOUTS, absurd, read_layout
from rbtm_bench.datasets.files import file_size, reader
from rbtm_bench.datasets.text_cloud import read_text

SUFFIXES = (".ply", ".pcd", ".bin", ".npy", ".xyz", ".las", ".laz")
TEXT = (".xyz", ".csv", ".txt")
"""Of these .csv and .txt may be trajectories as well: they are clouds where a pattern says so."""

MOST_ABSURD = 0.01
"""A cloud is refused if a larger share of its points lies nowhere."""
SHORT_SIDE = 8
"""An array of 3 or 4 rows and more columns than this has its points in columns."""


@reader
def check_file(path: Path, layout: str = "kitti") -> None:
    """Raise ``DataError`` for what can be seen without reading the points; ``layout`` is that of
    .bin files."""
    size = file_size(path)
    suffix = path.suffix.lower()
    if suffix == ".bin" and size % LAYOUTS[layout].record:
        read_layout(path, layout)
    if suffix == ".npy":
        _open_npy(path)


@reader
def read_points(
    path: Path, layout: str = "kitti", columns: tuple[int, int, int] | None = None
) -> Array:
    """All points (N, 3) of the file in its own unit and frame, non-finite ones included.

    ``layout`` is that of .bin files, ``columns`` are those of x, y, z in an array (.npy) or text.
    Raises ``DataError``.
    """
    suffix = path.suffix.lower()
    if suffix == ".bin":
        return read_layout(path, layout)
    if suffix == ".npy":
        return _npy_points(path, columns)
    if suffix in TEXT:
        return _text_points(path, columns)
    if suffix in las_file.SUFFIXES:
        return las_file.read_las(path)
    return ply_file.read_ply(path) if suffix == ".ply" else pcd_file.read_pcd(path)


def _npy_points(path: Path, columns: tuple[int, int, int] | None) -> Array:
    array = _open_npy(path)
    if _lies_on_its_side(array):
        array = array.T
    if columns is None:
        columns = (0, 1, 2)
        if array.shape[1] > 3 and len(array) >= SHORT_SIDE:
            _refuse_counters(path, array)
    if max(columns) >= array.shape[1]:
        raise DataError(f"{path}: {array.shape[1]} columns, but columns={list(columns)}")
    return np.array(array[:, columns], dtype=np.float64)


def _text_points(path: Path, columns: tuple[int, int, int] | None) -> Array:
    table, known = read_text(path, columns)
    if not known and table.shape[1] > 3 and len(table) >= SHORT_SIDE:
        _refuse_counters(path, table)
    return table[:, :3]


def _refuse_counters(path: Path, array: NDArray[np.generic]) -> None:
    """Among the first columns of a wider array may be times or numbers: they only grow."""
    for column in range(3):
        step = np.diff(array[:, column].astype(np.float64))
        if np.all(step >= 0) and np.any(step > 0):
            raise DataError(
                f"{path}: column {column} only grows: a time or number and not a coordinate? "
                f"dataset.columns=[0,1,2] says that it is one, others where x, y, z are"
            )


def _lies_on_its_side(array: NDArray[np.generic]) -> bool:
    return array.shape[0] in (3, 4) and array.shape[1] > SHORT_SIDE


def _open_npy(path: Path) -> NDArray[np.generic]:
    """The array of a .npy file, mapped and not read."""
    size = file_size(path)
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except Exception as error:  # numpy evaluates the header, which may be anything
        text = " ".join(str(error).split())
        raise DataError(f"{path}: not a readable .npy array ({text})") from None
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] < 3:
        shape = getattr(array, "shape", "no array")
        raise DataError(f"{path}: expected an array (N, 3) or wider, found {shape}")
    if array.dtype.kind not in "fiu":
        raise DataError(f"{path}: expected real numbers, found {array.dtype}")
    assert isinstance(array, np.memmap)
    extra = size - array.offset - array.nbytes
    if extra:
        raise DataError(f"{path}: {extra} bytes more than the array {array.shape} announced")
    return array


def usable(
    path: Path, points: Array, min_range: float = 0.0, max_range: float = np.inf
) -> tuple[Array, dict[str, int]]:
    """The points (N, 3) m that are returns within range, and how many others there are by cause."""
    mask, causes = returns(path, points, min_range, max_range)
    return points[mask], causes


def returns(
    path: Path, points: Array, min_range: float, max_range: float
) -> tuple[NDArray[np.bool_], dict[str, int]]:
    """Which (N,) of the points (N, 3) m are returns within range; how many are not, by cause.

    A point in the sensor itself is how organised clouds write "no return". Raises ``DataError``
    if none is left, or so many are implausible that the file must be something else.
    """
    finite = np.isfinite(points).all(axis=1)
    bad = absurd(points).any(axis=1) & finite
    with np.errstate(over="ignore", invalid="ignore"):
        distance = np.linalg.norm(points, axis=1)
    good = finite & ~bad
    near, far = good & (distance <= min_range), good & (distance >= max_range)
    if np.count_nonzero(bad) > MOST_ABSURD * len(points):
        raise DataError(
            f"{path}: {np.count_nonzero(bad)} of {len(points)} points are beyond 10 km or next to "
            "nothing: another layout, byte order or unit (dataset.layout=, dataset.scale=)?"
        )
    kept = good & ~near & ~far
    if not kept.any():
        raise DataError(f"{path}: no point within range ({len(points)} points in the file)")
    causes = {"not_finite": ~finite, "implausible": bad, "too_near": near, "too_far": far}
    return kept, {cause: int(np.count_nonzero(mask)) for cause, mask in causes.items()}
