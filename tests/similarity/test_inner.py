"""Inner products: right, and the same bits wherever the vectors lie."""

from __future__ import annotations

import numpy as np
import pytest

from rbtm_bench.similarity.inner import inner


@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 340, 701])
def test_it_is_the_sum_of_products(count: int) -> None:
    rng = np.random.default_rng(count)
    x, y = rng.normal(size=(4, 1, count)), rng.normal(size=(3, count))
    found = inner(x, y)
    assert found.shape == (4, 3)
    np.testing.assert_allclose(found, np.vecdot(x, y), rtol=0, atol=1e-15 * max(count, 1) * 16)


def test_neither_place_nor_company_changes_a_bit() -> None:
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=701), rng.normal(size=701)
    found = set()
    for k in range(8):
        for m in range(8):
            a, b = np.empty(720)[k : k + 701], np.empty(720)[m : m + 701]
            a[:], b[:] = x, y
            found.add(float(inner(a, b)))
            found.add(float(inner(np.stack([b, a, b, a]), b[None])[k % 2 * 2 + 1]))
    strided = np.repeat(x, 3)[::3]
    assert found == {float(inner(strided, y))}
