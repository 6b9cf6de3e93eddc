"""Sweeps and comparisons that are stopped: by Ctrl-C, by kill, by a full disk."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from sweep_helpers import MOODY, begin, call, record_of, script, statuses

from rbtm_bench.engine import sweep_folder


def wait_for(out: Path, count: int) -> None:
    """Until so many runs of a sweep are done."""
    patience = time.monotonic() + 60
    while time.monotonic() < patience:
        if sweep_folder.count_done(out) >= count:
            return
        time.sleep(0.02)
    raise AssertionError("the sweep does not get on")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "group", "number"),
    [
        (("sweep",), True, signal.SIGINT),
        (("sweep", "hydra/launcher=joblib"), True, signal.SIGINT),  # as a terminal does it
        (("sweep", "hydra/launcher=joblib"), False, signal.SIGINT),
        (("compare", "--jobs", "2"), True, signal.SIGINT),
        (("compare", "--jobs", "2"), False, signal.SIGTERM),  # as a cluster does it
        (("sweep",), False, signal.SIGTERM),
        (("sweep", "hydra/launcher=joblib"), False, signal.SIGTERM),
    ],
)
def test_ctrl_c(
    tmp_path: Path, words: tuple[str, ...], group: bool, number: signal.Signals
) -> None:
    out = tmp_path / "out"
    grid = ("backend=moody", "backend.how=slow", "dataset.scans=30,31,32,33,34,35")
    process = begin(*words, *grid, "selector=previous", *MOODY, f"out={out}")
    wait_for(out, 2)
    (os.killpg if group else os.kill)(process.pid, number)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert f"rbtm-bench {words[0]} --resume {out}" in err
    assert "Traceback" not in err, err
    finished = {p: p.read_bytes() for p in out.glob("*/run.json") if record_of(p.parent)["seconds"]}
    assert 2 <= len(finished) < 6
    code, _, err = call(words[0], "--resume", str(out), "--trust")
    assert code == 0 and statuses(out) == ["done"] * 6
    assert {p: p.read_bytes() for p in finished} == finished


@pytest.mark.slow
@pytest.mark.parametrize("times", [3, pytest.param(30, marks=pytest.mark.soak)])
@pytest.mark.parametrize("words", [[], ["--launcher", "joblib", "--parent-only"]])
def test_killed_at_random_moments(
    tmp_path: Path, words: list[str], times: int, capsys: pytest.CaptureFixture[str]
) -> None:
    code = script("kill_sweep").main(["--times", str(times), "--out", str(tmp_path), *words])
    assert code == 0, capsys.readouterr().out
    assert f"kills: {times}" in capsys.readouterr().out


@pytest.fixture
def tiny_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 150 kB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=152k", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("needs the right to mount a file system")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


@pytest.mark.parametrize("command", ["sweep", "compare"])
def test_a_full_disk(tiny_disk: Path, command: str) -> None:
    out = tiny_disk / "out"
    words = ("backend=none", "dataset.scans=12,13,14,15,16,17", "selector=previous")
    code, shown, err = call(command, *words, f"out={out}")
    assert code == 1
    assert re.search(rf"{out}/\S+: cannot be written: No space left on device", shown + err)
    grow = ["mount", "-o", "remount,size=20m", str(tiny_disk)]
    subprocess.run(grow, check=True)
    finished = [p for p in out.glob("*/run.json") if sweep_folder.is_whole(p.parent)]
    before = {p: p.read_bytes() for p in finished}
    assert 0 < len(before) < 6
    code, _, err = call(command, "--resume", str(out))
    assert code == 0 and f"{len(before)} of 6 runs were done before" in err
    assert statuses(out) == ["done"] * 6
    assert {p: p.read_bytes() for p in before} == before


@pytest.mark.parametrize("name", ["config.yaml", "run.json", "steps.parquet", "map.npz"])
def test_a_full_disk_names_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    replace = os.replace

    def full(old: str, new: Path) -> None:
        if Path(new).name == name:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(old, new)

    monkeypatch.setattr(os, "replace", full)
    out = tmp_path / "out"
    words = ("backend=none", "dataset.scans=12", "selector=previous", f"out={out}", "pin=false")
    code, shown, err = call("run", *words)
    assert (code, shown) == (1, "")
    assert err == f"rbtm-bench: {out / name}: cannot be written: No space left on device\n"
    if name in ("steps.parquet", "map.npz"):
        assert record_of(out)["reason"] == err.removeprefix("rbtm-bench: ").strip()
    assert not list(out.glob(".*partial*"))


def test_ctrl_c_is_not_lost_inside_a_library() -> None:
    with pytest.raises(KeyboardInterrupt), sweep_folder.minding_ctrl_c():
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            raise ValueError("an error of the library's own") from None
    with pytest.raises(KeyboardInterrupt), sweep_folder.minding_ctrl_c():
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        sweep_folder.check_ctrl_c()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    with pytest.raises(ValueError, match="own"), sweep_folder.minding_ctrl_c():
        sweep_folder.check_ctrl_c()
        raise ValueError("its own")
