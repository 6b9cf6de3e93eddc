"""What a check is: it accepts a registration or says why not."""

from __future__ import annotations

from abc import ABC, abstractmethod

from rbtm_bench.core.types import Array, RegistrationResult


class Check(ABC):
    """Looks at a registration before the loop believes it."""

    requires: tuple[str, ...] = ()
    accepts_all: bool = False
    """True for a check that never rejects: selectors that rely on a check refuse it."""

    @abstractmethod
    def reject(self, result: RegistrationResult, T_guess: Array) -> str | None:
        """Why the registration is not believed, or None to accept it.

        ``T_guess`` (4, 4) is the initial guess T_model_scan that it started from.
        """

    def reject_first(self, result: RegistrationResult, T_guess: Array) -> str | None:
        """As ``reject``, for a guess that knows of no motion yet (``Guess.has_motion``): what lies
        between it and the result is the motion itself. By default no different."""
        return self.reject(result, T_guess)

    def accept(self, result: RegistrationResult) -> None:  # noqa: B027 (for a check that learns)
        """A registration that gave a scan its pose: what a check may compare later ones with."""
