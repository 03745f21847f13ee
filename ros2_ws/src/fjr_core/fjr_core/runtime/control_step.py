# SPDX-License-Identifier: Apache-2.0
"""One controller in memory of C: the structures of step.h with all that they point to."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import GainsError, StateError, UserCodeError
from ..law.interfaces import StaticLaw, raise_failure
from ..motions.reference import JETS, Reference
from ..numerics.checks import Array
from ..numerics.jit import compiled
from ..numerics.symbolic import NumericFunction
from ..robust.law import Robust, RobustLaw, sampled_law
from .library import step_library
from .measurement_model import Measurement
from .reference_struct import ReferenceStruct
from .safety_settings import Settings
from .settings_struct import Model, law_function, model_functions, settings_struct
from .velocity_observer import VelocityObserver

NEVER = -(2**63)
"""FJR_NEVER: no stamp."""


class ControlStep:
    """A controller of step.h with its law, settings and references; its functions are those of step.h.

    After `step` returned True the arrays hold the command of the sample: u (n,) [N m], jets (5, n), position and
    velocity (2n,) at which the law was evaluated. They are overwritten by the next call.
    controller, model, command: pointers to the structures. lib, ffi: functions and types of cffi.
    compile: compile the functions of a law that is not compiled.
    Raises GainsError if the law's effort is not finite, CompilerError without a C compiler.
    """

    def __init__(
        self,
        law: StaticLaw,
        reference: Reference,
        settings: Settings,
        observer: VelocityObserver | None = None,
        simulated: bool = False,
        robust: Robust | None = None,
        measurement: Measurement | None = None,
        compile: bool = False,
    ) -> None:
        n, self.law, self.settings = law.robot.n, law, settings
        self._sampled = sampled_law(law, robust)
        self.library = step_library(n, len(self._sampled.memory))
        ffi, self.lib = self.library.ffi, self.library.lib
        self.ffi = ffi
        self.law_failure = ""
        functions = model_functions(self._sampled, observer) if compile else {}
        functions = {name: compiled(function) for name, function in functions.items()}
        self._model = Model(self.library, self._sampled, observer, measurement, simulated, self._law_failed, functions)
        self.model = self._model.pointer
        self.controller, self.command = ffi.new("struct fjr_controller *"), ffi.new("struct fjr_command *")
        self._sample = ffi.new("struct fjr_sample *")
        self._link, self._motor = self._view(self._sample, "link"), self._view(self._sample, "motor")
        self._dq_l, self._dq_m = self._view(self._sample, "velocity").reshape(2, n)
        self.u, self.position, self.velocity = (
            self._view(self.command, name) for name in ("u", "position", "velocity")
        )
        self.jets = self._view(self.command, "jets").reshape(JETS, n)
        self.measured = self._view(self.controller, "measured.values")
        self._gains = self._checked_gains(law, np.zeros((JETS, n)))
        self._references = [ReferenceStruct(ffi, reference)]
        written = settings_struct(self.library, settings, law)
        self.lib.fjr_init(self.controller, written, self._address(self._gains), self._references[0].pointer)

    @property
    def in_c(self) -> bool:
        """True if a step calls no Python."""
        return self._model.in_c

    def step(self, stamp: int, arrival: int, q_l: Array, q_m: Array, dq_l: Array | None, dq_m: Array | None) -> bool:
        """Compute the command for a sample; return False if nothing is to be sent.

        stamp, arrival [ns]. q_l, q_m (n,) [rad], dq_l, dq_m (n,) [rad/s]: as measured, before the gear;
        q_m: the joint torque where that is measured. Raise StateError if there are neither velocities nor an observer.
        """
        self._sample.stamp = stamp
        self._link[:], self._motor[:] = q_l, q_m
        if not self.model.observer:
            if dq_l is None or dq_m is None:
                raise StateError("the sample has no velocities; expected them, or an observer")
            self._dq_l[:], self._dq_m[:] = dq_l, dq_m
        found = bool(self.lib.fjr_step(self.model, self.controller, self._sample, arrival, self.command))
        for reference in self._references:
            reference.raise_failure()
        return found

    def check_wiring(self) -> None:
        """Check the wiring with the last sample, after its command was sent; else the next step does it first."""
        self.lib.fjr_check_wiring(self.model, self.controller)

    def silence(self, now: int) -> Array | None:
        """Return the stop effort (n,) once if nothing came for state_timeout, see fjr_silence; None otherwise."""
        u = self.ffi.new("double[]", len(self.u))
        return self._array(u) if self.lib.fjr_silence(self.model, self.controller, now, u) else None

    def stop_effort(self) -> Array:
        """Return the stop policy's effort (n,) without a sample; it counts as sent."""
        u = self.ffi.new("double[]", len(self.u))
        self.lib.fjr_stop_effort(self.model, self.controller, u)
        return self._array(u)

    def start(self, reference: Reference | None = None) -> None:
        """Start again at the next sample, with this reference or that of the last start."""
        self.lib.fjr_start(self.controller, self.ffi.NULL if reference is None else self._kept(reference))

    def apply(self, settings: Settings) -> None:
        """Replace the settings from the next sample on."""
        self.lib.fjr_apply(self.controller, settings_struct(self.library, settings, self.law))
        self.settings = settings

    def use(self, law: StaticLaw) -> None:
        """Replace the law by one with other gains. Raise GainsError if its effort is not finite; then it remains."""
        sampled = self._sampled.with_law(law) if isinstance(self._sampled, RobustLaw) else sampled_law(law)
        before, self._sampled = self._sampled, sampled
        try:
            gains = self._checked_gains(law, self.jets)
        except Exception:
            self._sampled = before
            raise
        self._model.use(sampled)
        damping = np.ascontiguousarray(law.hold_damping, dtype=float)
        self.lib.fjr_use_gains(self.controller, self._address(gains), self._address(damping))
        self.law, self._gains = law, gains  # until here a native loop reads the gains before

    def follow(self, reference: Reference, start: int | None = None) -> None:
        """Track a reference from the stamp `start` [ns] on, None: from the next sample."""
        self.lib.fjr_follow(self.controller, self._kept(reference), NEVER if start is None else start)

    def jets_at(self, stamp: int) -> Array | None:
        """Return the jets (5, n) of the active reference at a stamp [ns]; None before the first sample."""
        if self.controller.supervisor.reference.zero == NEVER:
            return None
        return self.active_jets(stamp)

    def active_jets(self, stamp: int) -> Array:
        """Return the jets (5, n) of the active reference at a stamp [ns]; before it begins, those at its time 0."""
        jets = self.ffi.new("double[]", self.jets.size)
        self.lib.fjr_jets_at(self.controller, stamp, jets)
        return self._array(jets).reshape(self.jets.shape)

    @property
    def end(self) -> float:
        """Stamp [ns] from which on the reference is constant; inf for never, or before the first sample."""
        reference = self.controller.supervisor.reference
        if reference.zero == NEVER:
            return np.inf
        end = self._end_of(reference.target or self.ffi.addressof(reference, "held"))
        return float(reference.zero + max(end, reference.segment.t1 if reference.joins else end) * 1e9)

    @property
    def memory(self) -> Array:
        """Controller state (m,) of the law at the last sample, a view."""
        return self._view(self.controller, "law.memory")[: len(self._sampled.memory)]

    def _end_of(self, reference: Any) -> float:
        return float(reference.end + reference.shift)

    def _kept(self, reference: Reference) -> Any:
        """Return a reference in C; those that C may still use are kept alive."""
        made, active = ReferenceStruct(self.ffi, reference), self.controller.supervisor.reference
        used = (active.target, active.pending, self.controller.start_reference)
        self._references = [each for each in self._references if each.pointer in used] + [made]
        return made.pointer

    def _law_failed(self) -> bool:
        try:
            raise_failure(self._sampled)
        except UserCodeError as error:
            self.law_failure = str(error)
            return True
        return False

    def _checked_gains(self, law: StaticLaw, jets: Array) -> Array:
        """Return the gains of the law; raise GainsError unless its effort is finite at 1 and at the measured state."""
        sampled, n = self._sampled, law.robot.n
        evaluate, values = NumericFunction(law_function(sampled)), sampled.gain_values
        state = self.measured[: 4 * n].copy()
        state = state if state.dot(state) < np.inf else np.zeros(4 * n)
        jets = jets if np.isfinite(jets).all() else np.zeros((JETS, n))
        rest = (sampled.memory, np.zeros(n), 0.0) if len(sampled.memory) else ()
        for point in (state,) if law.in_python else (np.ones(4 * n), state):  # its domain may be smaller
            with np.errstate(all="ignore"):
                u = evaluate(point[: 2 * n], point[2 * n :], jets, values, *rest)[0]
            raise_failure(sampled)
            if not u.dot(u) < np.inf:
                names = _GAIN_PARAMETERS[law.in_python, len(sampled.memory) > 0]
                raise GainsError(f"parameters {names} give an effort that is not finite; expected smaller gains")
        return np.ascontiguousarray(values, dtype=float)

    def _address(self, array: Array) -> Any:
        return self.ffi.cast("double *", array.ctypes.data)

    def _array(self, values: Any) -> Array:
        return np.frombuffer(self.ffi.buffer(values)).copy()

    def _view(self, struct: Any, path: str) -> Array:
        """Return the field of a structure as an array that shares its memory."""
        return np.frombuffer(self.ffi.buffer(self.ffi.addressof(struct[0], *path.split("."))))


_GAIN_PARAMETERS = {
    (False, False): "'gains.*'",
    (False, True): "'gains.*' and 'robust.*'",
    (True, False): "'law.options.*'",
    (True, True): "'gains.*' and 'robust.*'",
}
"""By (law in Python, robust action): the parameters of a law."""
