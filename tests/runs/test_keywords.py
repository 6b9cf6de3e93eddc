"""Python's values mean as settings what they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rbtm_bench.core.errors import ConfigError
from rbtm_bench.runs.keywords import OF_METHOD, OF_PAIR, objects_and_names, of_values
from rbtm_bench.runs.settings import compose_settings, composing, parsed
from rbtm_bench.selection.previous import Previous


@pytest.mark.parametrize(
    "value",
    [None, True, False, 0, -3, 0.1, 1e-7, 1e22, float("inf"), "plain", "1e3", "null", "true",
     "it's", "a,b", "größe", "a=b", "", [1, 2.5], ["x y", None], [[1], [2]], {"a": 1}],
)  # fmt: skip
def test_a_value_comes_back_as_it_is(value: Any) -> None:
    with composing():
        (override,) = parsed(of_values({"some__key": value}))
    assert override.key_or_group == "some.key" and not override.is_sweep_override()
    assert override.value() == value and type(override.value()) is type(value)


def test_numbers_of_numpy_and_paths() -> None:
    values = {"a": np.float64(0.5), "b": np.arange(2), "c": Path("x"), "d.e": (np.int64(1), 2)}
    assert of_values(values) == ["a=0.5", "b=[0,1]", "c=x", "d.e=[1,2]"]


def test_several_values() -> None:
    values = {"seed": range(3), "backend": ["none", "plicp"], "x": np.array([1, 2]), "g": [[1, 2]]}
    words = of_values(values, several=True)
    assert words == ["seed=0,1,2", "backend=none,plicp", "x=1,2", "g=[1,2]"]
    with pytest.raises(ConfigError, match="seed: an empty list"):
        of_values({"seed": []}, several=True)


def test_what_no_setting_can_be() -> None:
    with pytest.raises(ConfigError, match=r"selector\.window: object: expected text"):
        of_values({"selector__window": object()})


def test_objects_are_told_from_names() -> None:
    mine = Previous()
    given, named = objects_and_names({"selector": mine, "backend": "plicp"}, OF_METHOD, "odometry")
    assert given == {"selector": mine}
    assert named == {"backend": "plicp", "selector": "previous"}
    with pytest.raises(ConfigError, match="selector__window: expected of the object itself"):
        objects_and_names({"selector": mine, "selector__window": 3}, OF_METHOD, "odometry")


def test_a_setting_that_does_nothing_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"selector: no setting of register\. Known: backend, search"
    ):
        objects_and_names({"selector": "rbtm"}, OF_PAIR, "register")


def test_a_bare_name_is_told_its_group() -> None:
    with pytest.raises(ConfigError, match=r"^window: no such .* mean selector\.window\?$"):
        compose_settings(["window=3"])
    with pytest.raises(ConfigError, match=r"voxel_size\? *$|backend\.voxel_size"):
        compose_settings(["voxel_size=3"])
