"""Control: chance at the same gaps, so that similarity is not mistaken for distance."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy.typing import NDArray

from rbtm_bench.core.errors import ConfigError, DataError
from rbtm_bench.core.kinds import OtherRun, Seed
from rbtm_bench.core.types import Array
from rbtm_bench.selection.base import Selector
from rbtm_bench.selection.fixed_gap import nearest_gap


class RandomGap(Selector):
    """Each scan's gap is drawn from the gaps of another run.

    ``gaps_from`` is that run's folder (its ``steps.parquet`` is read), or ``gaps`` lists them.
    Drawn with replacement by a generator seeded with ``seed``; for a gap that reaches behind
    the start the oldest scan is taken.
    """

    requires = ("pyarrow",)

    def __init__(
        self,
        gaps_from: OtherRun = None,
        gaps: Sequence[Annotated[int, Ge(1)]] | None = None,
        seed: Seed = 0,
    ) -> None:
        if (gaps_from is None) == (not gaps):
            raise ConfigError(
                "selector=random_gap: expected either selector.gaps_from=<run folder> "
                "or selector.gaps=[...]"
            )
        self.gaps = np.array(gaps if gaps else read_gaps(Path(str(gaps_from))), dtype=np.int64)
        self._random = np.random.default_rng(seed)
        super().__init__(capacity=int(self.gaps.max()))

    def order(self, scan: int, models: NDArray[np.int64], scores: Array) -> list[tuple[int, str]]:
        gap = int(self._random.choice(self.gaps))
        return [(nearest_gap(scan, models, gap), f"random gap {gap}")]


def read_gaps(run: Path) -> list[int]:
    """The gaps of a run's registered scans. Raises ``DataError`` if the run has none."""
    gaps = [gap for gap in gaps_by_scan(run) if gap is not None]
    if not gaps:
        raise DataError(f"{run}: the run has no registered scan to take a gap from")
    return gaps


def gaps_by_scan(run: Path) -> list[int | None]:
    """The gap of every scan of a run (its folder, or its ``steps.parquet``), None of those that
    are registered to nothing. Raises ``DataError`` where there is none to read."""
    import pyarrow.parquet as pq

    path = run / "steps.parquet" if run.is_dir() else run
    if not path.is_file():
        raise DataError(f"selector.gaps_from={run}: no steps.parquet: expected a run folder")
    try:
        column = pq.read_table(path, columns=["gap"]).column("gap").to_pylist()
        return [None if gap is None else int(gap) for gap in column]
    except Exception as error:
        raise DataError(f"{path}: not readable as a run's steps: {error}") from error
