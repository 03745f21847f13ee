# SPDX-License-Identifier: Apache-2.0
"""The inertia that a joint carries while the other joints move freely, the least that its spring may feel."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array


def least_free_inertia(M_l: ArrayLike) -> Array:
    """Return for each joint (n,) the least 1 / (M_l^-1)_ii [kg m^2] over link inertias (k, n, n)."""
    return np.asarray(1 / np.diagonal(np.linalg.inv(np.asarray(M_l)), axis1=1, axis2=2).max(axis=0))
