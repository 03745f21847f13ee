# SPDX-License-Identifier: Apache-2.0
"""Step to the minimum of a quadratic model whose parameters may be bounded by zero."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from fjr_core.numerics.checks import Array


def bounded_step(H: Array, g: Array, z: Array, bounded: Array, damping: float = 0.0) -> Array:
    """Return the step (p,) that maximises g' step - step' (H + damping diag H) step / 2.

    H (p, p): positive definite. z + step is not negative where bounded (p,).
    """
    if not len(z):
        return np.zeros(0)
    scale = np.sqrt(np.diag(H))
    R = np.linalg.cholesky(H / np.outer(scale, scale) + damping * np.eye(len(z))).T
    least = np.where(bounded, -z * scale, -np.inf)
    return np.asarray(lsq_linear(R, np.linalg.solve(R.T, g / scale), (least, np.inf), method="bvls").x / scale)
