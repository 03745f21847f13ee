# SPDX-License-Identifier: Apache-2.0
"""Check the wiring of efforts and sensors on the first samples of a run."""

from __future__ import annotations

from fjr_core.monitoring.wiring.check import WiringCheck
from fjr_core.numerics.checks import Array
from fjr_core.robot.robot import Robot

from .measured_state import MeasuredState
from .stamp_order import Order


class WiringMonitor:
    """Feed accepted samples to a WiringCheck until every joint has been seen to follow its effort.

    The check compares measured velocities with the slopes of the positions, and both equations of each joint with the
    efforts. It needs measured velocities, so it is disabled with an observer.
    """

    def __init__(self, robot: Robot, joints: tuple[str, ...], state: MeasuredState, enabled: bool) -> None:
        self._joints, self._state, self._check = joints, state, WiringCheck(robot) if enabled else None
        self._first_stamp, self._found = 0, False

    def restart(self) -> None:
        """Check all joints again from the next sample on."""
        self._found = False
        if self._check is not None:
            self._check.start()

    def check(self, order: Order, stamp: int) -> tuple[str, str] | None:
        """Return the wiring fault that the samples up to this stamp [ns] show, once: a sentence and the first joint."""
        check = self._check
        if check is None or check.done or order is Order.REPEATED:
            return None
        if order is not Order.NEXT:
            check.skip()
            self._first_stamp = stamp
        fault = check.see((stamp - self._first_stamp) * 1e-9, self._state.position, self._state.velocity)
        if fault is None or self._found:
            return None
        self._found = True
        return fault.sentence(self._joints), self._joints[fault.joints[0]]

    def sent(self, u: Array, order: Order) -> None:
        """Keep the effort u (n,) [N m] that was sent for the last sample."""
        if self._check is not None and order is not Order.REPEATED:
            self._check.sent(u)
