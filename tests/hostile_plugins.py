"""Plug-ins that misbehave, each in a way of one's choice (``how``), at the fourth scan."""

from __future__ import annotations

import json
import locale
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from rbtm_bench.backends import base
from rbtm_bench.backends.base import Alignment, Backend, Prepared
from rbtm_bench.check.base import Check
from rbtm_bench.core.errors import BackendError, RunError
from rbtm_bench.guess.base import Guess
from rbtm_bench.metrics.base import Metric
from rbtm_bench.odometry import judge
from rbtm_bench.selection.base import Candidate, Selection, Selector
from rbtm_bench.similarity.base import Similarity
from rbtm_bench.similarity.curvature_circular import CurvatureCircular
from rbtm_bench.target.base import Target

SLEEP = [sys.executable, "-c", "import time; time.sleep(617)"]
WHEN = 4
_kept: list[Any] = []


class SpeechlessError(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


class UnpicklableError(RunError):
    def __init__(self, first: int, second: int) -> None:
        super().__init__(f"{first} {second}")
        self.lock = threading.Lock()


def raised(error: BaseException) -> None:
    raise error


def fds() -> list[int]:
    return [int(path.name) for path in Path("/proc/self/fd").glob("*")]


def on_every_fd(act: Callable[[int], Any], first: int = 3) -> None:
    for fd in fds():
        if fd >= first:
            try:
                act(fd)
            except OSError:
                continue


def run_folders() -> list[Path]:
    return [path.parent for path in Path.cwd().glob("*/*/run.json")]


def own_folder() -> Path:
    return next(
        path.parent
        for path in Path.cwd().glob("*/*/run.json")
        if json.loads(path.read_text())["status"] == "started"
    )


def spoil_others() -> None:
    for folder in run_folders():
        if "p2p" in folder.name:
            (folder / "trajectory.tum").write_text("0 9 9 9 0 0 0 1\n")


def go_on_writing() -> None:
    def write() -> None:
        while True:
            time.sleep(0.01)
            np.seterr(all="ignore")
            Path("thread").write_text("still here")

    threading.Thread(target=write).start()


def daemon() -> None:
    if os.fork() == 0:
        os.setsid()
        if os.fork() == 0:
            os.execv(SLEEP[0], SLEEP)
        os._exit(0)
    os.wait()


def daemon_then_death() -> None:
    daemon()
    time.sleep(0.1)
    os._exit(0)


def patch_rbtm() -> None:
    judge.MIN_INLIERS = 10**6
    base.is_rigid = lambda T, tolerance=0: True
    judge.evaluate = None


def crowd() -> None:
    resource.setrlimit(resource.RLIMIT_NOFILE, (300, 300))
    _kept.extend(os.open(os.devnull, os.O_RDONLY) for _ in range(10_000))


WAYS: dict[str, Callable[[], Any]] = {
    "chdir": lambda: os.chdir("/"),
    "fork": os.fork,
    "daemon": daemon,
    "daemon_then_death": daemon_then_death,
    "detach": lambda: subprocess.Popen(SLEEP, start_new_session=True),
    "exit0": lambda: os._exit(0),
    "abort": os.abort,
    "stop_itself": lambda: os.kill(os.getpid(), signal.SIGSTOP),
    "endless": lambda: [time.sleep(0.1) for _ in iter(int, 1)],
    "sys_exit": lambda: sys.exit(0),
    "interrupt": lambda: raised(KeyboardInterrupt()),
    "generator_exit": lambda: raised(GeneratorExit()),
    "thread": go_on_writing,
    "numpy_state": lambda: (np.random.seed(1), random.seed(1), np.seterr(all="raise")),
    "warnings": lambda: warnings.simplefilter("error"),
    "environment": lambda: (os.environ.clear(), locale.setlocale(locale.LC_ALL, "C")),
    "sys_path": lambda: (sys.path.clear(), sys.modules.pop("json")),
    "signal_handlers": lambda: [
        signal.signal(n, signal.SIG_IGN) for n in (signal.SIGTERM, signal.SIGIO)
    ],
    "patch_numpy": lambda: setattr(np.linalg, "eigh", None),
    "patch_rbtm": patch_rbtm,
    "close_output": lambda: (os.close(1), os.close(2), sys.stdout.close()),
    "close_all": lambda: on_every_fd(os.close),
    "print": lambda: (os.write(1, b"\0garbage\n"), print("garbage")),
    "garbage": lambda: on_every_fd(lambda fd: os.write(fd, b"\0\0\0\1garbage" * 99)),
    "delete_own": lambda: shutil.rmtree(own_folder()),
    "spoil_others": spoil_others,
    "delete_all": lambda: [shutil.rmtree(path) for path in Path.cwd().glob("o*")],
    "speechless": lambda: raised(SpeechlessError()),
    "unpicklable": lambda: raised(UnpicklableError(1, 2)),
    "huge_message": lambda: raised(ValueError("x" * 100_000_000)),
    "crowd": crowd,
    "recursion": lambda: raised(RecursionError("deep")),
    "stop_iteration": lambda: raised(StopIteration()),
    "memory": lambda: raised(MemoryError()),
}


class HostileBackend(Backend):
    """Hands back its guess; ``how`` it misbehaves is one of ``WAYS`` or an answer of its own."""

    def __init__(self, how: str = "none") -> None:
        super().__init__()
        self.how, self.calls = how, 0
        self.one = np.eye(4)

    def build(self, points: Any, planar: bool) -> None:
        self.calls += 1
        if self.calls == WHEN and self.how in WAYS:
            WAYS[self.how]()

    def prepare(self, scan: Any) -> Prepared:
        prepared = super().prepare(scan)
        if self.calls == WHEN and self.how.startswith("scan_"):
            getattr(scan, self.how[5:])[0] += 1.0
        if self.how == "other_scan":
            return Prepared(prepared.points, True, None, ((scan.index + 1, None),))
        return prepared

    def align(self, source: Prepared, target: Prepared, T_target_source: Any) -> Any:
        T = np.array(T_target_source)
        if self.how == "write_source":
            source.points[:] = 0.0
        elif self.how == "write_target":
            target.points[0] += 1e-9
        elif self.how == "write_guess":
            T_target_source[:] = np.nan
        elif self.how == "same_object":
            self.one[:] = T
            return Alignment(self.one)
        elif self.how == "huge_backend_error":
            raise BackendError("x" * 10_000_000)
        elif self.how == "counts":
            return Alignment(T, iterations="many")  # type: ignore[arg-type]
        elif self.how in POSES:
            return POSES[self.how](T)
        return Alignment(T)


POSES: dict[str, Callable[[Any], Any]] = {
    "undefined": lambda T: Alignment(T * np.nan),
    "infinite": lambda T: Alignment(T + np.inf),
    "reflected": lambda T: Alignment(np.diag([1.0, -1.0, 1.0, 1.0])),
    "complex": lambda T: Alignment(T + 1j),
    "complex_zero": lambda T: Alignment(T.astype(complex)),
    "float32": lambda T: Alignment(T.astype(np.float32)),
    "shape": lambda T: Alignment(T[:3]),
    "ragged": lambda T: Alignment([[1.0], [2.0, 3.0]]),  # type: ignore[arg-type]
    "words": lambda T: Alignment(T.astype(str)),
    "far": lambda T: Alignment(T + 1e9 * np.eye(4, k=3)),
    "frozen": lambda T: (T.setflags(write=False), Alignment(T))[1],
    "nothing": lambda T: None,
}


class HostileSelector(Selector):
    def __init__(self, how: str = "none") -> None:
        super().__init__(5)
        self.how = how

    def order(self, scan: int, models: Any, scores: Any) -> Any:
        last, how = len(models) - 1, self.how
        positions = {"minus": -1, "beyond": len(models), "half": 0.5, "truth": True, "word": "0"}
        if how == "twice":
            return [(last, "a"), (last, "b")]
        if how == "write_models":
            models[:] = scan + 1
        if how == "nameless":
            return [(last, 17)]
        return [(positions.get(how, last), "x")]

    def choose(self, scan: int, window: Any, scores: Any) -> Any:
        chosen = super().choose(scan, window, scores)
        if self.how == "future":
            return Selection((Candidate(scan + 1, 0.0, "x"),))
        if self.how == "itself":
            return Selection((Candidate(scan, 0.0, "x"),))
        if self.how == "none_at_all":
            return None
        node = window.nodes[-1]
        if self.how == "move_pose":
            node.T_world_scan.flags.writeable = True
            node.T_world_scan[0, 3] += 1.0
        if self.how == "move_odometry":
            node.odometry[0, 3] += 1.0
        if self.how == "prepared":
            node.prepared.points[:] *= 2.0
        if self.how == "empty_window":
            window.nodes.clear()
        return chosen

    def pick(self, scan: Any, trials: Any) -> Any:
        return (True, "x") if self.how == "pick_true" else super().pick(scan, trials)


class HostileSimilarity(CurvatureCircular):
    def __init__(self, how: str = "none") -> None:
        super().__init__(3.0)
        self.how = how

    def describe(self, scan: Any) -> Any:
        descriptor = super().describe(scan)
        if self.how.startswith("scan_"):
            getattr(scan, self.how[5:])[:] = 0.0
        if self.how == "patch_judge":
            judge.MIN_INLIERS = 10**6
            np.sqrt = np.square
        return descriptor if self.how != "matrix" else np.eye(3)

    def scores(self, window: Any, descriptor: Any) -> Any:
        scores = super().scores(window, descriptor)
        changed: dict[str, Callable[[], Any]] = {
            "complex": lambda: scores + 1j,
            "infinite": lambda: scores + np.inf,
            "long": lambda: np.append(scores, 1.0),
            "words": lambda: np.array(["0.9"] * len(scores)),
            "nones": lambda: [None] * len(scores),
            "nothing": lambda: None,
        }
        if self.how == "window":
            window[:] = 0.0
            descriptor[:] = 0.0
        return changed.get(self.how, lambda: scores)()

    def band(self, descriptors: Any, window: int) -> Any:
        return Similarity.band(self, descriptors, window)  # by way of ``scores``


class HostileTarget(Target):
    def __init__(self, how: str = "none") -> None:
        self.how = how

    def build(self, model: int, window: Any, backend: Any) -> Any:
        prepared = window.node(model).prepared
        if self.how == "points":
            return prepared.points
        if self.how == "lookalike":
            return SimpleNamespace(**vars(prepared))
        if self.how == "future":
            return Prepared(prepared.points, True, prepared.native, ((model + 100, None),))
        if self.how == "write":
            prepared.points[:, 0] += 0.5
        if self.how == "misnamed":  # another cloud under the model's name
            return backend._prepared(prepared.points[::-1] * 1.1, True, prepared.key)
        return prepared


class HostileGuess(Guess):
    def __init__(self, how: str = "none") -> None:
        self.how, self.one = how, np.eye(4)

    def observe(self, scan: Any, prepared: Any, register: Any) -> Any:
        if self.how == "write_scan":
            scan.points[:] += 1.0
        return {"years": np.inf, "no_time": None}.get(self.how, 0.0)

    def predict(self, model: Any, scan: Any, recent: Sequence[Any]) -> Any:
        self.one[0, 3] += 1e-3
        answers = {"complex": self.one + 1j, "undefined": self.one * np.nan, "shape": self.one[:3]}
        return answers.get(self.how, self.one)  # one object, filled again


class HostileCheck(Check):
    def __init__(self, how: str = "none") -> None:
        self.how = how

    def reject(self, result: Any, T_guess: Any) -> Any:
        if self.how == "write":
            result.T_target_source[:] = 0.0
        if self.how == "write_guess":
            T_guess[:] = 0.0
        return {"number": 1, "itself": result, "long": "x" * 10_000_000}.get(self.how)


class HostileMetric(Metric):
    columns = {"hostile": "m; nothing; nobody"}  # noqa: RUF012

    def __init__(self, how: str = "none") -> None:
        self.how = how

    def evaluate(self, estimate: Any, truth: Any, relations: Any) -> Any:
        if self.how == "write":
            estimate.T_world_scan[:] = np.eye(4)
        answers: dict[str, Any] = {
            "undefined": {"hostile": np.nan},
            "others": {"registrations": 0},
            "words": {"hostile": "good"},
        }
        return answers.get(self.how, {"hostile": 1.0})
