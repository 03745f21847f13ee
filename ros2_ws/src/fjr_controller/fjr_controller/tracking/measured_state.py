# SPDX-License-Identifier: Apache-2.0
"""The measured state: one buffer that the measurement or an observer writes and everything else reads in place."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fjr_core import StateError, VelocityObserver
from fjr_core.numerics.checks import Array

from .stamp_order import Order

if TYPE_CHECKING:
    from fjr_msgs_py.messages.joint_states import JointSample

OBSERVED = 5
"""Samples after an observer reset before its velocity estimates are used."""


class MeasuredState:
    """Positions and velocities of n joints in one contiguous buffer, without copies between its readers.

    values (4n,) = (q_l, q_m, dq_l, dq_m); position (2n,) = (q_l, q_m) [rad]; velocity (2n,) = (dq_l, dq_m) [rad/s].
    q_l, q_m, dq_l, dq_m, deflection and tracking_error (n,) are views, too. limited (6n,) = (values, deflection,
    tracking_error) is what StateLimits compares.
    """

    def __init__(self, n: int) -> None:
        self.limited = np.zeros(6 * n)
        self.values, self.position, self.velocity = (self.limited[a * n : b * n] for a, b in ((0, 4), (0, 2), (2, 4)))
        self.q_l, self.q_m, self.dq_l, self.dq_m, self.deflection, self.tracking_error = self.limited.reshape(6, n)

    @property
    def finite(self) -> bool:
        """Return True if every value is finite and its square does not overflow."""
        return bool(self.values.dot(self.values) < np.inf)

    def write(self, sample: JointSample) -> None:
        """Copy the measured positions and velocities. Raise StateError if the sample has no velocities."""
        if sample.dq_l is None or sample.dq_m is None:
            raise StateError("the sample has no velocities; expected them, or an observer")
        self.q_l[...], self.q_m[...] = sample.q_l, sample.q_m
        self.dq_l[...], self.dq_m[...] = sample.dq_l, sample.dq_m


class StateMeasurement:
    """Write each sample into the measured state: as it is, or through the velocity observer if there is one."""

    def __init__(self, state: MeasuredState, observer: VelocityObserver | None) -> None:
        self._state, self._observer = state, observer

    def warm_up(self) -> None:
        """Evaluate the observer once, so that the first sample takes no longer than any other."""
        if self._observer is not None:
            for stamp in (0, 1_000_000):
                self._observer.update(stamp, *(np.zeros(len(self._state.q_l)),) * 3)
            self._observer.reset()

    def update(self, sample: JointSample, order: Order, u: Array) -> bool:
        """Update the state and return True if it is finite; u (n,) [N m]: the effort that acted since the last sample.

        Raise StateError if the sample has no velocities and there is no observer.
        """
        if self._observer is None:
            self._state.write(sample)
        elif order is not Order.REPEATED:
            if order is not Order.NEXT:
                self._observer.reset()
            self._observer.update(sample.stamp, sample.q_l, sample.q_m, u)
            self._state.values[...] = self._observer.state
        return self._state.finite

    def settling(self, order: Order) -> int:
        """Return how many further samples the velocities need before they are used; 0 unless an observer was reset."""
        if self._observer is None or order is Order.REPEATED:
            return 0
        return OBSERVED if self._observer.fresh else 0

    def reset(self) -> None:
        """Reset the observer, if there is one."""
        if self._observer is not None:
            self._observer.reset()
