"""Which pairs of scans are registered: across gaps and over revisits, either part by itself.

The scans are cut in two parts before any pair is drawn. A pair (or relation) with its ends in both
parts belongs to neither and is not used.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.calibration import guesses
from rbtm_bench.calibration.parts import PARTS, clusters_of, evenly, parts_of
from rbtm_bench.calibration.plan import CalibrationPlan
from rbtm_bench.calibration.reference import Known, known_motions, of_wheels
from rbtm_bench.calibration.track import Track, travelled
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.geometry import inverse, rotation_angle, translation_norm
from rbtm_bench.core.types import Array

if TYPE_CHECKING:
    import pandas as pd

Index = NDArray[np.intp]

GAP, REVISIT = "gap", "revisit"

ENOUGH_ANCHORS = 10
"""Of their own accord gaps grow only as long as a part has so many scans with all of them, or half
of its scans if it has less than twice as many."""
REVISIT_M = 2.0
"""m between the two scans of a revisit, at most."""
REVISIT_TRAVELLED_M = 10.0
"""m of path between them, at least."""
WINDOWS = 100
"""Scans a part whose windows are scored to see what a threshold would choose."""


@dataclass(frozen=True, eq=False)
class Sample:
    """The pairs (K rows) of one data set, and what goes with them.

    ``rows``: target, source (scan numbers, the model first), gap, group (the gap or group of gaps
    that it is compared within), kind, part, links, cluster, travelled_m, distance_m, rotation_deg.
    ``truth`` and ``guess`` (K, 4, 4) are T_target_source. ``part`` (N,) of every scan;
    ``path`` (N, 4, 4) their true poses, else odometry's, None without either; ``of_wheels`` (R,)
    which relations are the wheels' motion, None where truth is a pose a scan.
    ``windows``: scans that a window offers (target, source, group, part), ``window_guess`` with
    them. ``conditions``: how the pairs came about; ``counts``: how many are in and were left out.
    """

    rows: pd.DataFrame
    truth: Array
    guess: Array
    part: Index
    path: Array | None
    of_wheels: NDArray[np.bool_] | None
    windows: pd.DataFrame
    window_guess: Array
    conditions: Mapping[str, str]
    counts: Mapping[str, int]


@dataclass(eq=False)
class _Drawn:
    """Pairs as they are drawn, before guesses and predictors."""

    target: list[Index] = field(default_factory=list)
    source: list[Index] = field(default_factory=list)
    group: list[Index] = field(default_factory=list)
    part: list[Index] = field(default_factory=list)
    links: list[Index] = field(default_factory=list)
    truth: list[Array] = field(default_factory=list)
    revisit: list[NDArray[np.bool_]] = field(default_factory=list)

    def add(
        self,
        target: Index,
        source: Index,
        group: Index,
        part: int,
        truth: Array,
        links: Index | int = 0,
        revisit: bool = False,
    ) -> None:
        count = len(target)
        self.target.append(target)
        self.source.append(source)
        self.group.append(group)
        self.part.append(np.full(count, part))
        self.links.append(np.zeros(count, np.intp) + links)
        self.truth.append(truth)
        self.revisit.append(np.full(count, revisit))


def draw(track: Track, plan: CalibrationPlan) -> Sample:
    """The sample of a data set. Raises ``DataError`` if it has no pair to offer, ``ConfigError``
    for a truth or guess that it cannot give."""
    truth = truth_of(track, plan)
    guess = guesses.resolved(plan.guess, track, truth)
    known = track.known if truth == "poses" else np.ones(len(track), bool)
    part = parts_of(known)
    drawn = _Drawn()
    counts: dict[str, int] = {}
    if truth == "relations":
        assert track.relations is not None
        motions = known_motions(track, track.relations, plan.chain)
        _from_relations(drawn, motions, track, part, plan, counts)
    else:
        _across_gaps(drawn, track, part, known, plan, counts)
        if truth == "poses":
            _over_revisits(drawn, track, part, plan, counts)
    return _sample(drawn, track, part, plan, truth, guess, counts)


def truth_of(track: Track, plan: CalibrationPlan) -> str:
    """Where truth comes from: poses or relations. Raises ``DataError`` for data with neither."""
    known = {"poses": track.truth is not None, "relations": bool(track.relations)}
    if not any(known.values()):
        raise DataError("a calibration needs true poses or relations: these data have neither")
    if plan.truth == "auto":
        return next(name for name, has in known.items() if has)
    if not known[plan.truth]:
        raise ConfigError(
            f"--truth {plan.truth}: this data set has "
            f"{'no true poses' if plan.truth == 'poses' else 'no relations'}; "
            f"it has {', '.join(name for name, has in known.items() if has)}"
        )
    return plan.truth


def _across_gaps(
    drawn: _Drawn,
    track: Track,
    part: Index,
    known: NDArray[np.bool_],
    plan: CalibrationPlan,
    counts: dict[str, int],
) -> None:
    """For scans spread over each part, the pairs with the scans that lie each of the gaps back:
    the same number of pairs a gap, and the same new scans."""
    assert track.truth is not None
    gaps = _gaps_that_fit(track, part, plan)
    for number in range(len(PARTS)):
        anchors = _anchors(part, number, gaps[-1])
        anchors = anchors[evenly(len(anchors), plan.pairs // 2)]
        for gap in gaps:
            target = anchors - gap
            T = inverse(track.truth[target]) @ track.truth[anchors]
            drawn.add(target, anchors, np.full(len(anchors), gap), number, T)
    both = [(part[:-g], part[g:], known[:-g] & known[g:]) for g in gaps]
    counts["pairs that cross the cut"] = sum(int(((a != b) & k).sum()) for a, b, k in both)


def _anchors(part: Index, number: int, longest: int) -> Index:
    """Scans of a part whose last ``longest`` scans are of it as well."""
    inside = np.concatenate([[0], np.cumsum(part == number)])
    last = np.arange(longest, len(part))
    return last[inside[last + 1] - inside[last - longest] == longest + 1]


def _gaps_that_fit(track: Track, part: Index, plan: CalibrationPlan) -> tuple[int, ...]:
    """The gaps asked for; or, of their own accord, those whose scans are mostly within reach of
    each other and that a part has enough scans for."""
    gaps = plan.model_gaps
    if plan.gaps is not None:
        if any(len(_anchors(part, number, gaps[-1])) == 0 for number in range(len(PARTS))):
            raise DataError(f"no scan of each part has {gaps[-1]} others of its part before it")
        return gaps
    smaller = min(int((part == number).sum()) for number in range(len(PARTS)))
    wanted = min(ENOUGH_ANCHORS, smaller // 2)
    fit: list[int] = []
    for gap in gaps:
        if gap >= len(track):
            break
        least = min(len(_anchors(part, number, gap)) for number in range(len(PARTS)))
        far = 0.0
        if track.path is not None:
            moved = translation_norm(inverse(track.path[:-gap]) @ track.path[gap:])
            far = float(np.nanmedian(moved)) if np.isfinite(moved).any() else 0.0
        if least == 0 or (fit and (far > track.reach or least < wanted)):
            break
        fit.append(gap)
    if not fit:
        raise DataError("no two scans in a row in each half: a calibration needs more scans")
    return tuple(fit)


def _over_revisits(
    drawn: _Drawn, track: Track, part: Index, plan: CalibrationPlan, counts: dict[str, int]
) -> None:
    """Pairs of a part near in space and far apart along the path, one a scan, seeded."""
    from scipy.spatial import cKDTree

    assert track.truth is not None
    path, random = travelled(track.truth), np.random.default_rng([plan.seed, 1])
    for number in range(len(PARTS)):
        scans = np.flatnonzero(part == number)
        if len(scans) == 0 or plan.revisits < 2:
            continue
        places = track.truth[scans, :3, 3]
        near = cKDTree(places).query_ball_point(places, REVISIT_M, return_sorted=True)
        candidates = []
        for source, around in zip(scans, near, strict=True):
            before = scans[np.asarray(around, np.intp)]
            before = before[path[source] - path[before] >= REVISIT_TRAVELLED_M]
            before = before[before < source]
            if len(before):
                candidates.append((int(random.choice(before)), int(source)))
        pairs = np.array(candidates, np.intp).reshape(-1, 2)
        counts["revisits to choose from"] = counts.get("revisits to choose from", 0) + len(pairs)
        target, source = pairs[evenly(len(pairs), plan.revisits // 2)].T
        T = inverse(track.truth[target]) @ track.truth[source]
        drawn.add(target, source, np.zeros(len(target), np.intp), number, T, revisit=True)


def _from_relations(
    drawn: _Drawn,
    known: Known,
    track: Track,
    part: Index,
    plan: CalibrationPlan,
    counts: dict[str, int],
) -> None:
    """The relations of each part: local ones by groups of gaps, of each as many as are known and
    may be; long ones as revisits."""
    edges = np.array(plan.model_gaps)
    gap = known.source - known.target
    group = np.append(edges, 0)[np.searchsorted(edges, gap)]
    far = translation_norm(known.T_target_source)
    near = [g for g in edges if np.any(group == g) and np.median(far[group == g]) <= track.reach]
    crosses = part[known.target] != part[known.source]
    single = known.links == 1
    counts["relations that mean no two scans"] = known.unmatched
    counts["local relations that are the wheels' motion, left out"] = known.of_wheels
    counts["relations that cross the cut"] = int((crosses & single).sum())
    beyond = known.local & ~np.isin(group, near)
    counts["relations over larger gaps"] = int((beyond & single).sum())
    for number in range(len(PARTS)):
        inside = ~crosses & (part[known.target] == number)
        for edge in near:
            some = np.flatnonzero(inside & known.local & (group == edge))
            _add(drawn, known, group, some[evenly(len(some), plan.pairs // 2)], number)
        some = np.flatnonzero(inside & ~known.local)
        _add(drawn, known, 0 * group, some[evenly(len(some), plan.revisits // 2)], number, True)


def _add(
    drawn: _Drawn, known: Known, group: Index, some: Index, part: int, revisit: bool = False
) -> None:
    drawn.add(
        known.target[some],
        known.source[some],
        group[some],
        part,
        known.T_target_source[some],
        known.links[some],
        revisit,
    )


def _sample(
    drawn: _Drawn,
    track: Track,
    part: Index,
    plan: CalibrationPlan,
    truth: str,
    guess: guesses.GuessName,
    counts: dict[str, int],
) -> Sample:
    """Guesses, predictors and clusters of the pairs drawn."""
    T = np.concatenate(drawn.truth)
    if len(T) == 0:
        raise DataError("no pair of scans with a known motion lies in one half of the data")
    target, source, revisit = (
        np.concatenate(drawn.target), np.concatenate(drawn.source), np.concatenate(drawn.revisit),
    )  # fmt: skip
    size = plan.disturb or (0.0, 0.0)
    start, moved = _starts(track, plan, guess, size, target, source, revisit, T)
    cluster, block_s = clusters_of(track.stamps, target, source, revisit)
    rows = _rows(drawn, target, source, revisit, moved, track.travelled(), cluster)
    windows, window_guess = _windows(rows, start, track, part, truth, guess, plan)
    for name in PARTS:
        inside = (rows["part"] == name).to_numpy()
        counts[f"{name} pairs across gaps"] = int((inside & ~revisit).sum())
        counts[f"{name} revisits"] = int((inside & revisit).sum())
    conditions = {
        "truth": truth,
        "guess": guess,
        "exact": "yes" if track.exact and truth == "poses" else "",
        "disturbed": "" if size == (0.0, 0.0) else f"{size[0]:g} m and {size[1]:g} deg",
        "block_s": f"{block_s:.3g}",
    }
    path = track.truth if truth == "poses" else track.odometry
    wheels = of_wheels(track, track.relations) if truth == "relations" and track.relations else None
    return Sample(rows, T, start, part, path, wheels, windows, window_guess, conditions, counts)


def _starts(
    track: Track,
    plan: CalibrationPlan,
    guess: guesses.GuessName,
    size: tuple[float, float],
    target: Index,
    source: Index,
    revisit: NDArray[np.bool_],
    T: Array,
) -> tuple[Array, Array]:
    """Initial guesses (K, 4, 4), and the motions that are known beforehand: odometry's if the
    track has one, else the true ones. Of revisits both are the true motion with a stated error."""
    random = np.random.default_rng([plan.seed, 2])
    start = T.copy() if guess == "truth" else guesses.motions(guess, track, target, source)
    start = guesses.disturbed(start, *size, track.planar, random)
    moved = T.copy()
    if track.odometry is not None:
        moved = guesses.motions("odometry", track, target, source)
    again = guesses.disturbed(T[revisit], *plan.revisit_error, track.planar, random)
    start[revisit], moved[revisit] = again, again
    return start, moved


def _rows(
    drawn: _Drawn,
    target: Index,
    source: Index,
    revisit: NDArray[np.bool_],
    moved: Array,
    far: Array | None,
    cluster: Index,
) -> pd.DataFrame:
    import pandas as pd

    nothing: Array = np.full(len(target), np.nan)
    return pd.DataFrame(
        {
            "target": target,
            "source": source,
            "gap": source - target,
            "group": np.concatenate(drawn.group),
            "kind": np.where(revisit, REVISIT, GAP),
            "part": np.array(PARTS)[np.concatenate(drawn.part)],
            "links": np.concatenate(drawn.links),
            "cluster": cluster,
            "travelled_m": nothing if far is None else far[source] - far[target],
            "distance_m": translation_norm(moved),
            "rotation_deg": np.degrees(rotation_angle(moved)),
        }
    )


def _windows(
    rows: pd.DataFrame,
    start: Array,
    track: Track,
    part: Index,
    truth: str,
    guess: guesses.GuessName,
    plan: CalibrationPlan,
) -> tuple[pd.DataFrame, Array]:
    """What windows offer: the sampled pairs themselves, or, where these are relations, for scans
    spread over each part one scan of every group of gaps."""
    import pandas as pd

    inside = (rows["kind"] == GAP).to_numpy()
    columns = ["target", "source", "group", "part"]
    if truth != "relations":
        return rows.loc[inside, columns].reset_index(drop=True), start[inside]
    gaps = rows[inside].groupby("group")["gap"].median().round().astype(int)
    tables = []
    for number, name in enumerate(PARTS):
        if len(gaps) == 0:
            break
        anchors = _anchors(part, number, int(gaps.max()))
        anchors = anchors[evenly(len(anchors), WINDOWS)]
        for group, gap in gaps.items():
            pairs = {"target": anchors - gap, "source": anchors, "group": group, "part": name}
            tables.append(pd.DataFrame(pairs))
    empty = pd.DataFrame({name: np.zeros(0, np.intp) for name in columns})
    windows = pd.concat(tables, ignore_index=True) if tables else empty
    target, source = (windows[c].to_numpy(np.intp) for c in ("target", "source"))
    how = guess if guess != "truth" else "identity" if track.odometry is None else "odometry"
    return windows, guesses.motions(how, track, target, source)
