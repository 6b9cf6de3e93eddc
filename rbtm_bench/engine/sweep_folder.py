"""What a sweep or a comparison remembers of itself, so that it can go on after anything.

The folder holds ``sweep.json``, written before the first run: what was asked, where, and with
which versions. A run counts as finished if its files are whole and its settings are those asked
for; all others are repeated.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import platform
import shlex
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal

from rbtm_bench import __version__
from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.files import make_folder, write_json
from rbtm_bench.runs import experiment, provenance, stored
from rbtm_bench.runs.claim import lock
from rbtm_bench.runs.settings import Settings

Kind = Literal["sweep", "compare", "study"]

NAMES = {"sweep": "sweep", "compare": "comparison", "study": "study"}

FILE = "sweep.json"
LIMITS = ("time_limit", "memory_limit")
"""Settings that may be others when it goes on: what a run gives does not depend on them."""
STOP = "stopped"
"""Made by ``--fail-fast`` at the first failure: jobs that find it do not begin."""
LOCK_S = 5.0
"""What the last processes of a killed sweep get to go away before it is resumed."""


@dataclass(frozen=True)
class Asked:
    """What was asked for: enough to do it again, and to do the rest of it."""

    kind: Kind
    overrides: list[str]
    config_dirs: list[str]
    fail_fast: bool
    command: list[str]
    cwd: str
    pid: int
    started: str
    versions: dict[str, str | None]
    git: str | None
    host: str

    @classmethod
    def now(
        cls,
        kind: Kind,
        words: list[str],
        overrides: list[str],
        dirs: Iterable[str],
        fail_fast: bool,
    ) -> Asked:
        """A new one, asked in this folder by this installation. ``words`` were typed."""
        return cls(
            kind,
            overrides,
            [str(Path(folder).resolve()) for folder in dirs],
            fail_fast,
            ["rbtm-bench", kind, *words],
            os.getcwd(),
            os.getpid(),
            provenance.now(),
            versions(),
            provenance.git_hash(),
            platform.node(),
        )

    @classmethod
    def read(cls, folder: Path, kind: Kind | None = None) -> Asked:
        """What a folder's sweep.json says. Raises ``ConfigError`` where there is none of this
        kind, ``DataError`` for a damaged one."""
        path = folder / FILE
        if not path.is_file():
            what = NAMES[kind] if kind else "sweep"
            raise ConfigError(f"--resume {folder}: no {what} was begun there (no {FILE} in it)")
        try:
            asked = cls(**json.loads(path.read_text(encoding="utf-8")))
        except (OSError, ValueError, TypeError, RecursionError) as error:
            raise DataError(f"{path}: cannot be read: {error}") from error
        if kind and asked.kind != kind:
            raise ConfigError(
                f"--resume {folder}: holds a {NAMES.get(asked.kind, asked.kind)}; "
                f"go on with {resume_command(asked.kind, folder)}"
            )
        return asked

    def write(self, folder: Path) -> None:
        """Write sweep.json."""
        make_folder(folder)
        write_json(folder / FILE, asdict(self))

    def again(self, words: list[str], fail_fast: bool, dirs: list[str]) -> Asked:
        """The same with other words for how to run it: launcher, time limit; and with other
        folders of configs, if any are given.

        Raises ``ConfigError`` for words that change what is run.
        """
        keys = [_key(word) for word in words]
        for key, word in zip(keys, words, strict=True):
            if key not in LIMITS and not key.startswith("hydra"):
                raise ConfigError(
                    f"{word}: --resume repeats what was asked; only {' and '.join(LIMITS)} "
                    "and the keys of hydra may change"
                )
        kept = [word for word in self.overrides if _key(word) not in keys]
        return replace(
            self,
            overrides=[*kept, *words],
            config_dirs=[str(Path(folder).resolve()) for folder in dirs] or self.config_dirs,
            fail_fast=fail_fast,
            pid=os.getpid(),
        )

    def changes(self) -> list[str]:
        """A line for every version that is not what it was."""
        now = versions()
        names = dict.fromkeys([*self.versions, *now])
        old_new = [(name, self.versions.get(name), now.get(name)) for name in names]
        lines = [f"{name} was {old}, is {new}" for name, old, new in old_new if old != new]
        if self.git != provenance.git_hash():
            lines.append(f"the checkout was {self.git}, is {provenance.git_hash()}")
        return lines


def _key(word: str) -> str:
    return word.partition("=")[0].lstrip("+~")


def versions() -> dict[str, str | None]:
    """What is installed ours."""
    ours = {"rbtm_bench": __version__, "python": platform.python_version()}
    return {**ours, **provenance.packages()}


def resume_command(kind: str, folder: Path) -> str:
    """What to type to go on; a study has its runs in a folder of its own."""
    if kind == "study":
        return shlex.join(["rbtm-bench", kind, str(folder.parent)])
    return shlex.join(["rbtm-bench", kind, "--resume", str(folder)])


@contextlib.contextmanager
def at_work(folder: Path, alone: bool = True) -> Iterator[None]:
    """Claim a sweep's folder; with ``alone`` no process may be at work there already.

    Workers claim it too, so that what is left of a killed sweep must be gone before it goes on.
    Raises ``ConfigError`` if the folder is taken. File systems without locks are trusted.
    """
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            fd = os.open(folder, os.O_RDONLY)
            stack.callback(os.close, fd)
            patience = time.monotonic() + LOCK_S
            while alone and not lock(fd, fcntl.LOCK_EX):
                if time.monotonic() > patience:
                    raise ConfigError(f"{folder}: another process is still at work there")
                time.sleep(0.1)
            lock(fd, fcntl.LOCK_SH)
        yield


_ctrl_c = threading.Event()


def check_ctrl_c() -> None:
    """Raise ``KeyboardInterrupt`` if it was raised before and got lost: inside Hydra and OmegaConf
    it may come out as an error of theirs."""
    if _ctrl_c.is_set():
        raise KeyboardInterrupt


@contextlib.contextmanager
def minding_ctrl_c() -> Iterator[None]:
    """Make Ctrl-C be noted as well as raised, for ``check_ctrl_c``, and end by it in any case. A
    SIGTERM, as a cluster sends it before it kills, counts as one."""

    def note(number: int, frame: Any) -> None:
        _ctrl_c.set()
        raise KeyboardInterrupt

    _ctrl_c.clear()
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    usual = before[signal.SIGINT] is signal.default_int_handler
    if not usual or threading.current_thread() is not threading.main_thread():
        yield
        return
    for number in before:
        signal.signal(number, note)
    try:
        yield
    except Exception:
        check_ctrl_c()
        raise
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def record_of(folder: Path) -> dict[str, Any]:
    """A run folder's run.json; {} if there is none that can be read."""
    try:
        record = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return record if isinstance(record, dict) else {}


