"""Believe every registration."""

from __future__ import annotations

from rbtm_bench.check.base import Check
from rbtm_bench.core.types import Array, RegistrationResult


class AcceptAll(Check):
    """Accepts whatever the backend returns (a backend's error is still a rejection)."""

    accepts_all = True

    def reject(self, result: RegistrationResult, T_guess: Array) -> str | None:
        return None
