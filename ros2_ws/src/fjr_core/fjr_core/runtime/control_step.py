# SPDX-License-Identifier: Apache-2.0
"""The tracking controller without ROS: one controller in memory of C (step.h), and its events as sentences."""

from __future__ import annotations

import re
from collections import Counter, deque
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import GainsError, StateError, UserCodeError
from ..law.interfaces import StaticLaw
from ..model.joints import JointSample
from ..motions.reference import JETS, Reference
from ..numerics.checks import Array
from ..numerics.jit import record_type
from ..numerics.symbolic import NumericFunction
from ..robust.law import RobustLaw, sampled_law
from ..robust.options import Robust
from .events import NEVER, STATES, Event, Journal, State
from .library import Model, model_functions, settings_struct, step_library
from .measurement_model import Measurement
from .reference import ReferenceStruct
from .safety_settings import Settings
from .velocity_observer import VelocityObserver


@dataclass(slots=True)
class Command:
    """The command for a sample.

    u (n,) [N m]: effort to send, always finite and within its limits. jets (5, n): reference at the sample's stamp.
    V [J]: storage, nan where u is not the law's effort (a stop, a non-finite effort). velocity, position (2n,):
    dq_l, dq_m [rad/s] and q_l, q_m [rad] that the law was evaluated at. state: of the controller. restarted: True if
    the stamps jumped back and the reference starts again with this sample. bound_start: stamp [ns] at which the bound
    on V starts; None unless u is the law's own.
    """

    u: Array
    jets: Array
    V: float
    velocity: Array
    state: State
    restarted: bool
    position: Array
    bound_start: int | None = None

    @classmethod
    def of(cls, found: Any) -> Command:
        """Return a record of struct fjr_command as a command, which shares its memory."""
        u, V, state, restarted = found["u"], float(found["V"]), STATES[found["state"]], bool(found["restarted"])
        jets, start = found["jets"].reshape(JETS, len(u)), _stamp(int(found["bound_start"]))
        return cls(u, jets, V, found["velocity"], state, restarted, found["position"], start)


