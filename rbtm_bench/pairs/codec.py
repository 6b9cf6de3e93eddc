"""Keys and values of the pair store as bytes: exact, unambiguous, checked.

Two registrations share a key only if every ingredient is the same to the last bit, and a value
comes back as it was, bit for bit, or not at all.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Localizability, RegistrationResult

FORMAT = 3
"""Version of keys, values and the table that holds them."""


class DamageError(Exception):
    """A file or value that must not be trusted, and why. Never leaves the store."""


def context(
    fingerprint: str,
    backend_node: Mapping[str, Any],
    versions: Mapping[str, str | None],
    *dimensions: object,
) -> bytes:
    """Digest (32 bytes) of everything that is constant for a data set and a backend.

    ``backend_node`` is the backend's resolved settings, ``versions`` the libraries that make the
    numbers; ``dimensions`` is whatever else they depend on. The order of a mapping does not
    matter, every other difference does (1, 1.0, "1" and True are four values).
    Raises ``TypeError`` for a value that is no plain data.
    """
    parts = ["rbtm_bench pairs", FORMAT, fingerprint, backend_node, versions, dimensions]
    return hashlib.blake2b(_canonical(parts), digest_size=32).digest()


def pair_key(
    context: bytes,
    model: tuple[tuple[int, bytes | None], ...],
    scan: int,
    T_guess: NDArray[np.float64],
    content: bytes = b"",
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
    sizes = struct.pack("<qqqq", len(context), len(model), scan, len(content))
    parts = [sizes, context, guess.tobytes(), content]
    for number, T in model:
        parts += struct.pack("<qq", number, -1 if T is None else len(T)), T or b""
    digest = hashlib.blake2b(b"".join(parts), digest_size=16).digest()
    return context[:4] + struct.pack(">I", scan & 0xFFFFFFFF) + digest


def _canonical(value: object) -> bytes:
    """An encoding that differs for different plain data: type, length, content."""
    if value is None:
        tag, body = b"n", b""
    elif isinstance(value, bool):
        tag, body = b"b", b"1" if value else b"0"
    elif isinstance(value, int):
        tag, body = b"i", str(int(value)).encode()
    elif isinstance(value, float):
        tag, body = b"f", struct.pack("<d", value)
    elif isinstance(value, str):
        tag, body = b"s", value.encode("utf-8", "surrogatepass")
    elif isinstance(value, bytes):
        tag, body = b"y", value
    elif isinstance(value, list | tuple):
        tag, body = b"l", b"".join(map(_canonical, value))
    elif isinstance(value, Mapping):
        pairs = sorted(_canonical(k) + _canonical(v) for k, v in value.items())
        tag, body = b"d", b"".join(pairs)
    else:
        raise TypeError(f"{type(value).__name__} {value!r} cannot be part of a pair's key")
    return tag + struct.pack("<Q", len(body)) + body


_CHECKSUM = 8
_HEAD = struct.Struct("<BHqqddddd")  # kind, flags, inliers, iterations, five floats
_RESULT, _ERROR = 0, 1
_CONVERGED_GIVEN, _CONVERGED, _ITERATIONS, _FITNESS, _RMSE, _INFORMATION = 1, 2, 4, 8, 16, 32
_T_COLUMNS, _INFORMATION_COLUMNS = 64, 128  # memory order: BLAS may round differently
_PLANE, _SPACE, _LOCALIZABILITY_COLUMNS = 256, 512, 1024
_SEARCHED = 2048


def pack(key: bytes, outcome: RegistrationResult | BackendError) -> bytes:
    """Bytes of an outcome behind a checksum of key and content.

    All of a result but ``reused``, which is not about the pair. Raises ``TypeError`` or
    ``struct.error`` for what would not come back as it was.
    """
    if isinstance(outcome, BackendError):
        payload = bytes([_ERROR]) + str(outcome).encode("utf-8", "surrogatepass")
        return _checksum(key, payload) + payload
    r, flags = outcome, 0
    if r.converged is not None:
        flags |= _CONVERGED_GIVEN | (_CONVERGED if r.converged else 0)
    flags |= _ITERATIONS if r.iterations is not None else 0
    flags |= _FITNESS if r.library_fitness is not None else 0
    flags |= _RMSE if r.library_rmse is not None else 0
    arrays, by_columns = _array_bytes(r.T_target_source, 4)
    flags |= _T_COLUMNS if by_columns else 0
    if r.information is not None:
        more, by_columns = _array_bytes(r.information, 6)
        arrays += more
        flags |= _INFORMATION | (_INFORMATION_COLUMNS if by_columns else 0)
    if r.localizability is not None:
        side = 3 if len(r.localizability.matrix) == 3 else 6
        more, by_columns = _array_bytes(r.localizability.matrix, side)
        arrays += struct.pack("<d", r.localizability.lever) + more
        flags |= _PLANE if side == 3 else _SPACE
        flags |= _LOCALIZABILITY_COLUMNS if by_columns else 0
    if r.search_seconds is not None:
        arrays += struct.pack("<3d", r.search_seconds, r.search_score, r.search_peak_ratio)
        flags |= _SEARCHED
    library = [0.0 if x is None else x for x in (r.library_fitness, r.library_rmse)]
    floats = r.fitness, r.inlier_rmse, r.seconds, *library
    payload = _HEAD.pack(_RESULT, flags, r.inliers, r.iterations or 0, *floats) + arrays
    return _checksum(key, payload) + payload


def unpack(key: bytes, blob: object) -> RegistrationResult | BackendError:
    """The outcome of ``pack``. Raises ``DamageError`` if a single bit of it has changed."""
    payload = checked(key, blob)
    if payload[0] == _ERROR:
        return BackendError(payload[1:].decode("utf-8", "surrogatepass"))
    _, flags, inliers, iterations, fitness, rmse, seconds, *library = _HEAD.unpack_from(payload)
    floats = np.frombuffer(payload, np.float64, offset=_HEAD.size)
    T, rest = _matrix(floats, 4, flags & _T_COLUMNS), floats[16:]
    information = localizability = None
    if flags & _INFORMATION:
        information, rest = _matrix(rest, 6, flags & _INFORMATION_COLUMNS), rest[36:]
    if flags & (_PLANE | _SPACE):
        side = 3 if flags & _PLANE else 6
        matrix = _matrix(rest[1:], side, flags & _LOCALIZABILITY_COLUMNS)
        localizability = Localizability(matrix, float(rest[0]))
    searched = floats[-3:].tolist() if flags & _SEARCHED else [None] * 3
    return RegistrationResult(
        T_target_source=T,
        converged=bool(flags & _CONVERGED) if flags & _CONVERGED_GIVEN else None,
        fitness=fitness,
        inlier_rmse=rmse,
        inliers=inliers,
        iterations=iterations if flags & _ITERATIONS else None,
        seconds=seconds,
        information=information,
        library_fitness=library[0] if flags & _FITNESS else None,
        library_rmse=library[1] if flags & _RMSE else None,
        localizability=localizability,
        search_seconds=searched[0],
        search_score=searched[1],
        search_peak_ratio=searched[2],
    )


def _matrix(floats: NDArray[np.float64], side: int, by_columns: int) -> NDArray[np.float64]:
    """The square matrix at the start of floats, in its own memory order."""
    matrix = floats[: side * side].reshape(side, side)
    return (matrix.T if by_columns else matrix).copy("K")


def _array_bytes(array: object, side: int) -> tuple[bytes, bool]:
    """The bytes of a square matrix in its own memory order, and whether that is by columns."""
    if not isinstance(array, np.ndarray):
        raise TypeError(f"{type(array).__name__}: expected a matrix")
    if array.dtype != np.float64 or array.shape != (side, side):
        raise TypeError(f"matrix {array.shape} of {array.dtype}: expected {side}x{side} of float64")
    return array.tobytes("A"), array.flags.f_contiguous and not array.flags.c_contiguous


def checked(key: bytes, blob: object) -> bytes:
    """The content behind a checksum. Raises ``DamageError`` if the two do not fit."""
    if not isinstance(blob, bytes) or blob[:_CHECKSUM] != _checksum(key, blob[_CHECKSUM:]):
        raise DamageError("a value does not fit its checksum")
    return blob[_CHECKSUM:]


def _checksum(key: bytes, payload: bytes) -> bytes:
    return hashlib.blake2b(key + payload, digest_size=_CHECKSUM).digest()
