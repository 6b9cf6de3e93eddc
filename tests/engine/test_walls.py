"""Whatever a plug-in does is its own row: the others have the bits that they have alone."""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest
from sweep_helpers import call, record_of

HOSTILE = """
import os, signal, subprocess, sys
import numpy as np
from rbtm_bench.backends.open3d_p2p import PointToPoint
from rbtm_bench.odometry import judge
from rbtm_bench.similarity.curvature_circular import CurvatureCircular


class Stop(BaseException):
    pass


def misbehave(how, scan):
    if how == "scribble":
        scan.points[:] = scan.points[::-1] * 1.5
    elif how == "chdir":
        os.chdir("/")
    elif how == "fork":
        os.fork()
    elif how == "detach":
        words = [sys.executable, "-c", "import time; time.sleep(617)"]
        subprocess.Popen(words, start_new_session=True)
    elif how == "interrupt":
        raise KeyboardInterrupt
    elif how == "stop":
        raise Stop("enough")
    elif how == "patch":
        np.linalg.eigh = lambda matrix: (np.ones(len(matrix)), np.eye(len(matrix)))
        judge.MIN_INLIERS = 10**6
    elif how == "signal":
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})


class Backend(PointToPoint):
    def __init__(self, max_correspondence_distance: float, how: str = "none"):
        super().__init__(max_correspondence_distance)
        self.how, self.calls = how, 0

    def prepare(self, scan):
        self.calls += 1
        if self.calls == 5:
            misbehave(self.how, scan)
        return super().prepare(scan)


class Similarity(CurvatureCircular):
    def describe(self, scan):
        descriptor = super().describe(scan)
        misbehave("scribble", scan)
        return descriptor
"""
HOW = ("scribble", "chdir", "fork", "detach", "interrupt", "stop", "patch", "signal")
FAILED = {
    "fork": "hostile left a process behind",
    "detach": "hostile left a process behind",
    "interrupt": "KeyboardInterrupt",
    "stop": "Stop: enough",
}
SMALL = ("dataset.scans=14", "dataset.beams=181", "pictures=false")
CALM = ("backend=open3d_p2p,plicp", "selector=previous,rbtm", "selector.window=5", *SMALL)


@pytest.fixture(scope="module")
def calm(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("calm") / "c"
    assert call("compare", *CALM, f"out={out}")[0] == 0
    return trajectories(out)


def trajectories(out: Path) -> dict[str, bytes]:
    return {p.parent.name: p.read_bytes() for p in sorted(out.glob("*/trajectory.tum"))}


@pytest.fixture
def configs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    from rbtm_bench.backends import open3d_p2p

    names = [
        n
        for n, v in vars(open3d_p2p).items()
        if getattr(v, "__module__", "") == open3d_p2p.__name__
    ]
    (tmp_path / "hostile.py").write_text(HOSTILE.replace("PointToPoint", names[0]))
    for group, name in (("backend", "Backend"), ("similarity", "Similarity")):
        folder = tmp_path / "configs" / group
        folder.mkdir(parents=True)
        text = f"_target_: hostile.{name}\n"
        if group == "backend":
            text += "max_correspondence_distance: 0.3\nhow: none\n"
        (folder / "hostile.yaml").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path / "configs"


def sleepers() -> list[int]:
    """Processes of these tests that sleep on."""
    pids = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if b"time.sleep(617)" in path.read_bytes():
                pids.append(int(path.parent.name))
        except OSError:
            continue
    return pids


@pytest.mark.slow
def test_hostile_backends_beside_built_in_ones(
    configs: Path, calm: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # a relative folder, for those that go elsewhere
    words = (*CALM, f"backend.how={','.join(HOW)}", "--config-dir", str(configs), "--jobs", "2")
    words = tuple(w.replace("open3d_p2p,plicp", "hostile,open3d_p2p,plicp") for w in words)
    before = set(sleepers())
    code, _, error = call("compare", *words, "out=o", "selector=previous,rbtm")
    assert code == 1 and "verdict" not in error
    after = trajectories(Path("o"))
    assert {name: after[name] for name in calm} == calm
    for how in HOW:
        for selector in ("previous", "rbtm"):
            record = record_of(Path("o") / f"hostile-{selector}-how={how}")
            expected = FAILED.get(how)
            assert (record["status"] == "failed") is (expected is not None), (how, record)
            assert expected is None or expected in record["reason"], record["reason"]
    time.sleep(0.2)
    for pid in set(sleepers()) - before:
        os.kill(pid, signal.SIGKILL)
        pytest.fail(f"process {pid} outlives the comparison")


@pytest.mark.slow
def test_a_scribbling_similarity_beside_built_in_ones(
    configs: Path, calm: dict[str, bytes], tmp_path: Path
) -> None:
    """Its own rows too: it writes into copies. Nor does it spoil the registrations kept."""
    words = [w for w in CALM if not w.startswith("selector=")]
    out = tmp_path / "o"
    code, _, error = call(
        *("compare", *words, "selector=previous,rbtm", f"out={out}"),
        *("similarity=curvature_circular,hostile", "--config-dir", str(configs), "--jobs", "1"),
    )
    assert code == 0, error
    after = trajectories(out)
    for name, poses in calm.items():
        for end in ("", "-curvature_circular", "-hostile"):
            assert after.get(name + end, poses) == poses, name + end
    again = tmp_path / "again"
    assert call("compare", *CALM, f"pairs.folder={out / 'pairs'}", f"out={again}")[0] == 0
    assert trajectories(again) == calm
    metrics = json.loads((again / "plicp-rbtm" / "metrics.json").read_text())
    assert metrics["reused"] == 1.0
