"""Faults put into a copy of the package, one at a time: a test named for each must notice it.

    python scripts/mutants.py                      all of scripts/mutants.yaml
    python scripts/mutants.py --only holm_factor   one of them (may be repeated)

A mutant is one change of a few words: in the only file at or below `where` (in rbtm_bench) that
holds `old`, which must stand there exactly once, it becomes `new`; then `test`, a function of the
suite or one case of it, must fail. `jit: false`: the kernels run uncompiled. The working tree is
never touched: every worker has a copy of its own, and a change is taken back after its test. All
the tests named must pass on an unchanged copy first. The status is 1 if a mutant survives.
"""

from __future__ import annotations

import argparse
import os
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

REPO = Path(__file__).resolve().parents[1]
LIST = Path(__file__).with_suffix(".yaml")
PACKAGE = "rbtm_bench"
COPIED = (
    *(PACKAGE, "configs", "tests", "scripts", "docs", "results/reference"),
    *("pyproject.toml", "README.md"),
)
TIME_LIMIT_S = 120.0
"""Of one mutant's test; no answer in time counts as a survivor: a busy machine is no proof."""
ALL_LIMIT_S = 600.0
"""Of all named tests on the unchanged copy."""
FAILED = 1
"""pytest's exit code of tests that ran and failed; other ones say that they did not run."""
OUTCOME = re.compile(r"(PASSED|FAILED|ERROR) (\S+::[^\s\[]+(?:\[.*?\])?)(?: - .*)?$")

KILLED, SURVIVED, UNFIT = "killed", "SURVIVED", "test does not pass unmutated"


class ListError(Exception):
    """The list of mutants does not fit the tree."""


@dataclass(frozen=True)
class Mutant:
    """One change and the test that must notice it; ``where`` is relative to the package."""

    name: str
    where: str
    old: str
    new: str
    test: str
    jit: bool = True


def read_list(path: Path = LIST) -> list[Mutant]:
    """The mutants of a file. Raises ``ListError`` for entries that are none."""
    entries: Any = yaml.safe_load(path.read_text("utf-8"))
    try:
        mutants = [Mutant(**entry) for entry in entries]
    except TypeError as error:
        raise ListError(f"{path}: {error}") from error
    names = [mutant.name for mutant in mutants]
    twice = {name for name in names if names.count(name) > 1}
    same = [mutant.name for mutant in mutants if mutant.old == mutant.new]
    if twice or same:
        raise ListError(f"{path}: named twice: {sorted(twice)}; no change: {same}")
    return mutants


def place(mutant: Mutant, root: Path) -> Path:
    """The file below ``root`` that the mutant changes. Raises ``ListError`` unless ``old`` stands
    exactly once at or below ``where``."""
    start = root / PACKAGE / mutant.where
    files = [start] if start.is_file() else sorted(start.rglob("*.py"))
    counts = {file: file.read_text("utf-8").count(mutant.old) for file in files}
    if sum(counts.values()) != 1:
        raise ListError(
            f"{mutant.name}: {mutant.old!r} stands {sum(counts.values())} times in {mutant.where}"
        )
    return next(file for file, count in counts.items() if count)


def make_copy(folder: Path, repo: Path = REPO) -> Path:
    """What the tests need, copied into a new ``folder``."""
    folder.mkdir(parents=True)
    for name in COPIED:
        if (repo / name).is_dir():
            ignored = shutil.ignore_patterns("__pycache__", ".*")
            shutil.copytree(repo / name, folder / name, ignore=ignored)
        else:
            shutil.copy2(repo / name, folder / name)
    return folder


@contextmanager
def changed(mutant: Mutant, root: Path) -> Iterator[None]:
    """The copy with the mutant in it; afterwards it is as before."""
    file = place(mutant, root)
    before = file.read_bytes()
    text = before.decode("utf-8")
    try:
        file.write_bytes(text.replace(mutant.old, mutant.new).encode("utf-8"))
        yield
    finally:
        file.write_bytes(before)


