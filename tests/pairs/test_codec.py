"""Keys and values of the pair store: exact to the last bit."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import pickle
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pairstore_helpers import bits, key, outcome

from rbtm_bench.core.errors import BackendError
from rbtm_bench.core.types import Localizability, RegistrationResult
from rbtm_bench.pairs.codec import context, pack, pair_key, unpack
from rbtm_bench.pairs.store import PairStore

DOUBLES = st.integers(0, 2**64 - 1).map(lambda n: struct.unpack("<d", struct.pack("<Q", n))[0])
SPECIAL = st.sampled_from([0.0, -0.0, float("nan"), float("inf"), -float("inf"), 5e-324])
FLOATS = DOUBLES | SPECIAL


def matrices(side: int) -> st.SearchStrategy[np.ndarray]:
    size = side * side * 8
    return st.binary(min_size=size, max_size=size).map(
        lambda b: np.frombuffer(b, np.float64).reshape(side, side).copy()
    )


PLAIN = st.builds(
    RegistrationResult,
    T_target_source=matrices(4),
    converged=st.none() | st.booleans(),
    fitness=FLOATS,
    inlier_rmse=FLOATS,
    inliers=st.integers(0, 2**63 - 1),
    iterations=st.none() | st.integers(-(2**63), 2**63 - 1),
    seconds=FLOATS,
    information=st.none() | matrices(6),
    library_fitness=st.none() | FLOATS,
    library_rmse=st.none() | FLOATS,
    localizability=st.none() | st.builds(Localizability, matrices(3) | matrices(6), FLOATS),
)
SEARCHED = st.tuples(PLAIN, FLOATS, FLOATS, FLOATS).map(
    lambda one: dataclasses.replace(
        one[0], search_seconds=one[1], search_score=one[2], search_peak_ratio=one[3]
    )
)
RESULTS = PLAIN | SEARCHED
ERRORS = st.text().map(BackendError)


@pytest.fixture(scope="module")
def one_store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[PairStore, PairStore]]:
    """A store twice: one to write, one to read, as two processes would."""
    folder = tmp_path_factory.mktemp("pairs")
    with PairStore(folder, batch=1) as writer, PairStore(folder) as reader:
        yield writer, reader


counter = itertools.count()


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(value=RESULTS | ERRORS)
def test_values_come_back_bit_for_bit(one_store: Any, value: Any) -> None:
    writer, reader = one_store
    name = b"%d" % next(counter)
    assert reader.get(name) is None
    writer.put(name, value)
    back = reader.get(name)
    assert type(back) is type(value)
    assert bits(back) == bits(value)
    assert back is not reader.get(name)  # nobody shares arrays with anybody


@settings(max_examples=200, deadline=None)
@given(value=RESULTS | ERRORS, at=st.integers(0), bit=st.integers(0, 7))
def test_one_changed_bit_is_noticed(value: Any, at: int, bit: int) -> None:
    blob = bytearray(pack(b"key", value))
    blob[at % len(blob)] ^= 1 << bit
    for name, damaged in ((b"key", bytes(blob)), (b"kez", pack(b"key", value)), (b"key", b"")):
        assert unpack(name, damaged) is None


def test_a_value_that_would_run_something_does_not() -> None:
    """A stranger's file may hold any bytes behind a checksum that fits."""
    payload = pickle.dumps([print], 5)
    blob = hashlib.blake2b(b"key" + payload, digest_size=8).digest() + payload
    with pytest.raises(pickle.UnpicklingError, match=r"builtins\.print"):
        unpack(b"key", blob)


@pytest.mark.parametrize(
    "change",
    [
        {"T_target_source": np.eye(4, dtype=np.float32)},
        {"T_target_source": np.asfortranarray(np.arange(16.0).reshape(4, 4))},
        {"information": np.eye(6).tolist()},
        {"fitness": np.float64(1.0)},
        {"inliers": np.int64(3)},
    ],
)
def test_what_would_change_is_not_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, Any]
) -> None:
    """In its type or in the order of its numbers: BLAS may round differently."""
    with PairStore(tmp_path) as store:
        result = outcome(1)
        assert isinstance(result, RegistrationResult)
        store.put(key(1), dataclasses.replace(result, **change))
        assert store.get(key(1)) is None
    assert capsys.readouterr().err.count("is not kept") == 1


