# SPDX-License-Identifier: Apache-2.0
"""The check of the wiring of the control step (wiring.c) by itself, for recorded states."""

from __future__ import annotations

from typing import Any

import numpy as np

from fjr_core.model.robot import Robot
from fjr_core.numerics import jit
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import WiringFault
from fjr_core.runtime.library import CFunction, WorkSpace, step_library
from fjr_core.runtime.structs import rigid_arm_functions, write_robot


class WiringCheck:
    """Check of the wiring with samples and efforts from the start until every joint is right or a fault is found.

    Raises CompilerError without a C compiler.
    """

    def __init__(self, robot: Robot) -> None:
        library = step_library(robot.n)
        self._ffi, self._lib = library.ffi, library.lib
        functions = {name: jit.compiled(f) for name, f in rigid_arm_functions(robot).items()}
        self._held = {name: CFunction(self._ffi, function) for name, function in functions.items()}
        self._work = WorkSpace(self._ffi, list(functions.values()))
        self._model, self.state = self._ffi.new("struct fjr_model *"), self._ffi.new("struct fjr_wiring *")
        for name, each in self._held.items():
            setattr(self._model, name, each.pointer)
        self._work.lend(self._model)
        write_robot(self._model, robot)
        self._lib.fjr_wiring_start(self.state)

    def skip(self) -> None:
        """Discard the samples so far; the next one does not follow them."""
        self._lib.fjr_wiring_skip(self.state)

    @property
    def done(self) -> bool:
        """Return whether all signals of all joints are known to be right."""
        return bool(self._lib.fjr_wiring_is_right(self.state))

    def see(self, t: float, q: Array, dq: Array) -> WiringFault | None:
        """Take the state q, dq (2n,) at time t [s]; return the fault once consecutive comparisons agree on it."""
        self._lib.fjr_wiring_see(self.state, t, self._pointer(q), self._pointer(dq))
        self._lib.fjr_wiring_compare(self._model, self.state)
        while self.state.comparing and not self.state.found:  # here nothing waits for an answer
            self.state.waiting = 1
            self._lib.fjr_wiring_compare(self._model, self.state)
        return WiringFault.of(self.state.fault) if self.state.found else None

    def sent(self, u: Array) -> None:
        """Take the command u (n,) [N m] for the last state."""
        self._lib.fjr_wiring_sent(self.state, self._pointer(u))

    def _pointer(self, values: Array) -> Any:
        return self._ffi.from_buffer("double[]", np.ascontiguousarray(values, dtype=float))
