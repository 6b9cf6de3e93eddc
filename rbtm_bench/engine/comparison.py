"""The points of a comparison, made by a crew of this process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine import drive, sweep_folder
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.engine.driver import Grid, Told
from rbtm_bench.engine.sweep_folder import Asked
from rbtm_bench.runs.grid import Point, make_points


@dataclass(frozen=True)
class Comparison(Grid):
    """A grid of named points."""

    points: list[Point]

    @classmethod
    def of(cls, overrides: list[str], extra_dirs: tuple[Path, ...], workers: int) -> Comparison:
        """Every combination of the values. Raises ``ConfigError``."""
        if words := [word for word in overrides if word.lstrip("+~").startswith("hydra")]:
            raise ConfigError(
                f"{words[0]}: a comparison is made by the cores of this machine (--jobs); "
                "rbtm-bench sweep goes by Hydra's launchers"
            )
        points, notes = make_points(overrides, extra_dirs)
        return cls([point.settings for point in points], notes, workers, points)

    @property
    def labels(self) -> dict[str, str]:
        return {point.name: point.name for point in self.points}

    def finished(self, out: Path) -> set[str]:
        whole = sweep_folder.is_finished
        return {p.name for p in self.points if whole(out / p.name, drive.placed(p, out))}

    def to_check(self, kept: set[str]) -> tuple[list[Point], list[Point]]:
        rest = [point for point in self.points if point.name not in kept]
        return rest, rest

    def launch(self, kept: set[str], asked: Asked, crew: Sequence[Supervisor], told: Told) -> None:
        def done(name: str, record: dict[str, Any]) -> None:
            if record["status"] != "done":
                sweep_folder.tell_unwritten(told.out / name, record)
            told(name, record)

        rest, _ = self.to_check(kept)
        part, quick = told.bar.part, asked.fail_fast
        drive.run_points(rest, told.out, len(crew), done, fail_fast=quick, part=part, crew=crew)
