"""Which data set a path is, and the settings that go with it: from its content and its name."""

from __future__ import annotations

import hashlib
import itertools
from pathlib import Path

from rbtm_bench.core.errors import DataError
from rbtm_bench.datasets.bag_file import MAGIC, METADATA, magic_suffix, topics
from rbtm_bench.datasets.bag_scans import CLOUD, LASER
from rbtm_bench.datasets.carmen_messages import LASERS
from rbtm_bench.datasets.files import unpacked_lines

CLOUDS = (".ply", ".pcd", ".bin", ".npy", ".xyz", ".las", ".laz")
LOG_SUFFIXES = (".clf", ".log")
TRUTH = ("*.tum", "poses.txt", "groundtruth.txt", "ground_truth.txt")
KNOWN = (
    "a CARMEN log, a folder of clouds (.ply, .pcd, .bin, .npy, .xyz, .las), KITTI's layout "
    "(sequences/00/velodyne) or another of KISS-ICP's, or a bag (.bag, .db3, .mcap)"
)
MARKS = {
    "apollo": ("pcds/", "poses/gt_poses.txt"),
    "boreas": ("lidar/", "applanix/lidar_poses.csv"),
    "helipr": ("LiDAR/", "LiDAR_GT/"),
    "kitti_raw": ("[0-9]*_[0-9]*_[0-9]*/*_drive_*_sync/velodyne_points/data/",),
    "mulran": ("Ouster/", "global_pose.csv"),
    "ncd": ("raw_format/ouster_scan/", "ground_truth/"),
    "nclt": ("velodyne_sync/",),
    "tum": ("depth.txt", "depth/", "groundtruth.txt"),
}
"""Of the formats of KISS-ICP's loaders: what stands in a folder of theirs and of no other."""
LINES = 2000
"""Lines at the start of a file, in which a log has a scan."""
_KEYWORDS = {name.encode() for name in (*LASERS, "ODOM")}


def recognise(path: str, given: tuple[str, ...] = ()) -> dict[str, str]:
    """Settings that read the data at ``path``: "dataset", "dataset.path" and others by key.

    ``given`` are the keys that are set anyway. Raises ``DataError`` for a path that is no data
    that we read, or that could be several.
    """
    place = Path(path).expanduser()
    if not place.exists():
        raise DataError(f"{path}: no such file or folder")
    if place.is_file():
        return _file(place)
    if not place.is_dir():
        raise DataError(f"{path}: expected a file or folder, found a pipe or device")
    if (place / METADATA).is_file():
        return _bag(place)
    known = _kitti(place, given) or _kiss(place, given) or _clouds(place, given)
    return known or _folder_of_log(place)


def _file(path: Path) -> dict[str, str]:
    if path.suffix.lower() in CLOUDS:
        raise DataError(f"{path}: a single cloud; a data set is the folder that it is in")
    if magic_suffix(path) is not None:
        return _bag(path)
    if not is_log(path):
        raise DataError(f"{path}: not recognised: expected {KNOWN}")
    found = {"dataset": "carmen", "dataset.path": str(path)}
    stem = path.name
    for suffix in (".gz", ".bz2", *LOG_SUFFIXES):
        stem = stem.removesuffix(suffix)
    relations = path.with_name(f"{stem}.relations")
    if relations.is_file():
        found["dataset.relations"] = str(relations)
    return found


def _bag(path: Path) -> dict[str, str]:
    """A bag; one that has clouds and no planar laser comes with the settings for clouds."""
    types = {topic.type for topic in topics(str(path))}
    name = "bag_clouds" if CLOUD in types and LASER not in types else "bag"
    return {"dataset": name, "dataset.path": str(path)}


def is_log(path: Path) -> bool:
    """Whether the file starts like a CARMEN log."""
    lines = itertools.islice(unpacked_lines(path, hashlib.sha256()), LINES)
    return any(line.split(None, 1)[:1] and line.split(None, 1)[0] in _KEYWORDS for line in lines)


def _kitti(path: Path, given: tuple[str, ...]) -> dict[str, str] | None:
    if (path / "velodyne").is_dir() and path.parent.name == "sequences" and path.name.isdecimal():
        root, sequences = path.parent.parent, [path.name]
    elif (path / "sequences").is_dir():
        root = path
        places = [p for p in (path / "sequences").iterdir() if (p / "velodyne").is_dir()]
        sequences = sorted(p.name for p in places if p.name.isdecimal())
    else:
        return None
    found = {"dataset": "kitti", "dataset.path": str(root)}
    if "dataset.sequence" in given:
        return found
    if len(sequences) != 1:
        which = ", ".join(sequences) or "none"
        raise DataError(f"{path}: sequences {which}: dataset.sequence= says which")
    return {**found, "dataset.sequence": str(int(sequences[0]))}


def _kiss(path: Path, given: tuple[str, ...]) -> dict[str, str] | None:
    """A folder of one of KISS-ICP's formats, where all that marks it is there."""
    names = [name for name, marks in MARKS.items() if all(any(path.glob(m)) for m in marks)]
    if len(names) != 1:
        return None
    found = {"dataset": names[0], "dataset.path": str(path)}
    if names == ["helipr"] and "dataset.sequence" not in given:
        sequences = sorted(p.name for p in (path / "LiDAR").iterdir() if p.is_dir())
        if len(sequences) != 1:
            which = ", ".join(sequences) or "none"
            raise DataError(f"{path}: sequences {which}: dataset.sequence= says which")
        found["dataset.sequence"] = sequences[0]
    return found


def _clouds(path: Path, given: tuple[str, ...]) -> dict[str, str] | None:
    """A folder with clouds, or with one folder that has; a trajectory beside them is the truth."""
    folders = [path] if _has_clouds(path) else []
    if not folders:
        folders = [p for p in sorted(path.iterdir()) if p.is_dir() and _has_clouds(p)]
    if not folders:
        return None
    if len(folders) > 1:
        names = ", ".join(folder.name for folder in folders)
        raise DataError(f"{path}: clouds in {names}: expected the path of one of these folders")
    found = {"dataset": "cloud_folder", "dataset.path": str(folders[0])}
    if "dataset.poses" in given:
        return found
    places = dict.fromkeys((path, *([path.parent] if folders[0] == path else [])))
    for place in places:
        files = sorted({file for name in TRUTH for file in place.glob(name) if _shown(file)})
        if len(files) > 1:
            names = ", ".join(file.name for file in files)
            raise DataError(f"{place}: {names}: dataset.poses= says which is the truth, or null")
        if files:
            return {**found, "dataset.poses": str(files[0])}
    return found


def _has_clouds(path: Path) -> bool:
    return any(f.suffix.lower() in CLOUDS and _shown(f) and f.is_file() for f in path.iterdir())


def _shown(path: Path) -> bool:
    return not path.name.startswith(".")


def _folder_of_log(path: Path) -> dict[str, str]:
    names = [f"*{suffix}{packed}" for suffix in LOG_SUFFIXES for packed in ("", ".gz", ".bz2")]
    names += [f"*{suffix}" for suffix in MAGIC.values()]
    logs = sorted(file for name in names for file in path.glob(name) if _shown(file))
    if len(logs) > 1:
        shown = ", ".join(file.name for file in logs[:4])
        raise DataError(f"{path}: several logs or bags ({shown}): expected the path of one")
    if not logs:
        raise DataError(f"{path}: not recognised: expected {KNOWN}")
    return _file(logs[0])
