"""Scores and registrations of pairs, in child processes pinned to one core each.

A chunk of pairs is one job; what a pair gives depends on nothing but the pair, so the bits are the
same whatever the number of processes. A chunk whose process dies is tried again pair by pair: the
one that kills it is a row with a reason.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rbtm_bench.calibration.sampling import Sample
from rbtm_bench.core.errors import BackendError, ConfigError, RunError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Scan
from rbtm_bench.engine.crew import ChildError, Supervisor
from rbtm_bench.runs.identity import node_key
from rbtm_bench.runs.replicate import degradation

if TYPE_CHECKING:
    import pandas as pd

    from rbtm_bench.backends.base import Backend, Prepared
    from rbtm_bench.datasets.base import Dataset
    from rbtm_bench.similarity.base import Descriptor, Similarity

Node = dict[str, Any]
Row = dict[str, Any]

CHUNK = 25
"""Pairs a job."""
SCANS_KEPT = 400
"""Scans, prepared scans or descriptors that a process keeps of one data set, at most."""
MEMORY_BYTES = 200e6
"""Bytes of scans that it keeps, at most."""
COST_WINDOW, COST_SCANS = 20, 10
"""Cost is timed over windows of so many scans, for so many scans."""


SIGNED = ("along_m", "cross_m", "up_m", "roll_deg", "pitch_deg", "heading_deg")
"""The columns of a pair's signed error in its model's frame (``signed_errors``)."""


@dataclass(frozen=True, eq=False)
class Task:
    """A pair to register: motions (4, 4) T_target_source."""

    number: int
    target: int
    source: int
    guess: Array
    truth: Array


def signed_errors(T: Array, truth: Array) -> Array:
    """How far motions (..., 4, 4) T_target_source are from the true ones, in the target's frame:
    (..., 6), the difference of the translations (x ahead, y left, z up, m), and the rotation
    vector (deg) that turns the true rotation into the other, R = exp(r) R_true. In the plane
    along, cross and heading, and zeros."""
    from scipy.spatial.transform import Rotation

    R = T[..., :3, :3] @ np.swapaxes(truth[..., :3, :3], -1, -2)
    turn = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_rotvec(degrees=True)
    return np.concatenate([T[..., :3, 3] - truth[..., :3, 3], turn.reshape(*R.shape[:-2], 3)], -1)


def opened(data: Node) -> Dataset:
    """The data set of a node of ``data_node``."""
    from rbtm_bench.runs import assembly, replicate

    return replicate.copy_of(assembly.build(data["dataset"]), data)


def data_node(config: Mapping[str, Any]) -> Node:
    """What of a run's config says which scans there are."""
    node = {key: config.get(key) for key in ("dataset", "perturb", "deskew")}
    return node | ({"seed": config["seed"]} if degradation(config).changed() else {})


class _Kept:
    """What a process keeps of the data set and the plug-in that it worked with last."""

    def __init__(self) -> None:
        self.key = ""
        self.dataset: Any = None
        self.plugin: Any = None
        self.items: dict[int, Any] = {}
        self.bytes = 0.0

    def open(self, data: Node, plugin: Node) -> None:
        """Build data set and plug-in, unless they are the ones kept."""
        from rbtm_bench.runs import assembly

        data_key = node_key(data)
        key = data_key + node_key(plugin)
        if key == self.key:
            return
        if not self.key.startswith(data_key):
            self.key = ""  # if anything below fails, nothing of before stands for it
            self.dataset = opened(data)
        self.plugin, self.items, self.bytes, self.key = assembly.build(plugin), {}, 0.0, key

    def item(self, scan: int, make: Callable[[Scan], Any]) -> Any:
        """What ``make`` makes of a scan, made once as long as memory lasts."""
        if scan not in self.items:
            read = self.dataset[scan].without_truth()
            self.items[scan] = make(read)
            self.bytes += 8.0 * read.points.nbytes
            while len(self.items) > SCANS_KEPT or (
                self.bytes > MEMORY_BYTES and len(self.items) > 8
            ):
                oldest = next(iter(self.items))
                del self.items[oldest]
                self.bytes *= 1 - 1 / (len(self.items) + 1)
        return self.items[scan]


_kept = _Kept()


