"""Many grids of runs in one folder, for a study made of several: runs that exist already stay."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rbtm_bench.core.files import make_folder, write_json
from rbtm_bench.engine import drive, sweep_folder
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.engine.progress import bar
from rbtm_bench.runs import experiment, provenance
from rbtm_bench.runs.grid import Point
from rbtm_bench.runs.settings import Settings

STAMP = "made_with.json"


class Campaign:
    """Makes runs side by side in a folder. A cut one goes on where it was.

    ``made`` counts the runs that were made now, ``failed`` holds the reasons of those that ended
    by an error, by name.
    """

    def __init__(self, folder: Path, crew: Sequence[Supervisor]) -> None:
        self.folder, self.crew = folder, crew
        self.made, self.failed = 0, dict[str, str]()

    def make(self, title: str, points: Iterable[Point]) -> None:
        """Make what is missing of the points, in their order."""
        asked = list(points)
        rest = [
            point
            for point in asked
            if not sweep_folder.is_finished(
                self.folder / point.name, drive.placed(point, self.folder)
            )
        ]
        print(f"{title}: {len(asked)} runs, {len(asked) - len(rest)} of them there", flush=True)
        with bar(title, len(rest)) as progress:

            def done(name: str, record: dict[str, Any]) -> None:
                self.made += 1
                if record["status"] != "done":
                    self.failed[name] = str(record["reason"])
                progress.step()

            drive.run_points(rest, self.folder, len(self.crew), done, crew=self.crew)


def begin(folder: Path, fresh: bool) -> None:
    """Make the folder. Runs of other versions, or with ``fresh`` all earlier ones, are removed:
    no table mixes them."""
    now = {"git": provenance.git_hash(), "versions": sweep_folder.versions()}
    stamp = folder / STAMP
    make_folder(folder)
    if fresh or not stamp.is_file() or stamp.read_text("utf-8") != json.dumps(now, indent=1) + "\n":
        for run in folder.glob("*/run.json"):
            experiment.clear(run.parent)
            with contextlib.suppress(OSError):
                run.parent.rmdir()
    write_json(stamp, now)


def with_value(settings: Settings, key: str, value: int) -> Settings:
    """The settings with a seed, wherever that goes, or another number ("dataset.beams").

    Composing takes Hydra 0.1 s, and the thousands of runs of a study differ in this number alone.
    """
    name = key.rpartition(".")[2]

    def changed(node: Any) -> Any:
        if isinstance(node, dict):
            return {k: value if k == name else changed(v) for k, v in node.items()}
        return node

    overrides = (*settings.overrides, f"{key}={value}")
    return replace(settings, config=changed(settings.config), overrides=overrides)
