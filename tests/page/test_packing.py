from __future__ import annotations

import json

import numpy as np
import pytest
from page_helpers import unpacked

from rbtm_bench.page.packing import MISSING, as_script, packed, quantised


@pytest.mark.parametrize(
    ("kind", "low", "high"),
    [("u8", 0, 255), ("i16", -32768, 32767), ("i32", -(2**31), 2**31 - 1)],
)
@pytest.mark.parametrize("stride", [0, 1, 3])
def test_integers_come_back_whatever_their_differences(kind, low, high, stride) -> None:
    values = np.random.default_rng(0).integers(low, high, 100, endpoint=True)
    values[:4] = [low, high, low, high]  # differences beyond the type wrap, there and back
    assert unpacked(packed(values, kind, stride)).tolist() == values.tolist()


def test_numbers_come_back_in_single_precision() -> None:
    values = np.array([0.1, np.nan, -3e8])
    np.testing.assert_array_equal(unpacked(packed(values, "f32")), values.astype(np.float32))


def test_points_keep_half_a_step_and_nothing_is_missing() -> None:
    values = np.array([-50.0, 0.0123, np.nan, 50.0])
    scale = 50.0 / 32767
    whole = quantised(values, scale)
    assert whole.tolist()[2] == MISSING and (whole[[0, 1, 3]] > MISSING).all()
    np.testing.assert_allclose(whole[[0, 1, 3]] * scale, values[[0, 1, 3]], atol=scale / 2)


def test_no_string_ends_the_script_element() -> None:
    words = {"</script><script>alert(1)": ["<!--", "&lt;", "\u2028\u2029", "\udcff"]}
    text = as_script(words)
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == words


def test_what_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError):
        as_script({"error": float("nan")})