def environment(root: Path, jit: bool) -> dict[str, str]:
    """That of a test on the copy: the package from there, compiled kernels beside it, and no byte
    code kept, which could be older than a change in the same second."""
    env = {k: v for k, v in os.environ.items() if not k.startswith(("PYTEST_", "NUMBA_"))}
    env |= {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
    env |= {"NUMBA_CACHE_DIR": str(root.parent / "kernels")}
    return env if jit else {**env, "NUMBA_DISABLE_JIT": "1"}


def run_tests(root: Path, words: Sequence[str], jit: bool, limit: float) -> tuple[int | None, str]:
    """pytest's exit code (None: not done within ``limit`` s) and what it says."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words],
            cwd=root,
            env=environment(root, jit),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=limit,
        )
    except subprocess.TimeoutExpired:
        return None, f"no answer within {limit:g} s"
    return done.returncode, done.stdout + done.stderr


def passing(root: Path, mutants: Sequence[Mutant], jit: bool) -> tuple[set[str], str]:
    """Of the tests of these mutants those that pass on the copy (one that is skipped does not),
    and pytest's last words: of a test that it cannot find, it runs none at all."""
    tests = sorted({mutant.test for mutant in mutants if mutant.jit == jit})
    if not tests:
        return set(), ""
    _, output = run_tests(root, ["-rA", *tests], jit, ALL_LIMIT_S)
    outcomes: dict[str, set[str]] = {}
    for line in output.splitlines():
        match = OUTCOME.match(line)
        if match:
            for test in {match[2], match[2].partition("[")[0]}:
                outcomes.setdefault(test, set()).add(match[1])
    return {test for test in tests if outcomes.get(test) == {"PASSED"}}, _last_line(output)


def _last_line(output: str) -> str:
    return (output.strip().splitlines() or ["no output"])[-1]


@dataclass(frozen=True)
class Verdict:
    """What became of a mutant, after how long, and, unless it was killed, what pytest printed."""

    mutant: Mutant
    outcome: str
    seconds: float
    output: str = ""

    @property
    def line(self) -> str:
        """Its row of the table."""
        row = f"{self.mutant.name:25} {self.outcome:9} {self.seconds:5.1f} s  {self.mutant.test}"
        return "\n    ".join(filter(None, [row, self.output]))


def judge(mutant: Mutant, root: Path) -> Verdict:
    """Whether the mutant's test fails on the changed copy. Only a test that ran and failed is a
    kill: not one that could not be collected, nor one that never ended."""
    started = time.perf_counter()
    with changed(mutant, root):
        code, output = run_tests(root, ["-x", mutant.test], mutant.jit, TIME_LIMIT_S)
    seconds = time.perf_counter() - started
    if code == FAILED:
        return Verdict(mutant, KILLED, seconds)
    return Verdict(mutant, SURVIVED, seconds, f"pytest's exit code {code}: {_last_line(output)}")


def judge_all(mutants: Sequence[Mutant], roots: Sequence[Path]) -> Iterator[Verdict]:
    """The verdicts in the order of the list, by as many workers as there are copies."""
    copies: queue.SimpleQueue[Path] = queue.SimpleQueue()
    for root in roots:
        copies.put(root)

    def one(mutant: Mutant) -> Verdict:
        root = copies.get()
        try:
            return judge(mutant, root)
        finally:
            copies.put(root)

    with ThreadPoolExecutor(len(roots)) as pool:
        yield from pool.map(one, mutants)


def check(mutants: Sequence[Mutant], jobs: int) -> list[Verdict]:
    """Judge the mutants in temporary copies and print a line each."""
    verdicts: list[Verdict] = []

    def tell(verdict: Verdict) -> None:
        verdicts.append(verdict)
        print(verdict.line, flush=True)

    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        roots = [make_copy(Path(folder) / f"copy{i}") for i in range(jobs)]
        for mutant in mutants:
            place(mutant, roots[0])
        with ThreadPoolExecutor(jobs) as pool:
            whole = [pool.submit(passing, roots[-jit], mutants, bool(jit)) for jit in (0, 1)]
            good = [future.result() for future in whole]
        fit = [mutant for mutant in mutants if mutant.test in good[mutant.jit][0]]
        for mutant in mutants:
            if mutant not in fit:
                tell(Verdict(mutant, UNFIT, 0.0, good[mutant.jit][1]))
        for verdict in judge_all(fit, roots):
            tell(verdict)
    return verdicts


def main(words: Sequence[str] | None = None) -> int:
    """The command line; 1 if a mutant survives or its test is unfit, 2 for a list that is wrong."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--only", action="append", metavar="NAME", help="only this mutant")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="workers (default: 2)")
    options = parser.parse_args(words)
    started = time.perf_counter()
    try:
        mutants = read_list()
        if options.only:
            unknown = set(options.only) - {mutant.name for mutant in mutants}
            if unknown:
                raise ListError(f"no such mutant: {', '.join(sorted(unknown))}")
            mutants = [mutant for mutant in mutants if mutant.name in options.only]
        verdicts = check(mutants, max(1, options.jobs))
    except ListError as error:
        print(f"mutants: {error}", file=sys.stderr)
        return 2
    killed = sum(verdict.outcome == KILLED for verdict in verdicts)
    print(f"{killed} of {len(mutants)} killed in {time.perf_counter() - started:.0f} s")
    return 0 if killed == len(mutants) else 1


if __name__ == "__main__":
    sys.exit(main())
