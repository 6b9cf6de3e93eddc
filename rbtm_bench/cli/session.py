"""What compare and sweep share: what was asked, and the table at the end."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine import sweep_folder
from rbtm_bench.engine.driver import Grid, drive
from rbtm_bench.engine.sweep_folder import Asked, Kind
from rbtm_bench.report import screen


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
    stored = sweep_folder.Asked.read(folder, kind)
    sweep_folder.refuse_links(folder)
    if not options.trust and (strange := stored.strange(folder, options.config_dir)):
        raise ConfigError(
            f"--resume {folder}: its {sweep_folder.FILE} names {'; '.join(strange)}: "
            "only if you know who wrote it, add --trust"
        )
    resumed = stored.again(overrides, options.fail_fast, options.config_dir)
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


def carry_out(grid: Grid, asked: Asked, out: Path, resumed: bool) -> int:
    """Make a grid's runs; table and verdict, what failed and what was left; the exit code."""
    ended = drive(grid, asked, out, resumed)
    if ended.broken:
        print(f"rbtm-bench: the launcher gave up: {ended.broken}", file=sys.stderr)
        print(f"go on with: {sweep_folder.resume_command(asked.kind, out)}", file=sys.stderr)
    folders, failed, left = ended.folders, ended.failed, ended.left
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
    if ended.reused:
        print(f"{ended.reused} of {len(folders)} runs were done before", file=sys.stderr)
    if left:
        print(f"{len(left)} runs were not started: {', '.join(left)}", file=sys.stderr)
    if failed:  # the summary lists them with their reasons
        print(f"rbtm-bench: {len(failed)} of {len(folders)} runs failed", file=sys.stderr)
    return 1 if failed or left or ended.broken or not runs else code
