# SPDX-License-Identifier: Apache-2.0
"""The effort that acts on the motors: a delayed zero-order hold of the record, as a line over each integration step."""

from __future__ import annotations

import numpy as np

from ..numerics.checks import Array


class HeldEffort:
    """u(t) = u_k for t in [k dt, (k + 1) dt) of each joint; constant before the first and after the last sample.

    u (k, n) [N m], dt [s]. An integration step is no longer than dt, so that the effort switches in it once at most.
    The line has the mean and the first moment of the effort in the step: velocities and positions are exact where
    nothing else acts. Unlike a sample of u it is continuous in the delay.
    """

    def __init__(self, u: Array, dt: float) -> None:
        self._u, self._dt = u, dt

    def lines(self, first: int, samples: int, parts: int, delay: Array) -> tuple[Array, Array]:
        """Return the effort over the parts of sample periods (samples, parts, 2, n), and its derivative by the delay.

        The two rows are the mean, and half of the increment over the part. first: sample at which the first period
        starts. delay (n,) [s].
        """
        start = first + np.arange(samples * parts)[:, None] / parts - delay / self._dt
        held = np.floor(start).astype(int)
        until = (held + 1 - start) * parts  # the switch, in parts
        share = np.minimum(until, 1.0)
        joint, last = np.arange(self._u.shape[1]), len(self._u) - 1
        before = self._u[np.clip(held, 0, last), joint]
        jump = np.where(until <= 1, self._u[np.clip(held + 1, 0, last), joint] - before, 0.0)
        line = np.stack([before + (1 - share) * jump, 3 * share * (1 - share) * jump], axis=1)
        derivative = np.stack([-jump, 3 * (1 - 2 * share) * jump], axis=1) * (parts / self._dt)
        shape = (samples, parts, 2, len(delay))
        return line.reshape(shape), derivative.reshape(shape)