def test_failures_of_the_machine_are_not_kept(tmp_path: Path) -> None:
    with PairStore(tmp_path) as store:
        try:
            raise BackendError("MyICP: MemoryError") from MemoryError()
        except BackendError as error:
            store.put(key(1), error)
        assert store.get(key(1)) is None


POSE = np.eye(4).tobytes()
NODE = {"_target_": "a.B", "voxel_size": 0.1, "deep": {"rounds": 50, "on": True}, "list": [1, 2]}
CONTEXT: tuple[Any, ...] = ("abc", NODE, {"numpy": "2.1", "open3d": None})


def test_every_ingredient_changes_the_context() -> None:
    others = [
        ("abd", NODE, CONTEXT[2]),
        ("abc", NODE, {"numpy": "2.2", "open3d": None}),
        ("abc", NODE, {"numpy": "2.1", "open3d": ""}),
        ("abc", NODE, {"numpy": "2.1"}),
        (*CONTEXT, "planar"),
        (*CONTEXT, "2d", "3d"),
        (*CONTEXT, "2d3d"),
        (*CONTEXT, ("2d", "3d")),
    ]
    for change in (
        {"_target_": "a.C"},
        {"voxel_size": float(np.nextafter(0.1, 1))},
        {"voxel_size": "0.1"},
        {"deep": {"rounds": 50.0, "on": True}},
        {"deep": {"rounds": 50, "on": 1}},
        {"deep": {"rounds": 50, "on": None}},
        {"list": [2, 1]},
        {"list": [[1], 2]},
        {"list": [12]},
        {"more": None},
    ):
        others.append(("abc", {**NODE, **change}, CONTEXT[2]))
    contexts = [context(*CONTEXT), *(context(*other) for other in others)]
    assert len(set(contexts)) == len(contexts)


def test_the_order_of_settings_does_not_matter() -> None:
    turned = dict(reversed(NODE.items()))
    turned["deep"] = {"on": True, "rounds": 50}
    assert list(turned) != list(NODE)
    again = context("abc", turned, {"open3d": None, "numpy": "2.1"})
    assert again == context(*CONTEXT)


def test_a_setting_that_is_no_plain_data_is_refused() -> None:
    with pytest.raises(TypeError, match="object"):
        context("abc", {"x": object()}, {})


def test_every_ingredient_changes_the_key() -> None:
    guess = np.arange(16.0).reshape(4, 4)
    one = context(*CONTEXT)
    keys = [
        pair_key(one, ((3, None),), 5, guess),
        pair_key(context("abd", *CONTEXT[1:]), ((3, None),), 5, guess),
        pair_key(one, ((4, None),), 5, guess),
        pair_key(one, ((3, None),), 6, guess),
        pair_key(one, ((3, None),), 5 + 2**32, guess),
        pair_key(one, ((3, POSE),), 5, guess),
        pair_key(one, ((3, b""),), 5, guess),
        pair_key(one, ((3, None), (4, POSE)), 5, guess),
        pair_key(one, ((4, POSE), (3, None)), 5, guess),
        pair_key(one, ((3, POSE), (4, POSE)), 5, guess),
        pair_key(one, (), 5, guess),
        pair_key(one, ((3, None),), 5, guess, b"other points"),
    ]
    for index in range(16):
        other = guess.copy()
        other.flat[index] = np.nextafter(other.flat[index], 100)
        keys.append(pair_key(one, ((3, None),), 5, other))
    minus = guess.copy()
    minus[0, 0] = -0.0
    keys.append(pair_key(one, ((3, None),), 5, minus))
    assert len(set(keys)) == len(keys)
    assert pair_key(one, ((3, None),), 5, np.asfortranarray(guess)) == keys[0]
    with pytest.raises(ValueError, match="expected"):
        pair_key(one, ((3, None),), 5, np.eye(3))
