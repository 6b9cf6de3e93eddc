"""Whether two keyframes see the same place: registered, judged, and held against the path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt

from rbtm_bench.backends.base import Prepared
from rbtm_bench.backends.correlative import CorrelativeMatcher
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.geometry import inverse, se2
from rbtm_bench.core.kinds import ShareThreshold
from rbtm_bench.core.types import Array, RegistrationResult
from rbtm_bench.core.uncertainty import InformationFrom, edge_covariance, inflated
from rbtm_bench.datasets.base import Dataset
from rbtm_bench.graph.motions import small
from rbtm_bench.loops.track import Track
from rbtm_bench.odometry.method import Work
from rbtm_bench.pairs.shared import NATIVE_SHARE, Bounded

CELL, BLUR = 0.05, 0.1
"""m: a search's step, and the standard deviation of the likelihood that it looks at."""
REACH = 3.0
"""Sigmas of the estimate that a search goes."""
OFF_PATH = "sigmas from the path"
MEMORY = 200e6
"""Bytes of prepared scans and targets that are kept."""


class Pair(NamedTuple):
    """Two keyframes, by their numbers among the keyframes, that may see the same place."""

    model: int
    scan: int


class Loop(NamedTuple):
    """A loop that is believed: a motion between two keyframes with its covariance (6, 6)."""

    pair: Pair
    T_model_scan: Array
    covariance: Array


@dataclass(frozen=True)
class Limits:
    """What a loop must be. It is registered to the older keyframe and ``neighbours`` more on either
    side, from the estimate and from the best fit of a search of three sigmas around it; where they
    reach over ``search_m`` m or ``search_deg``, the pair waits for better poses. It is believed
    with a fitness of ``min_fitness``, ``min_inliers``, a translation whose least held direction is
    held by ``min_balance`` of the best held one, and at most ``gate`` sigmas from the estimate.
    ``information`` is where the covariance of edges comes from (``uncertainty.edge_covariance``).
    """

    neighbours: Annotated[int, Ge(0)] = 5
    search_m: Annotated[float, Ge(0)] = 8.0
    search_deg: Annotated[float, Ge(0)] = 90.0
    min_fitness: ShareThreshold = 0.65
    min_inliers: Annotated[int, Ge(3)] = 40
    min_balance: ShareThreshold = 0.03
    gate: Annotated[float, Gt(0)] = 4.0
    information: InformationFrom = "localizability"


