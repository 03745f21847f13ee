# SPDX-License-Identifier: Apache-2.0
"""The effort that acts on the motors: a zero-order hold of the record, delayed, as mean over each integration step."""

from __future__ import annotations

import numpy as np

from ..numerics.checks import Array


class HeldEffort:
    """u(t) = u_k for t in [k dt, (k + 1) dt) of each joint; constant before the first and after the last sample.

    u (k, n) [N m], dt [s]. A mean over a step is smooth in the delay, a sample of u is not.
    """

    def __init__(self, u: Array, dt: float) -> None:
        self._u, self._dt = u, dt
        self._integral = np.vstack([np.zeros(u.shape[1]), np.cumsum(u, axis=0)])  # over sample periods

    def mean(self, first: int, samples: int, parts: int, delay: Array) -> tuple[Array, Array]:
        """Return the mean effort (samples, parts, n) of each part of a sample period, and its derivative by the delay.

        first: sample at which the first period starts. delay (n,) [s].
        """
        edges = first + np.arange(samples * parts + 1)[:, None] / parts - delay / self._dt
        below = np.floor(edges).astype(int)
        at = np.clip(below, 0, len(self._u) - 1)
        joint = np.arange(self._u.shape[1])
        held = self._u[at, joint]
        integral = self._integral[at, joint] + (edges - at) * held
        shape = (samples, parts, len(delay))
        derivative = -np.diff(held, axis=0) * parts / self._dt
        return (np.diff(integral, axis=0) * parts).reshape(shape), derivative.reshape(shape)
