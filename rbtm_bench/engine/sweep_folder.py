"""What a sweep or a comparison remembers of itself, so that it can go on after anything.

The folder holds ``sweep.json``, written before the first run: what was asked, where, and with
which versions. A run counts as finished if its files are whole and its settings are those asked
for; all others are repeated.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import platform
import re
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
from rbtm_bench.core.bounded import read_json
from rbtm_bench.core.errors import ConfigError, DataError, one_line
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
_TARGET = re.compile(r"_target_['\"]?\s*[:=]\s*['\"]?([^\s,}'\"]*)")
_RESOLVER = re.compile(r"\$\{[^}]*:")
"""Code that OmegaConf calls for a value, such as ${oc.env:HOME}."""
_HARMLESS = re.compile(r"hydra/launcher=\w+|hydra\.launcher\.(n_jobs|timeout_min)=\d+")
_PARTIAL = re.compile(r"\.\d+\.partial\.[\w.]+")
"""What ``core.files`` calls a file that is being written."""
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
            asked = cls(**read_json(path))
        except TypeError as error:
            raise DataError(f"{path}: cannot be read: {one_line(error)}") from error
        lists = (asked.overrides, asked.config_dirs, asked.command)
        if not all(isinstance(one, list) and all(isinstance(w, str) for w in one) for one in lists):
            raise DataError(f"{path}: cannot be read: expected lists of words")
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

    def strange(self, folder: Path, dirs: Iterable[str]) -> list[str]:
        """What of it reaches beyond our own code and its folder: whoever wrote the file decides
        what is run and where. ``dirs``: folders of configs that were named now."""
        named = {str(Path(one).resolve()) for one in dirs}
        what = [f"the working folder {self.cwd}"] * (self.cwd != os.getcwd())
        what += [f"plug-ins from {one}" for one in self.config_dirs if not named]
        inside = folder.resolve()
        for word in self.overrides:
            key, _, value = word.partition("=")
            key = key.lstrip("+~")
            elsewhere = key == "pairs.folder" and value not in ("", "null")
            if elsewhere and (inside / value.strip("'\"")).resolve().is_relative_to(inside):
                continue
            targets = _TARGET.findall(word)
            ours = all(target.startswith("rbtm_bench.") for target in targets)
            hydra_s = key.startswith("hydra") and not _HARMLESS.fullmatch(word)
            outside = ".." in value and "." not in key  # a member beyond the folders of configs
            if elsewhere or hydra_s or not ours or outside or _RESOLVER.search(word):
                what.append(word)
        return what

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


def refuse_links(out: Path) -> None:
    """Raise ``ConfigError`` if the folder of a sweep, or a run of it, holds a link: what is
    resumed writes and removes files in them."""
    for folder in (out, *(path for path in out.iterdir() if path.is_dir())):
        for path in (folder, *folder.iterdir()) if not folder.is_symlink() else (folder,):
            if path.is_symlink() and path != out:
                raise ConfigError(f"{path}: a link; --resume follows none: move it away")


def record_of(folder: Path) -> dict[str, Any]:
    """A run folder's run.json; {} if there is none that can be read."""
    try:
        return read_json(folder / "run.json")
    except DataError:
        return {}


def status(folder: Path) -> str | None:
    """A run folder's status, None if there is none that can be read."""
    return record_of(folder).get("status")


def registrations(folder: Path) -> tuple[int, float]:
    """How many registrations a run asked for, and the share that had been computed before."""
    try:
        values = read_json(folder / "metrics.json")
        return int(values["registrations"]), float(values["reused"] or 0.0)
    except (DataError, ValueError, TypeError, KeyError):
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
    if not all((folder / name).is_file() for name in sizes):  # a FIFO does not end
        return False
    needed = ("config.yaml", "metrics.json", "steps.parquet", "trajectory.tum")
    if not all(sizes.values()) or not all(name in sizes for name in needed):
        return False
    try:
        read_json(folder / "metrics.json")
        return bool(pq.read_metadata(folder / "steps.parquet").num_rows == record.get("scans"))
    except (DataError, OSError, ValueError, pa.ArrowException):
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
    """Remove the runs in these folders, half-written files included, and nothing else. What a
    link leads to stays as it is."""
    for folder in folders:
        if folder.is_dir() and not folder.is_symlink():
            experiment.clear(folder)
            clear_partial(folder)


def clear_partial(folder: Path) -> None:
    """Remove what a killed process was writing."""
    for path in folder.glob(".*.partial.*"):
        if _PARTIAL.fullmatch(path.name) and path.is_file():
            path.unlink(missing_ok=True)


def run_folders(out: Path) -> list[Path]:
    """The folders of a sweep's jobs, by number."""
    with os.scandir(out) as entries:
        numbers = [int(entry.name) for entry in entries if entry.name.isdigit()]
    return [out / str(number) for number in sorted(numbers)]


def count_done(out: Path) -> int:
    """Runs below a sweep's or comparison's folder that are done."""
    return sum(status(path.parent) == "done" for path in out.glob("*/run.json"))
