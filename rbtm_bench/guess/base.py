"""What an initial guess is: a prediction of the motion between the model scan and the new one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import numpy as np

from rbtm_bench.backends.base import Prepared
from rbtm_bench.core.errors import ConfigError
from rbtm_bench.core.geometry import inverse
from rbtm_bench.core.types import Array, Node, RegistrationResult, Scan
from rbtm_bench.datasets.base import Dataset

Register = Callable[[Prepared, Prepared, Array], RegistrationResult]
"""Registers source to target from a guess (4, 4); raises ``BackendError`` if it cannot be done."""


class Guess(ABC):
    """Predicts T_model_scan. ``pure``: it depends on the pair alone, not on the trajectory."""

    requires: tuple[str, ...] = ()
    pure: bool = False
    needs_odometry: bool = False
    needs_backend: bool = False
    """True if ``observe`` registers scans, so that the guess depends on the backend as well."""

    def check(self, dataset: Dataset) -> None:
        """Raise ``ConfigError`` if the data set lacks what this guess needs."""
        if self.needs_odometry and not dataset.has_odometry:
            raise ConfigError(
                f"the chosen guess ({type(self).__name__}) needs odometry, which this data set "
                f"({type(dataset).__name__}) does not have: use guess=constant_velocity"
            )

    def observe(self, scan: Scan, prepared: Prepared | None, register: Register) -> float:
        """See every scan once, before its first ``predict``; returns the seconds it took.
        ``register`` is the run's own backend, for a guess that registers scans itself."""
        return 0.0

    def has_motion(self, recent: Sequence[Node]) -> bool:
        """Whether ``predict`` has a motion to go by; if not, a check does not ask how far from the
        guess a registration ended (``Check.reject_first``)."""
        return True

    @abstractmethod
    def predict(self, model: Node, scan: Scan, recent: Sequence[Node]) -> Array:
        """T_model_scan (4, 4). ``recent`` holds the last one or two scans, newest last."""


def odometry_of(item: Node | Scan) -> Array:
    """T_odom_scan of a scan of a data set that has odometry."""
    assert item.odometry is not None
    return item.odometry


def from_previous(model: Node, recent: Sequence[Node], T_previous_scan: Array) -> Array:
    """T_model_scan of a motion since the previous scan, along the estimated trajectory."""
    return inverse(model.T_world_scan) @ recent[-1].T_world_scan @ T_previous_scan


IDENTITY = np.eye(4)