class Verifier:
    """Registers pairs of one run. ``reused_seconds`` is what registrations that were known from
    before took when they were computed."""

    def __init__(self, limits: Limits, track: Track, dataset: Dataset, work: Work) -> None:
        self._limits, self._track, self._dataset, self._work = limits, track, dataset, work
        self._prepared: Bounded[Prepared] = Bounded(MEMORY / 2)
        self._targets: Bounded[Prepared] = Bounded(MEMORY / 2)
        self._matcher = CorrelativeMatcher(CELL, BLUR) if track.planar else None
        self.reused_seconds = 0.0

    def reaches(self, unsure: Array) -> bool:
        """Whether a search goes as far as a motion with that covariance (6, 6) may be off. If not,
        what it would be given is the likeliest of the places that it may look at, which need not
        be the right one: corridors repeat themselves."""
        if self._matcher is None:
            return True
        std, limits = np.sqrt(np.diag(unsure)), self._limits
        turn = math.radians(limits.search_deg)
        return REACH * std[:2].max() <= limits.search_m and REACH * std[5] <= turn

    def verified(self, pair: Pair, T_path: Array, unsure: Array) -> Loop | str:
        """The loop, or why it is not believed. ``T_path`` (4, 4) is the best estimate of its
        motion, with its covariance (6, 6). Registered from where a search around it finds the
        likeliest place; where that fits but lies too far from the path, a second time, from the
        estimate itself."""
        try:
            source, target = self._scan(pair.scan), self._target(pair.model)
            outcome: Loop | str = OFF_PATH
            for T_start in (self._searched(source, target, T_path, unsure), T_path):
                result = self._work.register(source, target, T_start)
                self.reused_seconds += result.seconds if result.reused else 0.0
                outcome = self._judged(pair, result, T_path, unsure)
                if isinstance(outcome, Loop) or not outcome.endswith(OFF_PATH):
                    break
            return outcome
        except BackendError as error:
            return str(error)

    def _judged(
        self, pair: Pair, result: RegistrationResult, T_path: Array, unsure: Array
    ) -> Loop | str:
        """The loop that a registration gives, or why it is not believed, given the path's motion
        and how unsure that is (6, 6)."""
        own = edge_covariance(result, self._track.planar, self._limits.information)
        own = inflated(own, result.T_target_source, self._track.planar)
        why_not = self._rejection(result, T_path, unsure + own)
        return Loop(pair, result.T_target_source, own) if why_not is None else why_not

    def _rejection(self, result: RegistrationResult, T_path: Array, unsure: Array) -> str | None:
        """Why a registration is not believed, given the path's motion and how unsure the two are
        (6, 6)."""
        limits = self._limits
        if result.converged is False:
            return "not converged"
        if result.fitness < limits.min_fitness:
            return f"fitness {result.fitness:.2f} < {limits.min_fitness:g}"
        if result.inliers < limits.min_inliers:
            return f"{result.inliers} inliers < {limits.min_inliers}"
        held = result.localizability
        if held is None:
            return "no surfaces"
        side = 2 if self._track.planar else 3
        shares = np.linalg.eigvalsh(held.matrix[:side, :side])
        if shares[0] < limits.min_balance * shares[-1]:
            return f"held by {shares[0] / shares[-1]:.3f} < {limits.min_balance:g} along a wall"
        axes = self._track.axes
        off = small((inverse(T_path) @ result.T_target_source)[None])[0][axes]
        sigmas = float(np.sqrt(off @ np.linalg.solve(unsure[np.ix_(axes, axes)], off)))
        if sigmas > limits.gate:
            return f"{sigmas:.1f} > {limits.gate:g} {OFF_PATH}"
        return None

    def _searched(
        self, source: Prepared, target: Prepared, T_guess: Array, covariance: Array
    ) -> Array:
        """The likeliest motion around the guess, as far as it may be off; in space, where there is
        no search, the guess."""
        if self._matcher is None:
            return T_guess
        std = np.sqrt(np.diag(covariance))
        metres, turn = REACH * float(std[:2].max()), REACH * float(std[5])
        peak = self._matcher.match(source, target, T_guess, metres, turn)
        return se2(*peak.pose) if peak.score > 0.0 else T_guess

    def _scan(self, keyframe: int) -> Prepared:
        known = self._prepared.get(keyframe)
        if known is None:
            number = int(self._track.scans[self._track.keyframes[keyframe]])
            known = self._work.prepare(self._dataset[number])[0]
            self._prepared.put(keyframe, known, NATIVE_SHARE * known.points.nbytes)
        return known

    def _target(self, keyframe: int) -> Prepared:
        """The keyframe and its neighbours on either side, at the odometry's poses."""
        known = self._targets.get(keyframe)
        if known is None:
            count, places = self._limits.neighbours, self._track.keyframes
            near = range(max(0, keyframe - count), min(len(places), keyframe + count + 1))
            T_keyframe_world = inverse(self._track.T_world_scan[places[keyframe]])
            poses = {k: T_keyframe_world @ self._track.T_world_scan[places[k]] for k in near}
            parts = [(self._scan(k), T) for k, T in poses.items()]
            known = parts[0][0] if len(parts) == 1 else self._work.method.backend.merge(parts)
            self._targets.put(keyframe, known, NATIVE_SHARE * known.points.nbytes)
        return known
