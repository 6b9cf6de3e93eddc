"""One core a process: each claim in a process of its own, with a lock folder of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

import rbtm_bench

ON_TWO_CORES = """
import os, sys
os.sched_setaffinity(0, range(os.cpu_count()))  # the tests' own process may be pinned
cores = sorted(os.sched_getaffinity(0))[:2]
os.sched_setaffinity(0, cores)
"""

CLAIM = (
    ON_TWO_CORES
    + """
from rbtm_bench.runs.pinning import pin_to_free_core
first, again = pin_to_free_core(), pin_to_free_core()
assert first == again and os.sched_getaffinity(0) == {first}
assert "numpy" not in sys.modules and "open3d" not in sys.modules
print(first, flush=True)
sys.stdin.readline()  # hold the claim
"""
)

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="this platform cannot pin"
)


def environment(lock_folder: Path) -> dict[str, str]:
    package = str(Path(rbtm_bench.__file__).parents[1])
    path = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    return {**os.environ, "TMPDIR": str(lock_folder), "PYTHONPATH": path}


@contextmanager
def claim(lock_folder: Path) -> Iterator[int]:
    """A process that holds a core for as long as this lasts; gives the core's number."""
    process = subprocess.Popen(
        [sys.executable, "-c", CLAIM],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=environment(lock_folder),
    )
    assert process.stdout is not None
    with process:
        try:
            yield int(process.stdout.readline())
        finally:
            process.communicate("done\n", timeout=30)
    assert process.returncode == 0


def output(lock_folder: Path, script: str) -> list[str]:
    """What a process prints that runs this script."""
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=60,
        env=environment(lock_folder),
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.fixture(scope="module")
def cores(tmp_path_factory: pytest.TempPathFactory) -> list[int]:
    """The two cores that the processes of these tests may use, or the only one there is."""
    script = ON_TWO_CORES + "print(*cores)"
    return [int(core) for core in output(tmp_path_factory.mktemp("locks"), script)]


def test_processes_take_different_cores_and_then_share(tmp_path: Path, cores: list[int]) -> None:
    with ExitStack() as held:
        claims = [held.enter_context(claim(tmp_path)) for _ in cores]
        assert sorted(claims) == cores
        shared = [held.enter_context(claim(tmp_path)) for _ in cores]
        assert sorted(shared) == cores, "nor do a second sweep's workers crowd on one core"


def test_a_core_is_free_again_when_its_process_ended(tmp_path: Path, cores: list[int]) -> None:
    with claim(tmp_path) as first:
        pass
    with claim(tmp_path) as second:
        assert first == second == cores[0]


def test_other_users_locks_are_not_ours(tmp_path: Path, cores: list[int]) -> None:
    """A folder a user, named by number; a claim leaves a small file and nothing else."""
    with claim(tmp_path) as core:
        files = [str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()]
        assert files == [f"rbtm_bench-{os.getuid()}/core-{core}-0.lock"]
        assert (tmp_path / files[0]).stat().st_size == 0


def test_a_file_in_place_of_the_lock_folder(tmp_path: Path, cores: list[int]) -> None:
    """No claim can be made: still pinned, to any core."""
    (tmp_path / f"rbtm_bench-{os.getuid()}").write_text("in the way")
    with claim(tmp_path) as core:
        assert core in cores


@pytest.mark.skipif(os.getuid() == 0, reason="root may write anywhere")
def test_a_lock_folder_that_is_not_writable(tmp_path: Path, cores: list[int]) -> None:
    (tmp_path / f"rbtm_bench-{os.getuid()}").mkdir(mode=0o500)
    with claim(tmp_path) as core:
        assert core in cores


def test_no_folder_for_temporary_files_at_all(tmp_path: Path, cores: list[int]) -> None:
    script = (
        ON_TWO_CORES
        + """
import tempfile
def nowhere():
    raise FileNotFoundError("no usable temporary directory found")
tempfile.gettempdir = nowhere
from rbtm_bench.runs.pinning import pin_to_free_core
print(pin_to_free_core())
"""
    )
    assert int(output(tmp_path, script)[0]) in cores


def test_where_the_platform_cannot_pin(tmp_path: Path) -> None:
    script = """
import os
del os.sched_setaffinity
from rbtm_bench.runs.pinning import pin_to_free_core
print(pin_to_free_core())
"""
    assert output(tmp_path, script) == ["None"]