def register_chunk(data: Node, backend: Node, tasks: Sequence[Task]) -> list[Row]:
    """The outcome of every task: error_m, error_deg (NaN where it failed, with a reason), and what
    the registration reports of itself."""
    _kept.open(data, backend)
    return [_registered(task) for task in tasks]


def _registered(task: Task) -> Row:
    from rbtm_bench.calibration.known_pairs import errors_of
    from rbtm_bench.odometry import judge

    plugin: Backend = _kept.plugin

    def prepared(scan: int) -> Prepared:
        item: Prepared | BackendError = _kept.item(scan, lambda s: _prepare(plugin, s))
        if isinstance(item, BackendError):
            raise BackendError(str(item))
        return item

    row: Row = {"number": task.number, "error_m": math.nan, "error_deg": math.nan}
    row |= {"seconds": math.nan, "converged": None, "fitness": math.nan, "inlier_rmse_m": math.nan}
    # a run that is left without a registration goes on by its guess
    row |= dict(zip(SIGNED, signed_errors(task.guess, task.truth).tolist(), strict=True))
    try:
        source, target = prepared(task.source), prepared(task.target)
        result = judge.register(plugin, source, target, task.guess)
    except BackendError as error:
        return row | {"reason": " ".join(str(error).split())}
    metres, degrees = errors_of(result.T_target_source, task.truth)
    row |= dict(
        zip(SIGNED, signed_errors(result.T_target_source, task.truth).tolist(), strict=True)
    )
    return row | {
        "error_m": metres,
        "error_deg": degrees,
        "seconds": result.seconds,
        "converged": result.converged,
        "fitness": result.fitness,
        "inlier_rmse_m": result.inlier_rmse,
        "reason": "",
    }


def _prepare(backend: Backend, scan: Scan) -> Prepared | BackendError:
    try:
        return backend.prepare(scan)
    except BackendError as error:
        return error.with_traceback(None)


def score_chunk(
    data: Node, similarity: Node, sources: Sequence[tuple[int, Sequence[int], Array]]
) -> list[Array]:
    """The scores (W,) of every window: (source, targets (W), T_target_source (W, 4, 4))."""
    _kept.open(data, similarity)
    plugin: Similarity = _kept.plugin
    plugin.check(_kept.dataset)
    window_scores = []
    for source, targets, motions in sources:
        window = np.stack([_kept.item(i, plugin.describe) for i in targets])
        descriptor: Descriptor = _kept.item(source, plugin.describe)
        scores = plugin.scores_under(window, descriptor, motions)
        window_scores.append(np.asarray(scores, np.float64))
    return window_scores


def cost_of(data: Node, similarity: Node) -> tuple[float, float]:
    """Seconds that a descriptor takes, and the score of a pair, in windows of 20: medians of 10
    scans in the middle of the data set, after one to warm up."""
    _kept.open(data, similarity)
    dataset, plugin = _kept.dataset, _kept.plugin
    scans = len(dataset)
    count = min(COST_WINDOW + COST_SCANS + 1, scans)
    first = (scans - count) // 2
    window = min(COST_WINDOW, count - 1)
    read = [dataset[i].without_truth() for i in range(first, first + count)]
    describe, descriptors = [], []
    for scan in read:
        started = time.perf_counter()
        descriptors.append(plugin.describe(scan))
        describe.append(time.perf_counter() - started)
    score = []
    motions = np.tile(np.eye(4), (window, 1, 1))
    for j in range(window, count):
        past = np.stack(descriptors[j - window : j])
        if dataset.has_odometry:
            motions = np.stack(
                [inverse(s.odometry) @ read[j].odometry for s in read[j - window : j]]
            )
        started = time.perf_counter()
        plugin.scores_under(past, descriptors[j], motions)
        score.append((time.perf_counter() - started) / window)
    return statistics.median(describe[1:]), statistics.median(score[1:] or score)


Call = tuple[Callable[..., Any], tuple[Any, ...]]


