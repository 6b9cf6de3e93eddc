"""What compare and sweep share: what was asked, the claim on a folder, and the end."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from rbtm_bench.core.files import make_folder
from rbtm_bench.engine import sweep_folder
from rbtm_bench.engine.sweep_folder import Asked, Kind
from rbtm_bench.report import screen
from rbtm_bench.runs.claim import refuse_existing
from rbtm_bench.runs.settings import Settings


@contextlib.contextmanager
def asked(
    kind: Kind, words: list[str], options: argparse.Namespace, overrides: list[str]
) -> Iterator[tuple[Asked, Path | None]]:
    """What is asked for, and the folder to resume, if so: in the folder where it was asked."""
    if options.resume is None:
        dirs, quick = options.config_dir, options.fail_fast
        yield sweep_folder.Asked.now(kind, words, overrides, dirs, quick), None
        return
    folder = Path(options.resume)
    resumed = sweep_folder.Asked.read(folder, kind).again(
        overrides, options.fail_fast, options.config_dir
    )
    for change in resumed.changes():
        print(f"rbtm-bench: since {folder} was begun: {change}", file=sys.stderr)
    if resumed.cwd == os.getcwd():
        yield resumed, folder
    elif Path(resumed.cwd).is_dir():
        folder = folder.resolve()
        with contextlib.chdir(resumed.cwd):  # where its relative paths begin
            yield resumed, folder
    else:
        print(f"rbtm-bench: {resumed.cwd}, where this was begun, is gone", file=sys.stderr)
        yield replace(resumed, cwd=os.getcwd()), folder


@contextlib.contextmanager
def claimed(asked: Asked, out: Path, begin: bool, overwrite: bool) -> Iterator[None]:
    """The folder for this process alone, with what was asked for written into it. Ctrl-C says
    how to go on. With ``begin`` it must hold nothing yet: whoever was faster may have begun."""
    make_folder(out)
    with sweep_folder.at_work(out):
        if begin:
            refuse_existing(out, overwrite)
        asked.write(out)
        (out / sweep_folder.STOP).unlink(missing_ok=True)
        try:
            with sweep_folder.minding_ctrl_c():
                yield
        except KeyboardInterrupt:
            print(
                f"rbtm-bench: {sweep_folder.count_done(out)} finished runs stay; the rest: "
                f"{sweep_folder.resume_command(asked.kind, out)}",
                file=sys.stderr,
            )
            raise


def finish(
    out: Path, folders: Sequence[Path], failed: list[str], left: list[str], reused: int
) -> int:
    """Table and verdict, what failed and what was left; the exit code."""
    runs = [folder for folder in folders if (folder / "run.json").is_file()]
    code = 0
    if runs:
        try:
            tables = screen.tables_of(runs)
            screen.write_tables(out, tables)
            print(screen.of_runs(out, tables))
        except OSError as error:
            code = 1
            print(f"rbtm-bench: no table: {error}", file=sys.stderr)
    if reused:
        print(f"{reused} of {len(folders)} runs were done before", file=sys.stderr)
    if left:
        print(f"{len(left)} runs were not started: {', '.join(left)}", file=sys.stderr)
    if failed:  # the summary lists them with their reasons
        print(f"rbtm-bench: {len(failed)} of {len(folders)} runs failed", file=sys.stderr)
    return 1 if failed or left or not runs else code


def merge_pairs(settings: Settings, out: Path) -> None:
    """Fold the stores that workers wrote one by one (pairs.store=per_worker) into one."""
    folder = Path(settings.config["pairs"]["folder"] or out / "pairs")
    if list(folder.glob("pairs-*")):
        from rbtm_bench.pairs.store import merge

        merge(folder)
