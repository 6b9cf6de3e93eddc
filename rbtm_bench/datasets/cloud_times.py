"""The files of a folder in order, their times, and the poses that belong to them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.association import nearest, span, time_suspicions
from rbtm_bench.datasets.base import Reading
from rbtm_bench.datasets.poses_file import read_poses_file

UNITS = {10: 1.0, 13: 1e-3, 16: 1e-6, 19: 1e-9}
"""s in a unit of times since 1970, by their number of digits."""
CAMERA = 0.9
"""Share of a path along z from which on it looks like a camera's."""
ENOUGH = 0.9
"""Share of clouds that must find a pose if their times are only assumed."""


def list_files(path: str, pattern: str, suffixes: Sequence[str]) -> list[Path]:
    """The files of one format in the folder that match, in order; names with a dot in front are no
    data. Raises ``DataError``, ``ConfigError`` for a pattern that is none."""
    folder = Path(path)
    if not folder.is_dir():
        what = "expected a folder, found a file" if folder.exists() else "no such folder"
        raise DataError(f"{path}: {what}")
    try:
        matches = [file for file in folder.glob(pattern) if not _hidden(file, folder)]
    except (ValueError, NotImplementedError) as error:
        raise ConfigError(f"pattern={pattern!r}: {error}") from None
    files = [file for file in matches if file.suffix.lower() in suffixes and file.is_file()]
    if not files:
        raise DataError(f"{path}: no {', '.join(suffixes)} file matches pattern {pattern!r}")
    found = sorted({file.suffix.lower() for file in files})
    if len(found) > 1:
        raise DataError(
            f"{path}: {' and '.join(found)} files: dataset.pattern='*{found[0]}' says which"
        )
    names = [file.relative_to(folder).as_posix() for file in files]
    numbers = [decimal(name) for name in names]
    keys = [number[:2] for number in numbers if number is not None]
    if len(set(keys)) == len(files) and any(number and number[2] for number in numbers):
        return [file for _, file in sorted(zip(keys, files, strict=True))]
    return [file for _, file in sorted(zip(map(natural_key, names), files, strict=True))]


def _hidden(file: Path, folder: Path) -> bool:
    return any(part.startswith(".") for part in file.relative_to(folder).parts)


def decimal(name: str) -> tuple[str, Decimal, bool] | None:
    """What stands before the one number of a name, the number (1.4 after 1.35, -1 before 0), and
    whether it has a point; None for names with another number or none. A dash is a sign where
    nothing stands before it."""
    match = re.fullmatch(r"(-|\D*)(\d+)(?:\.(\d+))?(?:\.[a-zA-Z]+)+", name)
    if match is None:
        return None
    before, whole, fraction = match.groups()
    sign, before = ("-", "") if before == "-" else ("", before)
    return before, Decimal(f"{sign}{whole}.{fraction or 0}"), fraction is not None


def natural_key(name: str) -> tuple[list[str | int], str]:
    """Sorts names as people do: digits as numbers, so 2 comes before 10."""
    parts = re.split(r"([0-9]+)", name)
    return [int(part) if i % 2 else part for i, part in enumerate(parts)], name


def times_of(files: Sequence[Path]) -> Array | None:
    """Times (N,) s that the names are: decimal numbers, as many digits as times since 1970 have,
    or seconds_nanoseconds."""
    split = [re.fullmatch(r"\D*(\d{10})_(\d{9})(?:\.[a-zA-Z]+)+", file.name) for file in files]
    pairs = [(int(match[1]), int(match[2])) for match in split if match]
    if len(pairs) == len(files):
        return np.array([seconds + 1e-9 * nano for seconds, nano in pairs])
    numbers = [number[1:] for file in files if (number := decimal(file.name)) is not None]
    if len(numbers) < len(files):
        return None
    if any(has_point for _, has_point in numbers):
        return np.array([float(number) for number, _ in numbers])
    units = [UNITS.get(len(str(int(number)))) for number, _ in numbers]
    if None in units or min(number for number, _ in numbers) < 0:
        return None
    return np.array([float(n) * (u or 1.0) for (n, _), u in zip(numbers, units, strict=True)])


