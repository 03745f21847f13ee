# SPDX-License-Identifier: Apache-2.0
"""Check the wiring of efforts and sensors on the first samples of a run."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fjr_core.control_step.control_step import ControlStep
from fjr_core.monitoring.wiring.check import WiringCheck

CALLBACK = "int(void *, int, int64_t, const double *, const double *, const double *)"


class WiringMonitor:
    """Feed accepted samples to a WiringCheck until every joint has been seen to follow its effort.

    The control step calls it for each sample, and no longer once all joints are right. The check compares measured
    velocities with the slopes of the positions, and both equations of each joint with the efforts.
    on_fault: called with the sentence of a fault before the step stops.
    """

    def __init__(self, step: ControlStep, on_fault: Callable[[str], None]) -> None:
        self._step, self._on_fault, self._check = step, on_fault, WiringCheck(step.law.robot)
        self._first_stamp, self._found, ffi = 0, False, step.ffi
        self._pointer = ffi.callback(CALLBACK, self._see)
        self.restart()

    def restart(self) -> None:
        """Check all joints again from the next sample on."""
        self._found = False
        self._check.start()
        self._step.model.wiring = self._pointer

    def _see(self, _context: Any, order: int, stamp: int, position: Any, velocity: Any, effort: Any) -> int:
        """Return 1 + the first joint of a fault that the samples up to this stamp [ns] show, once; else 0."""
        lib, check, n = self._step.lib, self._check, self._step.law.robot.n
        if check.done or order == lib.FJR_REPEATED:
            return 0
        if order == lib.FJR_NEXT:
            check.sent(self._array(effort, n))
        else:
            check.skip()
            self._first_stamp = stamp
        t = (stamp - self._first_stamp) * 1e-9
        fault = check.see(t, self._array(position, 2 * n), self._array(velocity, 2 * n))
        self._step.model.wiring = self._step.ffi.NULL if self._check.done else self._pointer
        if fault is None or self._found:
            return 0
        self._found = True
        self._on_fault(fault.sentence(self._step.settings.joints))
        return 1 + int(fault.joints[0])

    def _array(self, values: Any, size: int) -> Any:
        return np.frombuffer(self._step.ffi.buffer(values, 8 * size))
