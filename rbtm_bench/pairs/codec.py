"""Keys and values of the pair store as bytes: exact, unambiguous, checked.

Two registrations share a key only if every ingredient is the same to the last bit, and a value
comes back as it was, bit for bit, or not at all.
"""

from __future__ import annotations

import hashlib
import io
import json
import pickle
from dataclasses import fields
from typing import Any, NoReturn

import numpy as np

from rbtm_bench.backends.base import TargetKey
from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Array, Localizability, RegistrationResult

FORMAT = 4
"""Version of keys, values and the table that holds them."""

Outcome = RegistrationResult | BackendError

_CHECKSUM = 8  # bytes
_FIELDS = [field.name for field in fields(RegistrationResult) if field.name != "reused"]


def context(*facts: object) -> bytes:
    """Digest (32 bytes) of everything that is constant for a data set and a backend: plain data,
    in which the order of a mapping alone does not matter (1, 1.0, "1" and True are four values).
    Raises ``TypeError`` for anything else.
    """
    text = json.dumps(["rbtm_bench pairs", FORMAT, *facts], sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=32).digest()


def pair_key(
    context: bytes, model: TargetKey, scan: int, T_guess: Array, content: bytes = b""
) -> bytes:
    """Key (24 bytes) of one registration, exact to the last bit of the guess (4, 4).

    ``content`` is a digest of both clouds' points, whatever a data set says of itself. ``model``
    lists the scans of the target: their numbers and the bytes of their poses in it (None for a
    single scan). The digest (16 bytes) follows 4 bytes of the context and the scan number, so that
    a sweep writes neighbouring pages: about 5 times faster than at random.
    """
    guess = np.asarray(T_guess, dtype=np.float64)
    if guess.shape != (4, 4):
        raise ValueError(f"guess {guess.shape}: expected (4, 4)")
    text = repr((context, model, scan, guess.tobytes(), content))
    digest = hashlib.blake2b(text.encode(), digest_size=16).digest()
    return context[:4] + (scan % 2**32).to_bytes(4) + digest


def pack(key: bytes, outcome: Outcome) -> bytes:
    """Bytes of an outcome behind a checksum of key and content.

    All of a result but ``reused``, which is not about the pair. Raises ``TypeError`` for what
    would not come back as it was.
    """
    if isinstance(outcome, BackendError):
        payload = pickle.dumps(str(outcome), 5)
    else:
        payload = pickle.dumps([_plain(getattr(outcome, name)) for name in _FIELDS], 5)
    return _checksum(key, payload) + payload


def unpack(key: bytes, blob: bytes) -> Outcome | None:
    """The outcome of ``pack``, reused; None if a single bit of it or of the key has changed."""
    if not is_intact(key, blob):
        return None
    plain = _PlainData(io.BytesIO(blob[_CHECKSUM:])).load()
    if isinstance(plain, str):
        return BackendError(plain)
    values = dict(zip(_FIELDS, map(_whole, plain), strict=True))
    return RegistrationResult(**values, reused=True)


def is_intact(key: bytes, blob: object) -> bool:
    """Whether a value fits its checksum."""
    return isinstance(blob, bytes) and blob[:_CHECKSUM] == _checksum(key, blob[_CHECKSUM:])


def _checksum(key: bytes, payload: bytes) -> bytes:
    return hashlib.blake2b(key + payload, digest_size=_CHECKSUM).digest()


def _plain(value: object) -> object:
    """A field of a result as plain data."""
    if value is None or type(value) in (bool, int, float):
        return value
    if isinstance(value, Localizability):
        return _plain(value.matrix), _plain(value.lever)
    if isinstance(value, np.ndarray) and value.dtype == np.float64 and value.flags.c_contiguous:
        return value.shape[0], value.tobytes()
    raise TypeError(f"{type(value).__name__} {value!r} would not come back as it is")


def _whole(plain: Any) -> Any:
    """What ``_plain`` was given."""
    if not isinstance(plain, tuple):
        return plain
    first, second = plain
    if isinstance(first, tuple):
        return Localizability(_whole(first), second)
    return np.frombuffer(second, np.float64).reshape(first, -1).copy()


class _PlainData(pickle.Unpickler):
    """Reads numbers, text and bytes: a file of a stranger's can have nothing run."""

    def find_class(self, module_name: str, global_name: str) -> NoReturn:
        raise pickle.UnpicklingError(f"{module_name}.{global_name} in a pair store")