@dataclass(frozen=True, eq=False)
class Matched:
    """Poses T_world_sensor (N, 4, 4) of the clouds, NaN where there is none, the stamps (N,) s of
    a trajectory that gives the clouds theirs, and what was decided."""

    poses: Array
    stamps: Array | None
    reading: Reading
    suspicions: tuple[str, ...] = ()


def match_poses(
    path: str, role: str, clouds: int, times: Array | None, rate_hz: float, tolerance_s: float
) -> Matched:
    """The pose of every cloud out of a trajectory file.

    By time, nearest within ``tolerance_s`` (s), where the clouds have ``times`` (N,); in order
    where they have none and there is one pose a cloud (a TUM file's poses are sorted by time); by
    time with clouds 1 / ``rate_hz`` s apart otherwise. Raises ``DataError`` with the counts if
    none or too few match.
    """
    file = read_poses_file(path)
    stamps, poses = file.stamps, file.poses
    suspicions = _of_a_camera(path, poses)
    if stamps is not None:
        suspicions += [f"{path}: {text}" for text in time_suspicions(stamps, "poses")]
        order = np.argsort(stamps, kind="stable")
        stamps, poses = stamps[order], poses[order]
    disjoint = (
        stamps is None
        or times is None
        or bool(times.max() < stamps.min() or times.min() > stamps.max())
    )
    why = f"{path}; {file.note}" if file.note else path
    if len(poses) == clouds and disjoint:
        own = "in order, one a cloud"
        if stamps is not None and times is not None:
            suspicions.append(
                f"the names' times ({span(times)}) are not the poses' ({span(stamps)})"
            )
        reading = Reading(role, own, why, role_setting(role))
        return Matched(poses, None if times is not None else stamps, reading, tuple(suspicions))
    if stamps is None or (times is not None and disjoint):
        asked = f"{len(poses)} poses for {clouds} clouds"
        if stamps is not None and times is not None:
            asked += f": the clouds are from {span(times)}, the poses from {span(stamps)}"
        raise DataError(f"{path}: {asked}")
    assumed = times is None
    if times is None:
        times = np.arange(clouds) / rate_hz
    found = nearest(stamps, times, tolerance_s)
    count = int(np.count_nonzero(found >= 0))
    if count == 0 or (assumed and count < ENOUGH * clouds):
        at = f"at {rate_hz:g} Hz from 0 s" if assumed else f"from {span(times)}"
        raise DataError(
            f"{path}: {len(poses)} poses for {clouds} clouds, {count} of them within "
            f"{tolerance_s:g} s of one (clouds {at}, poses from {span(stamps)})"
        )
    T = np.full((clouds, 4, 4), np.nan)
    T[found >= 0] = poses[found[found >= 0]]
    at = f", clouds at {rate_hz:g} Hz" if assumed else ""
    taken = f"{count} of {clouds} clouds by time, within {tolerance_s:g} s{at}"
    return Matched(T, None, Reading(role, taken, why, role_setting(role)), tuple(suspicions))


def _of_a_camera(path: str, poses: Array) -> list[str]:
    """A word on poses that move along their z axis, as a camera's do and a laser's do not."""
    if len(poses) < 2:
        return []
    steps = (inverse(poses[:-1]) @ poses[1:])[:, :3, 3]
    lengths = np.linalg.norm(steps, axis=1)
    if lengths.sum() > 0 and np.abs(steps[:, 2]).sum() > CAMERA * lengths.sum():
        return [f"{path}: the poses move along their z axis: a camera's, and not the laser's?"]
    return []


def role_setting(role: str) -> str:
    """The setting that names the file of a role."""
    return "poses" if role == "truth" else role