def status(folder: Path) -> str | None:
    """A run folder's status, None if there is none that can be read."""
    return record_of(folder).get("status")


def registrations(folder: Path) -> tuple[int, float]:
    """How many registrations a run asked for, and the share that had been computed before."""
    try:
        values = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        return int(values["registrations"]), float(values["reused"] or 0.0)
    except (OSError, ValueError, TypeError, KeyError):
        return 0, 0.0


def tell_unwritten(folder: Path, record: dict[str, Any]) -> None:
    """Say why a run failed where its folder cannot: on a full disk."""
    if status(folder) != "failed":
        print(f"rbtm-bench: {folder}: {record['reason']}", file=sys.stderr)


def is_whole(folder: Path) -> bool:
    """True if a run is done and its files are all there: a power cut may have emptied some."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    record = record_of(folder)
    if record.get("status") != "done":
        return False
    sizes = {p.name: p.stat().st_size for p in folder.iterdir() if p.name in experiment.FILES}
    needed = ("config.yaml", "metrics.json", "steps.parquet", "trajectory.tum")
    if not all(sizes.values()) or not all(name in sizes for name in needed):
        return False
    try:
        json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        return bool(pq.read_metadata(folder / "steps.parquet").num_rows == record.get("scans"))
    except (OSError, ValueError, pa.ArrowException):
        return False


def is_finished(folder: Path, settings: Settings) -> bool:
    """True if the folder holds what a run with these settings gives."""
    if not is_whole(folder):
        return False
    try:
        run = stored.read_run(folder)
    except DataError:
        return False
    return run.identity.run == settings.identity.run


def clear(folders: Iterable[Path]) -> None:
    """Remove the runs in these folders, half-written files included, and nothing else."""
    for folder in folders:
        if folder.is_dir():
            experiment.clear(folder)
            clear_partial(folder)


def clear_partial(folder: Path) -> None:
    """Remove what a killed process was writing."""
    for path in folder.glob(".*.partial.*"):
        path.unlink(missing_ok=True)


def run_folders(out: Path) -> list[Path]:
    """The folders of a sweep's jobs, by number."""
    with os.scandir(out) as entries:
        numbers = [int(entry.name) for entry in entries if entry.name.isdigit()]
    return [out / str(number) for number in sorted(numbers)]


def count_done(out: Path) -> int:
    """Runs below a sweep's or comparison's folder that are done."""
    return sum(status(path.parent) == "done" for path in out.glob("*/run.json"))
