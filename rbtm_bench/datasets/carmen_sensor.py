"""What the readings of a CARMEN log are: their unit, which are no returns, and their angles."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from rbtm_bench.core.errors import DataError
from rbtm_bench.core.types import Array
from rbtm_bench.datasets.base import Reading
from rbtm_bench.datasets.carmen_log import SENSOR_MAX_PARAM, CarmenLog
from rbtm_bench.datasets.planar import between

BEAMS_DEG: dict[int, tuple[float, float, str]] = {
    180: (-90.0, 1.0, "SICK"),
    181: (-90.0, 1.0, "SICK"),
    360: (-90.0, 0.5, "SICK"),
    361: (-90.0, 0.5, "SICK"),
    401: (-50.0, 0.25, "SICK"),
    541: (-135.0, 0.5, "SICK or Hokuyo of 270 deg"),
    681: (-120.0, 360 / 1020, "Hokuyo of 240 deg"),
    682: (-120.0, 240 / 681, "Hokuyo of 240 deg"),
    683: (-120.0, 240 / 682, "Hokuyo of 240 deg"),
    1080: (-135.0, 0.25, "Hokuyo of 270 deg"),
    1081: (-135.0, 0.25, "Hokuyo of 270 deg"),
}
"""First angle and spacing (deg) of the lasers known by their number of readings."""

NO_RETURN_BAND = 0.1
NO_RETURN_SHARE, NO_RETURN_READINGS = 0.001, 10
ALONE_SHARE = 0.5
"""A value means no return if it outweighs all that is up to a tenth shorter (ACES: 0.10)."""
RARE_BESIDE, MOST_OTHERS = 3, 0.05
"""It has at least three times as many as all others that are longer, and these are few."""
FARTHEST_READING = 1e4
"""m; no laser reads farther."""
FARTHEST_MEDIAN = 100.0
"""m; a planar laser on a robot has half of its readings within this."""

NEAR_M, NEAR_SHARE = 0.1, 0.01
"""m and share of the readings: a value that means no return at the near end."""
UNLIKE = 0.1
"""Share that the spacing and the field of view of a message may contradict each other by."""
SETTINGS = ("start", "fov", "resolution")
TURN_DEG = (3.0, 20.0)
STEP_SHARE = 0.05
TURNS = 40
BETTER = 0.7
"""Of two readings of the angles one is told by turns if it leaves at most this share of the
difference that the other leaves between scans."""


@dataclass(frozen=True, eq=False)
class Beams:
    """``angles`` (B,) rad of the beams and how they were found."""

    angles: Array
    reading: Reading
    suspicions: tuple[str, ...] = ()


def find_scale(path: str, sample: Array, scale: Literal["auto"] | float) -> float:
    """Metres in a unit of the readings; ``sample`` (K, B). Raises ``DataError`` if unsure."""
    if scale != "auto":
        return scale
    finite = sample[np.isfinite(sample) & (sample > 0)]
    middle = float(np.median(finite)) if len(finite) else 0.0
    if middle <= FARTHEST_MEDIAN:
        return 1.0
    raise DataError(
        f"{path}: half of the readings are longer than {middle:.4g}: centimetres "
        f"(dataset.scale=0.01: {0.01 * middle:.3g} m), millimetres (dataset.scale=0.001: "
        f"{0.001 * middle:.3g} m) or metres (dataset.scale=1)?"
    )


def no_return_limit(log: CarmenLog, sample: Array, scale: float = 1.0) -> tuple[float, str]:
    """The range in m from which on a reading means "no return" (infinity if none does), and why.

    The log's own maximum counts, and so does the longest value that many readings have in common,
    however rare and long those beyond it are.
    """
    limit, reasons = np.inf, []
    for own, name in (
        (log.param(SENSOR_MAX_PARAM), SENSOR_MAX_PARAM),
        (log.laser_param("maxrange", log.message == "RLASER"), "laser_front_laser_maxrange"),
    ):
        if own is not None and 0 < own < limit:
            limit, reasons = own, [f"PARAM {name}"]
    if log.laser is not None and 0 < log.laser.max_range < limit:
        limit, reasons = log.laser.max_range, [f"{log.message}'s maximum range"]
    spike, count = lone_value(scale * sample)
    if spike is not None and spike - NO_RETURN_BAND < limit:
        limit, reasons = spike - NO_RETURN_BAND, [f"{count} readings are {spike:g} m, all alone"]
    return float(limit), "; ".join(reasons) or "no value near the longest is frequent"


def lone_value(readings: Array) -> tuple[float | None, int]:
    """The shortest of the values at the far end that so many readings have in common."""
    finite = readings[np.isfinite(readings) & (readings < FARTHEST_READING)]
    values, counts = np.unique(finite, return_counts=True)
    enough = max(NO_RETURN_READINGS, NO_RETURN_SHARE * len(finite))
    found, total, others = None, 0, 0
    for index in range(len(values) - 1, -1, -1):
        value, count = float(values[index]), int(counts[index])
        if found is not None and value >= found - NO_RETURN_BAND:
            continue  # goes with it
        if count < max(enough, RARE_BESIDE * others):
            others += count
            if others > MOST_OTHERS * len(finite):
                break
            continue
        low = np.searchsorted(values, 0.9 * value)
        high = np.searchsorted(values, value - NO_RETURN_BAND, side="right")
        if counts[low:high].sum() > ALONE_SHARE * count:
            others += count
            continue
        found, total = value, total + count
    return found, total


def near_limit(readings: Array) -> tuple[float, int]:
    """The shortest reading (m), if it means "no return" (many share it and hardly any is up to
    three times as long), and how many there are; else 0, 0."""
    hits = readings[np.isfinite(readings) & (readings > 0)]
    if len(hits) == 0:
        return 0.0, 0
    low = float(hits.min())
    count = int(np.count_nonzero(hits == low))
    beside = int(np.count_nonzero((hits > low) & (hits < 3 * low)))
    enough = count > max(NO_RETURN_READINGS, NEAR_SHARE * len(hits))
    return (low, count) if low < NEAR_M and enough and beside < 0.1 * count else (0.0, 0)


def far_doubt(readings: Array, limit: float) -> tuple[str, ...]:
    """A word on readings that are far beyond all others and near each other."""
    hits = np.sort(readings[np.isfinite(readings) & (readings > 0) & (readings < limit)])
    if len(hits) < NO_RETURN_READINGS:
        return ()
    share = max(1, int(NEAR_SHARE * len(hits)))
    at = int(np.argmax(hits[1:] / hits[:-1]))
    beyond = len(hits) - 1 - at
    if hits[at + 1] < 2 * hits[at] or not share <= beyond < len(hits) // 2:
        return ()
    if hits[-1] > 1.05 * hits[at + 1]:
        return ()
    return (
        f"{beyond} readings are {hits[at + 1]:.4g} to {hits[-1]:.4g} m, and none from "
        f"{hits[at]:.4g} m on: no return? dataset.max_range={0.99 * hits[at + 1]:.3g} leaves "
        "them out",
    )


def find_angles(
    path: str, log: CarmenLog, sample: Array, angles: tuple[float, float] | None
) -> Beams:
    """The beams' angles: as asked for (first and spacing, deg), as the message or PARAM lines say,
    or as the number of readings is known for. Where two of them differ, turns between scans
    decide. Raises ``DataError`` with the readings that there are if nothing does."""
    beams = log.ranges.beams
    if angles is not None:
        return _beams(beams, angles[0], angles[1], "as asked for")
    claims = _claims(log, beams)
    if not claims:
        raise DataError(
            f"{path}: the angles of {beams} readings are not known: expected "
            f"{', '.join(map(str, BEAMS_DEG))} readings, a ROBOTLASER1 message or PARAM lines "
            "(dataset.angles=[FIRST,SPACING] in deg says them)"
        )
    costs = turn_costs(log, sample, [claim[:2] for claim in claims])
    best = _told(claims, costs)
    if best is None:
        words = " or ".join(f"[{c[0]:g},{c[1]:g}] ({c[2]})" for c in claims)
        raise DataError(f"{path}: angles of {beams} beams: {words}? dataset.angles= says which")
    return _with_doubts(log, sample, best, costs is not None and len(claims) > 1)


def _with_doubts(log: CarmenLog, sample: Array, claim: tuple[float, float, str], told: bool) -> Any:
    """The beams of a claim; a mirrored or otherwise scaled scan that fits turns better is said."""
    beams = log.ranges.beams
    first, spacing, why = claim
    last = first + spacing * (beams - 1)
    doubts = []
    others = [(last, -spacing), (first / 2, spacing / 2), (2 * first, 2 * spacing)]
    costs = turn_costs(log, sample, [(first, spacing), *others])
    if costs is not None and min(costs[1:]) < 0.5 * BETTER * costs[0]:
        at = others[int(np.argmin(costs[1:]))]
        doubts.append(
            f"turns of the robot fit angles [{at[0]:g},{at[1]:g}] better than "
            f"[{first:g},{spacing:g}] (deg; dataset.angles= says others)"
        )
    return _beams(beams, first, spacing, why + (", told by turns" if told else ""), tuple(doubts))


def _told(
    claims: list[tuple[float, float, str]], costs: list[float] | None
) -> tuple[float, float, str] | None:
    if len(claims) == 1:
        return claims[0]
    if costs is None:
        return None
    order = np.argsort(costs)
    return claims[order[0]] if costs[order[0]] < BETTER * costs[order[1]] else None


def _claims(log: CarmenLog, beams: int) -> list[tuple[float, float, str]]:
    """Different angles (first and spacing, deg) that something in the log stands for."""
    if log.laser is not None:
        start, fov, spacing = np.degrees([getattr(log.laser, k) for k in SETTINGS])
        for gaps in (beams - 1, beams):  # the field of view has more digits
            if gaps and abs(fov - spacing * gaps) < 0.5 * abs(spacing):
                spacing = fov / gaps
                break
        if abs(spacing) * (beams - 1) <= 361 and spacing != 0:
            claims = [(float(start), float(spacing), f"{log.message}'s settings")]
            by_fov = float(fov) / max(beams - 1, 1)
            if 0 < by_fov * (beams - 1) <= 361 and abs(by_fov / abs(spacing) - 1) > UNLIKE:
                claims.append((float(start), by_fov, f"{log.message}'s field of view"))
            return claims
    claims = []
    rear = log.message == "RLASER"
    resolution = log.laser_param("resolution", rear)
    fov = log.laser_param("fov", rear)
    if fov is not None and fov <= 2 * np.pi + 1e-3:
        fov = float(np.degrees(fov))
    if resolution is None and fov is not None and beams > 1:
        resolution = fov / (beams - 1)
    if resolution and resolution * (beams - 1) <= 361:
        first = -resolution * (beams // 2)
        claims.append((first, resolution, "PARAM laser_front_laser_resolution"))
        if fov is not None and abs(fov - resolution * (beams - 1)) <= 1.5 * resolution:
            claims[0] = (first, resolution, "PARAM laser_front_laser_resolution and fov")
            return _flipped(log, claims, beams)
    if beams in BEAMS_DEG:
        first, spacing, name = BEAMS_DEG[beams]
        known = (first, spacing, f"{beams} readings: {name}")
        if claims and abs(claims[0][1] - spacing) < 1e-3:
            claims = []
        claims.append(known)
    return _flipped(log, claims, beams)


def _flipped(
    log: CarmenLog, claims: list[tuple[float, float, str]], beams: int
) -> list[tuple[float, float, str]]:
    """With PARAM flipped: CARMEN turns the readings of a laser upside down before it logs them,
    other programs do not, so both are possible, the mirrored one first."""
    if not log.laser_param("flipped", log.message == "RLASER"):
        return claims
    mirrored = [
        (first + spacing * (beams - 1), -spacing, f"{why}, PARAM flipped")
        for first, spacing, why in claims
    ]
    return [*mirrored, *claims]


def _beams(
    beams: int, first: float, spacing: float, why: str, suspicions: tuple[str, ...] = ()
) -> Beams:
    angles: Array = np.asarray(np.deg2rad(first + spacing * np.arange(beams)), np.float64)
    last = first + spacing * (beams - 1)
    taken = f"{beams} beams, {first:g} to {last:g} deg by {spacing:.4g}"
    return Beams(angles, Reading("angles", taken, why, "angles"), suspicions)


def turn_costs(
    log: CarmenLog, sample: Array, claims: list[tuple[float, float]]
) -> list[float] | None:
    """How far (m, median) the readings of turning scans are apart under each reading of the
    angles; None if the log has no turns to tell by."""
    poses = log.robot_poses
    if poses is None or len(sample) != len(poses):
        return None
    found: list[list[float]] = []
    for i, j in _turns(poses, float(np.nanmedian(sample))):
        turn = float(between(poses[i], poses[j])[2])
        costs = [_shift_cost(sample[i], sample[j], turn / np.deg2rad(s)) for _, s in claims]
        if np.isfinite(costs).all():
            found.append(costs)
    if len(found) < 5:
        return None
    return [float(cost) for cost in np.median(found, axis=0)]


def _turns(poses: Array, size: float) -> list[tuple[int, int]]:
    """Pairs of near scans between which the robot turned, and hardly moved."""
    least, most = np.deg2rad(TURN_DEG)
    pairs = []
    for i in range(0, len(poses) - 1, max(1, len(poses) // (5 * TURNS))):
        step = between(poses[i], poses[i + 1 : i + 30])
        good = (np.abs(step[:, 2]) > least) & (np.abs(step[:, 2]) < most)
        good &= np.hypot(step[:, 0], step[:, 1]) < STEP_SHARE * size
        if good.any():
            pairs.append((i, i + 1 + int(np.argmax(good))))
    return pairs[:: max(1, len(pairs) // TURNS)]


def _shift_cost(first: Array, second: Array, beams: float) -> float:
    """Median difference (m) of readings that are ``beams`` beams apart in two scans."""
    at = np.arange(len(second)) + beams
    inside = (at >= 0) & (at <= len(first) - 1)
    if np.count_nonzero(inside) < 20:
        return np.inf
    expected = np.interp(at[inside], np.arange(len(first)), first)
    return float(np.nanmedian(np.abs(expected - second[inside])))