def in_parallel(
    crew: Sequence[Supervisor], calls: Sequence[Call], pin: bool, done: Callable[[int], None]
) -> list[Any]:
    """What the calls return, in their order; a dead child's call gives its ``ChildError``.

    ``done`` gets the number of each call that is over. Every other error is raised: all
    children are then killed.
    """
    import queue

    idle: queue.LifoQueue[Supervisor] = queue.LifoQueue()
    for supervisor in reversed(crew):
        idle.put(supervisor)

    def work(number: int) -> tuple[int, Any]:
        function, args = calls[number]
        supervisor = idle.get()
        try:
            return number, supervisor.call(function, *args, pin=pin)
        except ChildError as error:
            return number, error
        finally:
            idle.put(supervisor)

    results: list[Any] = [None] * len(calls)
    with ThreadPoolExecutor(len(crew)) as threads:
        try:
            for future in as_completed([threads.submit(work, n) for n in range(len(calls))]):
                number, answer = future.result()
                results[number] = answer
                done(number)
        except BaseException:
            threads.shutdown(wait=False, cancel_futures=True)
            for supervisor in crew:
                supervisor.kill()
            raise
    return results


def register(
    crew: Sequence[Supervisor],
    data: Node,
    backend: Node,
    sample: Sample,
    pin: bool,
    done: Callable[[int], None],
) -> pd.DataFrame:
    """The outcome of every pair of the sample (K rows, in its order); ``done`` counts pairs."""
    import pandas as pd

    rows = sample.rows
    numbered = zip(rows["target"].tolist(), rows["source"].tolist(), strict=True)
    tasks = [Task(k, *pair, sample.guess[k], sample.truth[k]) for k, pair in enumerate(numbered)]
    tasks.sort(key=lambda task: (task.source, task.target))  # neighbours share prepared scans
    chunks = [tasks[i : i + CHUNK] for i in range(0, len(tasks), CHUNK)]
    calls: list[Call] = [(register_chunk, (data, backend, chunk)) for chunk in chunks]
    answers = in_parallel(crew, calls, pin, lambda n: done(len(chunks[n])))
    outcomes: list[Row] = []
    for chunk, answer in zip(chunks, answers, strict=True):
        if isinstance(answer, ChildError):
            single: list[Call] = [(register_chunk, (data, backend, [task])) for task in chunk]
            again = in_parallel(crew, single, pin, lambda n: None)
            answer = [_row_of(a, task) for a, task in zip(again, chunk, strict=True)]
        outcomes += answer
    return (
        pd.DataFrame(outcomes).sort_values("number").drop(columns="number").reset_index(drop=True)
    )


def _row_of(answer: Any, task: Task) -> Row:
    """A pair's row; of one that killed its process a failed one."""
    if not isinstance(answer, ChildError):
        row: Row = answer[0]
        return row
    signed = zip(SIGNED, signed_errors(task.guess, task.truth).tolist(), strict=True)
    nothing = dict(signed) | dict.fromkeys(
        ("error_m", "error_deg", "seconds", "fitness", "inlier_rmse_m"), math.nan
    )
    return {"number": task.number, "converged": None, "reason": str(answer), **nothing}


def score(
    crew: Sequence[Supervisor],
    data: Node,
    similarity: Node,
    target: Array,
    source: Array,
    motions: Array,
    pin: bool,
    done: Callable[[int], None],
) -> Array:
    """The scores (K,) of pairs, NaN where undefined: of one source all targets in one window."""
    pair_scores = np.full(len(target), np.nan)
    order = np.lexsort((target, source))
    places = [p for p in np.split(order, np.flatnonzero(np.diff(source[order])) + 1) if len(p)]
    size = max(1, 8 * CHUNK // max(1, len(order) // max(1, len(places))))
    chunks = [places[i : i + size] for i in range(0, len(places), size)]
    calls: list[Call] = []
    for chunk in chunks:
        windows = [(int(source[p[0]]), [int(i) for i in target[p]], motions[p]) for p in chunk]
        calls.append((score_chunk, (data, similarity, windows)))
    answers = in_parallel(crew, calls, pin, lambda n: done(sum(map(len, chunks[n]))))
    for chunk, answer in zip(chunks, answers, strict=True):
        if isinstance(answer, ChildError):
            raise RunError(f"a similarity killed its process: {answer}")
        for places_of_window, scores in zip(chunk, answer, strict=True):
            pair_scores[places_of_window] = scores
    return pair_scores


def check_similarity(data: Node, similarity: Node) -> None:
    """Raise ``ConfigError`` if the similarity cannot read the data set."""
    _kept.open(data, similarity)
    if len(_kept.dataset) < 2:
        raise ConfigError("a calibration needs at least two scans")
    _kept.plugin.check(_kept.dataset)
