"""What is asked of a calibration: which pairs, from which guesses, and what counts as success."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from rbtm_bench.calibration.guesses import GUESSES, GuessName
from rbtm_bench.core.errors import ConfigError

TruthName = Literal["auto", "poses", "relations"]
TRUTHS: tuple[TruthName, ...] = ("auto", "poses", "relations")

GAPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
"""Scans from the model to the new scan; of relations, upper ends of the groups that their gaps
fall into."""


@dataclass(frozen=True)
class CalibrationPlan:
    """The options of a calibration, checked.

    ``gaps`` in scans (None: ``GAPS`` as far as they go); ``pairs`` a gap, of both parts together;
    ``revisits`` in all, of both parts. ``within``, ``disturb`` and ``revisit_error`` are (m, deg).
    ``replicates`` of every setting that is run on a part; 0: nothing is run, nothing advised.
    ``chain``: relations that may be joined to one motion. Raises ``ConfigError`` naming the option.
    """

    gaps: tuple[int, ...] | None = None
    pairs: int = 200
    revisits: int = 200
    truth: TruthName = "auto"
    chain: int = 4
    guess: GuessName = "auto"
    disturb: tuple[float, float] | None = None
    revisit_error: tuple[float, float] = (0.2, 5.0)
    within: tuple[float, float] = (0.1, 2.0)
    replicates: int = 10
    seed: int = 0

    def __post_init__(self) -> None:
        if self.gaps is not None and (not self.gaps or min(self.gaps) < 1):
            raise ConfigError("--gaps: expected whole numbers of 1 or more, such as 1,2,5,10")
        for name, least in (
            ("pairs", 2),
            ("revisits", 0),
            ("chain", 1),
            ("seed", 0),
            ("replicates", 0),
        ):
            if getattr(self, name) < least:
                raise ConfigError(f"--{name} {getattr(self, name)}: expected at least {least}")
        for name in ("within", "disturb", "revisit_error"):
            sizes = getattr(self, name)
            if sizes is not None and not all(0 <= size < 1e9 for size in sizes):
                option = name.replace("_", "-")
                raise ConfigError(f"--{option}: expected two numbers of 0 or more, m and deg")
        if min(self.within) <= 0:
            raise ConfigError("--within: expected two numbers above 0, m and deg")
        for name, known in (("truth", TRUTHS), ("guess", GUESSES)):
            if getattr(self, name) not in known:
                options = ", ".join(known)
                raise ConfigError(f"--{name} {getattr(self, name)}: expected one of {options}")

    @property
    def model_gaps(self) -> tuple[int, ...]:
        """The gaps, or ends of groups, from small to large."""
        return tuple(sorted(set(GAPS if self.gaps is None else self.gaps)))
