"""What may be wrong counts the less, the more it disagrees."""

from __future__ import annotations

import numpy as np

from rbtm_bench.core.types import Array


def dcs(chi2: Array, phi: float) -> tuple[Array, Array]:
    """The scale s of each edge's residual and its cost (E,), given e^T information e.

    s = min(1, 2 phi / (phi + chi2)): Agarwal, Tipaldi, Spinello, Stachniss, Burgard, "Robust map
    optimization using dynamic covariance scaling", ICRA 2013, eq. 15. The cost is that whose
    derivative by chi2 is s^2: chi2 up to phi, then phi (3 chi2 - phi) / (chi2 + phi) < 3 phi.
    """
    scale = np.minimum(1.0, 2.0 * phi / (phi + chi2))
    return scale, np.where(chi2 <= phi, chi2, phi * (3.0 * chi2 - phi) / (chi2 + phi))