class ControlStep:
    """Compute the command for each stamped sample, by the functions of step.h.

    States. waiting: before the first sample. joining: transition from the measured state to the reference. tracking.
    stopped: a limit was violated, the start was refused, the wiring is wrong, or a law in Python failed; latched until
    resume() or start(). The stop policy (on_stop) then gives the effort, zero after a wiring fault.

    Samples. One that is older than the last, or an unconfirmed jump, gets no command; one with a repeated stamp is
    evaluated again. After a pause of the arrivals a sample that waited gets none either while newer ones follow. A jump
    back starts the reference of the last start again, as start() does, or holds the position after a requested one; a
    stop stays latched. After a jump forward or a gap tracking recovers without a step of u (stamps.c, supervisor.c).
    After an observer reset, velocity estimates are used only from the sample OBSERVED on; until then the last effort is
    held, or at a start the stop policy's effort is sent.

    Efforts. A non-finite effort is replaced by the stop policy's, and the sample changes no other state: pending
    transitions wait for the next sample. Every effort for a sample passes the effort and the rate limits; the single
    efforts of silence() and stop_effort() pass the effort limits only.
    With robust action the controller state advances once per sample for which the law acts, by the effort that was
    sent; it is reset at every gap and stop, and kept when the gains change.

    Memory. controller, model, command_struct: pointers to the structures; lib, ffi: functions and types of cffi. u
    (n,), jets (5, n), position and velocity (2n,): views of the last command. A command loop that runs the controller
    on its thread sets `owner`: the controller here is then a copy, and changes go through the owner.
    """

    owner: Any = None
    """The loop that runs the controller: change(), copy() and between_samples(); None: this process calls the step."""

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
        """Build the controller; compile: compile the functions of a law that is not compiled.

        Raise GainsError if the law's effort is not finite, and CompilerError without a C compiler.
        """
        n, self.law, self.settings = law.robot.n, law, settings
        self._sampled = sampled_law(law, robust)
        self.library = step_library(n, len(self._sampled.memory))
        self.ffi, self.lib = ffi, lib = self.library.ffi, self.library.lib
        self.law_failure = ""
        functions = model_functions(self._sampled, observer, compile)
        self._model = Model(self.library, self._sampled, functions, observer, measurement, simulated, self._law_failed)
        self.model = self._model.pointer
        self.controller, self.command_struct = ffi.new("struct fjr_controller *"), ffi.new("struct fjr_command *")
        self._command_type = record_type(ffi, ffi.typeof("struct fjr_command"))
        self._sample = ffi.new("struct fjr_sample *")
        self._link, self._motor = self._view(self._sample, "link"), self._view(self._sample, "motor")
        self._dq_l, self._dq_m = self._view(self._sample, "velocity").reshape(2, n)
        self.u, self.position, self.velocity = (
            self._view(self.command_struct, name) for name in ("u", "position", "velocity")
        )
        self.jets = self._view(self.command_struct, "jets").reshape(JETS, n)
        self.measured = self._view(self.controller, "measured.values")
        self._gains = self._checked_gains(law, np.zeros((JETS, n)))
        self._references = [ReferenceStruct(ffi, reference)]
        written = settings_struct(self.library, settings, law)
        lib.fjr_init(self.controller, written, self._address(self._gains), self._references[0].pointer)
        self._journal = Journal(self)

    # Commands.

    def step(self, stamp: int, arrival: int, q_l: Array, q_m: Array, dq_l: Array | None, dq_m: Array | None) -> bool:
        """Compute the command for a sample into u, jets, position and velocity; return False if nothing is to be sent.

        stamp, arrival [ns]. q_l, q_m, dq_l, dq_m (n,): as of a JointSample. Raise StateError if there are neither
        velocities nor an observer.
        """
        self._sample.stamp = stamp
        self._link[:], self._motor[:] = q_l, q_m
        if not self.model.observer:
            if dq_l is None or dq_m is None:
                raise StateError("the sample has no velocities; expected them, or an observer")
            self._dq_l[:], self._dq_m[:] = dq_l, dq_m
        answered = bool(self.lib.fjr_step(self.model, self.controller, self._sample, arrival, self.command_struct))
        self.raise_failure()
        return answered

    def command(self, sample: JointSample, arrival: int) -> Command | None:
        """Return the command for a sample that arrived at `arrival` [ns, steady clock]; None: send nothing."""
        answered = self.step(sample.stamp, arrival, sample.q_l, sample.q_m, sample.dq_l, sample.dq_m)
        self._journal.update()
        copied = bytes(self.ffi.buffer(self.command_struct))
        return Command.of(np.frombuffer(copied, self._command_type)[0]) if answered else None

    def check_wiring(self) -> None:
        """Check the wiring with the last sample, after its command was sent; else the next step does it first.

        A fault stops at the next sample.
        """
        self.lib.fjr_check_wiring(self.model, self.controller)

    def silence(self, now: int) -> Array | None:
        """Return the stop effort (n,) once if nothing came for state_timeout, see fjr_silence; None otherwise.

        now [ns]: of the arrival clock; with simulated time, of the clock of the stamps.
        """
        u = self.ffi.new("double[]", len(self.u))
        silent = self.lib.fjr_silence(self.model, self.controller, now, u)
        self._journal.update()
        return self._array(u) if silent else None

    def stop_effort(self) -> Array:
        """Return the stop policy's effort (n,) without a sample, finite and within the limits; it counts as sent.

        zero: zeros. gravity_hold: B_m^-1 grad P_l(q_l) at the last valid sample, zeros before the first.
        """
        u = self.ffi.new("double[]", len(self.u))
        self.lib.fjr_stop_effort(self.model, self.controller, u)
        return self._array(u)

    # Changes, which the owner of the controller carries out between two samples.

    def start(self, reference: Reference | None = None) -> None:
        """Start again: the next sample is the first, and the rules of a start apply to it.

        reference: to be tracked, with time 0 at that sample; None: that of the last start. Pending requests and a stop
        are discarded. Law, settings, events and counters remain.
        """
        self._change("start", self.ffi.NULL if reference is None else self._kept(reference))

    def apply(self, settings: Settings) -> None:
        """Replace the settings from the next sample on; a stop and transitions in progress remain."""
        self._change("apply", settings_struct(self.library, settings, self.law))
        self.settings = settings

    def use(self, law: StaticLaw) -> None:
        """Replace the law by one with other gains from the next sample on; the certificate starts again.

        Raise GainsError if its effort is not finite; then the law remains.
        """
        sampled = self._sampled.with_law(law) if isinstance(self._sampled, RobustLaw) else law
        before, self._sampled = self._sampled, sampled
        try:
            gains = self._checked_gains(law, self.jets)
        except Exception:
            self._sampled = before
            raise
        self._model.use(sampled)
        damping = np.ascontiguousarray(law.hold_damping, dtype=float)
        self._change("use_gains", self._address(gains), self._address(damping))
        self.law, self._gains = law, gains  # until here a native loop reads the gains before

    def follow(self, reference: Reference, start: int | None = None) -> None:
        """Track a reference whose time 0 is at the stamp `start` [ns]; None: at the next sample.

        Until `start` the active reference continues; a law that predicts the state takes the new one over `lead`
        earlier. If the jets of the new one at time 0 equal those of the active one at `start` (to 1e-6), the switch is
        immediate and without a step of u. Otherwise a transition of recovery.join_time or longer leads to it (0: at
        once).
        Before the first sample it replaces the reference, with time 0 at that sample. It replaces a pending reference
        and a pending hold. While stopped it is kept until resume().
        """
        self._change("follow", self._kept(reference), time=NEVER if start is None else start)
        self._journal.followed.append(re.sub(r"(?<=[a-z])(?=[A-Z])", " ", type(reference).__name__).lower())

    def hold(self) -> None:
        """Come to a standstill from the next sample on, C^4 from the active reference.

        The speed dq is reduced to 0 within T = max |dq| / hold.deceleration (0.2 s to 2 s), over the distance dq T / 2.
        While stopped, or before the first sample, hold the link positions of the next sample.
        """
        self._change("hold")

    def resume(self) -> None:
        """End a stop: track again from the next sample on, as after a recovery; without a stop do nothing.

        If recovery.join_time is 0 a refused start is checked again. A sample that violates a limit stops again.
        """
        self._change("resume")

    def between_samples(self) -> AbstractContextManager[None]:
        """Return a context in which no sample is answered; with simulated time the plant waits meanwhile."""
        found: AbstractContextManager[None] = nullcontext() if self.owner is None else self.owner.between_samples()
        return found

    # State, events and counters.

    @property
    def in_c(self) -> bool:
        """True if a step calls no Python."""
        return self._model.in_c

    @property
    def events(self) -> deque[Event]:
        """Return the newest unread events, to be taken out by the caller."""
        self._journal.update()
        return self._journal.events

    @property
    def counters(self) -> Counter[str]:
        """Return the counters by the names of KINDS and "efforts saturated: <joint>"; those that are 0 are absent."""
        return self._journal.counters

    @property
    def seconds(self) -> dict[str, float]:
        """Return times by the stamps [s]: "in saturation", "in saturation: <joint>", "stopped"."""
        limits, joints = self.controller.limits, self.settings.joints
        each = {f"in saturation: {joint}": s for joint, s in zip(joints, limits.seconds, strict=True)}
        return {"in saturation": limits.seconds_any, **each, "stopped": self.controller.stopped_time * 1e-9}

    @property
    def state(self) -> State:
        """Return the state of the controller."""
        self.refresh()
        return STATES[self.lib.fjr_state_of(self.controller)]

    @property
    def reason(self) -> str:
        """Return the reason of the stop, one sentence; empty if not stopped."""
        self._journal.update()
        return self._journal.reason if self.controller.supervisor.stopped else ""

    def outside(self) -> str:
        """Return which limit the last state violates, one clause, "" if none; a resume would stop at once."""
        self.refresh()
        return self._journal.outside()

    @property
    def last_stamp(self) -> int | None:
        """Return the stamp [ns] of the last sample with an effort of law or stop; None before the first."""
        self.refresh()
        return _stamp(self.controller.stamps.last)

    @property
    def bound_start(self) -> int | None:
        """Return the stamp [ns] at which the bound on V starts; None unless the effort sent is the law's own."""
        return _stamp(self.controller.supervisor.bound_start)

    def jets_at(self, stamp: int) -> Array | None:
        """Return the jets (5, n) of the active reference at `stamp` [ns]; None before the first sample.

        The next trajectory starts from them: Spline(..., start=step.jets_at(start)).
        """
        self.refresh()
        if self.controller.supervisor.reference.zero == NEVER:
            return None
        jets = self.ffi.new("double[]", self.jets.size)
        self.lib.fjr_jets_at(self.controller, stamp, jets)
        return self._array(jets).reshape(self.jets.shape)

    @property
    def memory(self) -> Array:
        """Return the controller state (m,) of the law at the last sample, a view."""
        return self._view(self.controller, "law.memory")[: len(self._sampled.memory)]

    def refresh(self) -> None:
        """Bring the controller up to date if a command loop runs it."""
        if self.owner is not None:
            self.owner.copy()

    def raise_failure(self) -> None:
        """Raise the first error of a reference in Python since the last call, if there is one."""
        for reference in self._references:
            reference.raise_failure()

    def _change(self, what: str, *pointers: Any, time: int | None = None) -> None:
        """Call fjr_WHAT with the controller, these pointers and the time, or let the owner do it."""
        if self.owner is None:
            arguments = pointers if time is None else (*pointers, time)
            getattr(self.lib, f"fjr_{what}")(self.controller, *arguments)
        else:
            self.owner.change(what, *pointers, time=time or 0)

    def _kept(self, reference: Reference) -> Any:
        """Return a reference in C; those that C may still use are kept alive."""
        made, active = ReferenceStruct(self.ffi, reference), self.controller.supervisor.reference
        used = (active.target, active.pending, self.controller.start_reference)
        self._references = [each for each in self._references if each.pointer in used] + [made]
        return made.pointer

    def _law_failed(self) -> bool:
        try:
            self._sampled.raise_failure()
        except UserCodeError as error:
            self.law_failure = str(error)
            return True
        return False

    def _checked_gains(self, law: StaticLaw, jets: Array) -> Array:
        """Return the gains of the law; raise GainsError unless its effort is finite at 1 and at the measured state."""
        sampled, n = self._sampled, law.robot.n
        evaluate, values = NumericFunction(sampled.function), sampled.gain_values
        state = self.measured[: 4 * n].copy()
        state = state if state.dot(state) < np.inf else np.zeros(4 * n)
        jets = jets if np.isfinite(jets).all() else np.zeros((JETS, n))
        rest = (sampled.memory, np.zeros(n), 0.0) if len(sampled.memory) else ()
        for point in (state,) if law.in_python else (np.ones(4 * n), state):  # its domain may be smaller
            with np.errstate(all="ignore"):
                u = evaluate(point[: 2 * n], point[2 * n :], jets, values, *rest)[0]
            sampled.raise_failure()
            if not u.dot(u) < np.inf:
                robust = "'gains.*' and 'robust.*'" if len(sampled.memory) else ""
                names = robust or ("'law.options.*'" if law.in_python else "'gains.*'")
                raise GainsError(f"parameters {names} give an effort that is not finite; expected smaller gains")
        return np.ascontiguousarray(values, dtype=float)

    def _address(self, array: Array) -> Any:
        return self.ffi.cast("double *", array.ctypes.data)

    def _array(self, values: Any) -> Array:
        return np.frombuffer(self.ffi.buffer(values)).copy()

    def _view(self, struct: Any, path: str) -> Array:
        """Return the field of a structure as an array that shares its memory."""
        return np.frombuffer(self.ffi.buffer(self.ffi.addressof(struct[0], *path.split("."))))


def _stamp(value: int) -> int | None:
    return None if value == NEVER else value
