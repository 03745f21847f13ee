# SPDX-License-Identifier: Apache-2.0
"""The tracking controller without ROS: the control step of step.h with its events as sentences."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from typing import TYPE_CHECKING

from fjr_core import Measurement, Reference, VelocityObserver
from fjr_core.law.interfaces import StaticLaw
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import Robust
from fjr_core.runtime.control_step import NEVER, ControlStep
from fjr_core.runtime.safety_settings import Settings

from .events import STATES, Event, Journal, State

if TYPE_CHECKING:
    from fjr_msgs_py.messages.joint_states import JointSample


@dataclass(slots=True)
class Command:
    """The command for a sample; its arrays are valid until the next command.

    u (n,) [N m]: effort to send, always finite and within its limits. jets (5, n): reference at the sample's stamp.
    V [J]: storage, nan where u is not the law's effort (a stop, a non-finite effort). velocity, position (2n,):
    dq_l, dq_m [rad/s] and q_l, q_m [rad] that the law was evaluated at. state: state of the tracker. restarted: True
    if the stamps jumped back and the reference starts again with this sample. bound_start: stamp [ns] at which the
    bound on V starts; None unless u is the law's own.
    """

    u: Array
    jets: Array
    V: float
    velocity: Array
    state: State
    restarted: bool
    position: Array
    bound_start: int | None = None


class Tracker:
    """Compute the command for each stamped sample.

    States. waiting: before the first sample. joining: transition from the measured state to the reference. tracking.
    stopped: a limit was violated, the start was refused, the wiring is wrong, or a law in Python failed; latched until
    resume() or start(). The stop policy (on_stop) then gives the effort, zero after a wiring fault.

    Samples. One that is older than the last, or an unconfirmed jump, gets no command (None); one with a repeated stamp
    is evaluated again. After a pause of the arrivals a sample that waited gets none either while newer ones follow. A
    jump back starts the reference again, as start() does, but a stop stays latched. After a jump forward or a gap
    tracking recovers without a step of u (see stamps.c and supervisor.c).
    After an observer reset, velocity estimates are used only from the sample OBSERVED on; until then the last effort is
    held, or at a start the stop policy's effort is sent.

    Efforts. A non-finite effort is replaced by the stop policy's, and the sample changes no other state: pending
    transitions wait for the next sample. Every effort for a sample passes the effort and the rate limits; the single
    efforts of silence() and stop_effort() pass the effort limits only.
    With robust action the controller state advances once per sample for which the law acts, by the effort that was
    sent; it is reset at every gap and stop, and kept when the gains change.

    counters, with stable names:
    "states older than the last", "states stale", "states repeated", "jumps doubted", "reference restarts",
    "silences", "forward jumps", "observer restarts", "recoveries",
    "starts refused", "stops" and of these "stops: wiring", "stops: link position", "stops: motor position",
    "stops: link velocity", "stops: motor velocity", "stops: deflection", "stops: tracking error",
    "stops: law"; "resumes",
    "efforts not finite",
    "efforts saturated" and of these "efforts saturated: <joint>", "efforts rate limited", "gains changed",
    "settings changed", "references changed", "holds".
    """

    def __init__(
        self,
        law: StaticLaw,
        reference: Reference,
        settings: Settings,
        observer: VelocityObserver | None = None,
        simulated_time: bool = False,
        robust: Robust | None = None,
        measurement: Measurement | None = None,
    ) -> None:
        """Build the control step. Raise GainsError if the law's effort is not finite, and CompilerError."""
        self.step = ControlStep(law, reference, settings, observer, simulated_time, robust, measurement)
        self._controller, self._journal = self.step.controller, Journal(self.step)
        self.refresh: Callable[[], None] | None = None
        """Called before the controller is read, if it belongs to a native loop."""
        self.between_samples: Callable[[], AbstractContextManager[None]] = nullcontext
        """Context in which no sample is answered; with simulated time the plant waits meanwhile."""

    @property
    def events(self) -> deque[Event]:
        """Return the newest unread events, to be taken out by the caller."""
        return self._journal.events

    @property
    def counters(self) -> Counter[str]:
        """Return the counters by their names; those that are 0 are absent."""
        return self._journal.counters

    @property
    def state(self) -> State:
        """Return the state of the tracker."""
        self._refresh()
        return STATES[self.step.lib.fjr_state_of(self._controller)]

    @property
    def reason(self) -> str:
        """Return the reason of the stop, one sentence; empty if not stopped."""
        return self._journal.reason if self._controller.supervisor.stopped else ""

    @property
    def last_stamp(self) -> int | None:
        """Return the stamp [ns] of the last sample with an effort of law or stop; None before the first."""
        self._refresh()
        return _stamp(self._controller.stamps.last)

    @property
    def end(self) -> float:
        """Return the stamp [ns] from which on the reference is constant; inf for never, or before the first sample."""
        self._refresh()
        return self.step.end

    @property
    def bound_start(self) -> int | None:
        """Return the stamp [ns] at which the bound on V starts; None unless the effort sent is the law's own."""
        return _stamp(self._controller.supervisor.bound_start)

    @property
    def seconds(self) -> dict[str, float]:
        """Return times by the stamps [s]: "in saturation", "in saturation: <joint>", "stopped"."""
        limits, joints = self._controller.limits, self.step.settings.joints
        each = {f"in saturation: {joint}": s for joint, s in zip(joints, limits.seconds, strict=True)}
        return {"in saturation": limits.seconds_any, **each, "stopped": self._controller.stopped_time * 1e-9}

    def start(self, reference: Reference | None = None) -> None:
        """Start again: the next sample is the first, and the rules of a start apply to it.

        reference: to be tracked, with time 0 at that sample; None: that of the last start. Pending requests and a stop
        are discarded. Law, settings, events and counters remain.
        """
        self.step.start(reference)

    def command(self, sample: JointSample, arrival: int) -> Command | None:
        """Return the command for a sample that arrived at `arrival` [ns, steady clock]; None: send nothing.

        Raise StateError if the sample has no velocities and there is no observer.
        """
        step = self.step
        answered = step.step(sample.stamp, arrival, sample.q_l, sample.q_m, sample.dq_l, sample.dq_m)
        self._journal.update()
        if not answered:
            return None
        c = step.command
        state, bound_start = STATES[c.state], _stamp(c.bound_start)
        return Command(
            step.u.copy(), step.jets.copy(), c.V, step.velocity, state, bool(c.restarted), step.position, bound_start
        )

    def check_wiring(self) -> None:
        """Check the wiring with the last sample, after its command was sent; a fault stops at the next sample."""
        self.step.check_wiring()

    def silence(self, now: int) -> Array | None:
        """Return the stop effort (n,) once if nothing came for state_timeout; None otherwise.

        now [ns]: of the arrival clock; with simulated time, of the clock of the stamps.
        """
        u = self.step.silence(now)
        self._journal.update()
        return u

    def stop_effort(self) -> Array:
        """Return the stop policy's effort (n,) without a sample, finite and within the limits; it counts as sent.

        zero: zeros. gravity_hold: B_m^-1 grad P_l(q_l) at the last valid sample, zeros before the first.
        """
        return self.step.stop_effort()

    def apply(self, settings: Settings) -> None:
        """Replace the settings from the next sample on; a stop and transitions in progress remain."""
        self.step.apply(settings)
        self._journal.update()

    def use(self, law: StaticLaw) -> None:
        """Replace the law (other gains) from the next sample on; the certificate starts again.

        Raise GainsError if its effort is not finite; then the law remains.
        """
        self.step.use(law)
        self._journal.update()

    def jets_at(self, stamp: int) -> Array | None:
        """Return the jets (5, n) of the active reference at `stamp` [ns]; None before the first sample.

        The next trajectory starts from them: Spline(..., start=tracker.jets_at(start)).
        """
        self._refresh()
        return self.step.jets_at(stamp)

    def follow(self, reference: Reference, start: int | None = None) -> None:
        """Track a reference whose time 0 is at the stamp `start` [ns]; None: at the next sample.

        Until `start` the active reference continues; a law that predicts the state takes the new one over `lead`
        earlier. If the jets of the new one at time 0 equal those of the active one at `start` (to 1e-6), the switch is
        immediate and without a step of u. Otherwise a transition of recovery.join_time or longer leads to it (0: at
        once).
        Before the first sample it replaces the reference, with time 0 at that sample. It replaces a pending reference
        and a pending hold. While stopped it is kept until resume().
        """
        self.step.follow(reference, start)
        self._journal.followed.append(type(reference).__name__)
        self._journal.update()

    def hold(self) -> None:
        """Come to a standstill from the next sample on, C^4 from the active reference.

        The speed dq is reduced to 0 within T = max |dq| / hold.deceleration (0.2 s to 2 s), over the distance dq T / 2.
        While stopped, or before the first sample, hold the link positions of the next sample.
        """
        self.step.lib.fjr_hold(self._controller)
        self._journal.update()

    def resume(self) -> None:
        """End a stop: track again from the next sample on, as after a recovery; without a stop do nothing.

        If recovery.join_time is 0 a refused start is checked again. A sample that violates a limit stops again.
        """
        self._refresh()
        self._journal.update()
        if self._controller.supervisor.stopped:
            self.step.lib.fjr_resume(self._controller)

    def outside(self) -> str:
        """Return which limit the last state violates, one clause, "" if none; a resume would stop at once."""
        self._refresh()
        return self._journal.outside()

    def read_events(self) -> None:
        """Read the events of a controller that a native loop runs."""
        self._journal.update()

    def _refresh(self) -> None:
        if self.refresh is not None:
            self.refresh()


def _stamp(value: int) -> int | None:
    return None if value == NEVER else value
