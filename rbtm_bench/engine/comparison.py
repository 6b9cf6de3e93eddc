"""The points of a comparison, made by a crew of this process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.engine import beside
from rbtm_bench.engine.crew import Supervisor
from rbtm_bench.engine.driver import Grid, Told
from rbtm_bench.engine.sweep_folder import Asked
from rbtm_bench.runs import controls
from rbtm_bench.runs.grid import Point, make_points


@dataclass(frozen=True)
class Comparison(Grid):
    """A grid of named points."""

    points: list[Point]

    @classmethod
    def of(cls, overrides: list[str], extra_dirs: tuple[Path, ...], workers: int) -> Comparison:
        """Every combination of the values, and their controls. Raises ``ConfigError``."""
        if words := [word for word in overrides if word.lstrip("+~").startswith("hydra")]:
            raise ConfigError(
                f"{words[0]}: a comparison is made by the cores of this machine (--jobs); "
                "rbtm-bench sweep goes by Hydra's launchers"
            )
        points, notes = make_points(overrides, extra_dirs)
        added = controls.plan(points)
        settings = [point.settings for point in points]
        return cls(settings, [*notes, *added.notes], workers, added, points)

    @property
    def labels(self) -> dict[str, str]:
        return {name: name for name in (*(p.name for p in self.points), *self.controls.names)}

    def finished(self, out: Path) -> set[str]:
        whole = {p.name for p in self.points if beside.is_finished(p, out)}
        return whole | beside.finished(self.controls, self.points, out)

    def to_check(self, kept: set[str]) -> tuple[list[Point], list[Point] | str]:
        every = [*self.points, *self.controls.planned]
        rest = [point for point in every if point.name not in kept]
        return rest, rest

    def launch(self, kept: set[str], asked: Asked, crew: Sequence[Supervisor], told: Told) -> None:
        known = [*self.points, *self.controls.plain]
        rest = [point for point in known if point.name not in kept]
        # a copy of the data at a time
        rest.sort(key=lambda point: point.settings.config["replicate"])
        beside.run(rest, crew, told, asked.fail_fast)
        kept = kept | {point.name for point in rest}
        beside.make(self.controls, self.points, kept, crew, told, asked.fail_fast)
