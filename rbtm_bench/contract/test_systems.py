"""Every system follows known motions in the plane and in space, anew in every run, and says so
where it cannot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from rbtm_bench.backends.system import System, Tracker
from rbtm_bench.contract.members import Catalogue, Member
from rbtm_bench.contract.scene import rotation
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, is_rigid, rotation_angle, se3, translation_norm
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.datasets.corridor import Corridor
from rbtm_bench.datasets.simulated import SimulatedPlace

GROUP = "backend"
SYSTEMS = True
AXIS = [0.0, 0.0, 1.0, 0.0]


@dataclass(frozen=True, repr=False)
class Course:
    """A simulated drive with its true poses (S, 4, 4), and the words that choose such data, so
    that a system takes from them what it takes in a run."""

    name: str
    words: tuple[str, ...]
    poses: Array
    scans: tuple[Scan, ...]

    def __repr__(self) -> str:
        return f"Course({self.name})"


@cache
def plane() -> Course:
    """4 m past boxes in a corridor, 0.1 m a scan (1 m/s at 10 Hz), from the first scan on."""
    data = Corridor(environment="cluttered", scans=41, path_length=4.0)
    words = ("dataset=corridor", "dataset.environment=cluttered")
    return Course("2d", words, data.ground_truth, tuple(data))


@cache
def space() -> Course:
    """3 m through a hall in a slight curve, 0.1 m a scan."""
    data = SimulatedPlace(
        place="hall", scans=31, step=0.1, beams=16, azimuths=1000, range_noise=0.01
    )
    scans = tuple(Scan(scan.index, scan.stamp, scan.points) for scan in data)
    return Course("3d", ("dataset=simulated", "dataset.place=hall"), data.ground_truth, scans)


@pytest.fixture(scope="module", params=[plane, space], ids=["2d", "3d"])
def course(request: pytest.FixtureRequest) -> Course:
    """The plane and space in turn."""
    make: Callable[[], Course] = request.param
    return make()


@pytest.fixture(scope="module")
def system(catalogue: Catalogue, member: Member, course: Course) -> System:
    """The system under test as it is on such data."""
    made: System = catalogue.build(member, *course.words)
    if course.name not in made.dimensions:
        pytest.skip(f"{member} is for {', '.join(made.dimensions)} only")
    return made


def follow(tracker: Tracker, scans: tuple[Scan, ...]) -> Array:
    """The poses (S, 4, 4) of scans fed in order."""
    return np.stack([tracker.track(scan).T_world_scan for scan in scans])


def test_known_motions_are_followed(system: System, course: Course) -> None:
    poses = follow(system.start(), course.scans)
    path, truth = (inverse(T[0]) @ T for T in (poses, course.poses))
    length = float(translation_norm(inverse(truth[:-1]) @ truth[1:]).sum())
    error = inverse(truth[-1]) @ path[-1]
    metres, degrees = float(translation_norm(error)), float(np.degrees(rotation_angle(error)))
    assert metres <= 0.1 * length and degrees <= 5.0, (
        f"after {length:.1f} m the system is {metres:.2f} m and {degrees:.1f} deg off: expected at "
        f"most a tenth of the way and 5 deg\nfound\n{path[-1]}\ntruth\n{truth[-1]}"
    )


def test_poses_are_well_formed(system: System, course: Course) -> None:
    tracker = system.start()
    for scan in course.scans[:6]:
        tracked = tracker.track(scan)
        T = tracked.T_world_scan
        assert T.dtype == np.float64 and is_rigid(T), f"scan {scan.index}: no rigid motion:\n{T}"
        assert tracked.seconds >= 0, "seconds is negative: wall time in s is expected"
        assert tracked.converged is None or isinstance(tracked.converged, bool), (
            f"converged is {tracked.converged!r}: expected Python's True, False or None"
        )
        if scan.planar:
            assert T[2].tolist() == AXIS and T[:, 2].tolist() == AXIS, (
                f"scan {scan.index}: a planar scan left the plane:\n{T}"
            )


def test_every_start_is_fresh(system: System, course: Course) -> None:
    scans = course.scans[:8]
    first = follow(system.start(), scans)
    one, other = system.start(), system.start()
    pairs = [(one.track(scan), other.track(scan)) for scan in scans]
    for number, both in enumerate(zip(*pairs, strict=True)):
        again = np.stack([tracked.T_world_scan for tracked in both])
        assert again.tobytes() == first.tobytes(), (
            f"run {number + 2} of the same scans gives other poses: is something kept between "
            "runs, or is there unseeded chance, or more than one thread?"
        )


def test_poses_handed_out_stay_as_they_are(system: System, course: Course) -> None:
    tracker = system.start()
    tracked = [tracker.track(scan) for scan in course.scans[:4]]
    kept = [t.T_world_scan.tobytes() for t in tracked]
    tracked[-1].T_world_scan[:3, 3] += 100.0
    follow(tracker, course.scans[4:5])
    assert [t.T_world_scan.tobytes() for t in tracked[:-1]] == kept[:-1]
    after = follow(tracker, course.scans[5:6])[0]
    expected = follow(system.start(), course.scans[:6])[-1]
    assert after.tobytes() == expected.tobytes(), "a pose handed out is the tracker's own array"


def test_scans_are_not_modified(system: System, course: Course) -> None:
    scans = [replace(scan, points=scan.points.copy()) for scan in course.scans[:4]]
    before = [scan.points.tobytes() for scan in scans]
    follow(system.start(), tuple(scans))
    assert [scan.points.tobytes() for scan in scans] == before, "a scan's points were modified"


def unusable(good: Array) -> dict[str, Array]:
    """Points that nothing can be done with."""
    unknown, infinite = good.copy(), good.copy()
    unknown[7, 1], infinite[3, 0] = np.nan, np.inf
    return {
        "empty": np.zeros((0, 3)),
        "one_point": good[:1],
        "nan": unknown,
        "infinite": infinite,
    }


def test_what_the_base_class_guarantees_is_not_replaced(system: System) -> None:
    """Checked scans, rigid motions, the plane: what ``Tracker.track`` does for every ``place``."""
    tracker = system.start()
    own = type(tracker).track is not Tracker.track or "track" in vars(tracker)
    assert not own, f"{type(tracker).__name__} replaces track(): write place()"


@pytest.mark.parametrize("at", [0, 3], ids=["first", "later"])
@pytest.mark.parametrize("kind", ["empty", "nan"])
def test_a_bad_scan_is_an_error_and_passes(
    system: System, course: Course, kind: str, at: int
) -> None:
    good = course.scans[at]
    bad = replace(good, points=unusable(good.points)[kind], ranges=None, angles=None)
    tracker = system.start()
    for scan in course.scans[:at]:
        tracker.track(scan)
    with pytest.raises(BackendError):
        tracker.track(bad)
    after = follow(tracker, course.scans[at : at + 6])
    expected = follow(system.start(), course.scans[: at + 6])[at:]
    assert after.tobytes() == expected.tobytes(), (
        "a scan that could not be used changed the poses after it"
    )


def test_a_scan_of_another_place_is_not_passed_off_as_placed(
    system: System, course: Course
) -> None:
    """A scan that meets nothing known is an error or a prediction that says so."""
    tracker = system.start()
    follow(tracker, course.scans[:4])
    strange = elsewhere(course)
    try:
        tracked = tracker.track(strange)
    except BackendError:
        return
    assert tracked.converged is False, (
        f"a scan that meets nothing known was placed at\n{tracked.T_world_scan}\nwith converged = "
        f"{tracked.converged}: expected BackendError or converged = False"
    )


def elsewhere(course: Course) -> Scan:
    """A few points of one small thing, where the course has free space above and all around."""
    thing = 0.02 * np.random.default_rng(1).standard_normal((40, 3))
    if course.name == "2d":
        thing[:, 2] = 0.0
        return Scan(4, 0.4, thing + np.array([-3.5, 0.0, 0.0]), True)
    turned = se3([0.0, 0.0, 0.0], rotation((0, 0, 1), 20))[:3, :3]
    return Scan(4, 0.4, thing @ turned.T + np.array([0.0, 0.0, 40.0]))
