# SPDX-License-Identifier: Apache-2.0
"""The tracking controller without ROS: from a measured sample to the effort u(x, x, t) that is sent.

sample -> order of the stamps -> measured state -> wiring -> supervisor (reference, limits of the state) -> law or stop
policy -> bumpless transfer -> effort limits -> rate limits -> u
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fjr_core import Reference, TrajectoryError, VelocityObserver
from fjr_core.control.robust import Robust
from fjr_core.control.safety_settings import Settings
from fjr_core.control.static_law import StaticLaw
from fjr_core.numerics.checks import Array

from .effort_output import EffortOutput
from .events import ERROR, INFO, WARN, Journal, State
from .measured_state import MeasuredState, StateMeasurement
from .stamp_order import Order, Stamps
from .supervisor import Supervisor
from .wiring_monitor import WiringMonitor

if TYPE_CHECKING:
    from fjr_msgs_py.messages.joint_states import JointSample

NOT_FINITE = "efforts not finite"


@dataclass(slots=True)
class Command:
    """The command for a sample; its arrays are valid until the next command.

    u (n,) [N m]: effort to send, always finite and within its limits. jets (5, n): reference at the sample's stamp.
    V [J]: storage, nan where u is not the law's effort (a stop, a non-finite effort). velocity, position (2n,):
    dq_l, dq_m [rad/s] and q_l, q_m [rad] that the law was evaluated at. state: state of the tracker. restarted: True
    if the stamps jumped back and the reference starts again with this sample.
    """

    u: Array
    jets: Array
    V: float
    velocity: Array
    state: State
    restarted: bool
    position: Array


class Tracker:
    """Compute the command for each stamped sample.

    States. waiting: before the first sample. joining: transition from the measured state to the reference. tracking.
    stopped: a limit was violated, the start was refused, the wiring is wrong, or a law in Python failed; latched until
    resume() or start(). The stop policy (on_stop) then gives the effort, zero after a wiring fault.

    Samples. One that is older than the last, or an unconfirmed jump, gets no command (None); one with a repeated stamp
    is evaluated again. A jump back starts the reference again, as start() does, but a stop stays latched. After a
    jump forward or a silence of state_timeout tracking recovers without a step of u (see Stamps and Supervisor).
    After an observer reset, velocity estimates are used only from the sample OBSERVED on; until then the last effort is
    held, or at a start the stop policy's effort is sent.

    Efforts. A non-finite effort is replaced by the stop policy's, and the sample changes no other state: pending
    transitions wait for the next sample. Every effort for a sample passes the effort and the rate limits; the single
    efforts of silence() and stop_effort() pass the effort limits only.
    With robust action the controller state advances once per sample for which the law acts, by the effort that was
    sent; it is reset at every gap and stop, and kept when the gains change.

    events: the newest events, to be taken out by the caller. counters, with stable names:
    "states older than the last", "states repeated", "jumps doubted", "reference restarts", "silences",
    "forward jumps", "observer restarts", "recoveries",
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
    ) -> None:
        """Build the parts. Raise GainsError if the law's effort is not finite."""
        journal = Journal()
        self.events, self.counters, self._journal = journal.events, journal.counters, journal
        self._state = MeasuredState(law.robot.n)
        self._stamps = Stamps(settings.state_timeout, simulated_time)
        self._measurement = StateMeasurement(self._state, observer)
        checks = settings.wiring_check and observer is None
        self._wiring = WiringMonitor(law.robot, settings.joints, self._state, enabled=checks)
        self._reference, self._supervisor = reference, Supervisor(reference, settings, self._state, journal)
        self._output = EffortOutput(law, robust, settings, self._state, journal)
        self._stopped = 0  # ns

    @property
    def state(self) -> State:
        """Return the state of the tracker."""
        if self._supervisor.reason:
            return State.STOPPED
        if self._stamps.last is None:
            return State.WAITING
        return State.JOINING if self._supervisor.joining else State.TRACKING

    @property
    def reason(self) -> str:
        """Return the reason of the stop, one sentence; empty if not stopped."""
        return self._supervisor.reason

    @property
    def last_stamp(self) -> int | None:
        """Return the stamp [ns] of the last sample with an effort of law or stop; None before the first."""
        return self._stamps.last

    @property
    def end(self) -> float:
        """Return the stamp [ns] from which on the reference is constant; inf for never, or before the first sample."""
        return self._supervisor.reference.end

    @property
    def bound_start(self) -> int | None:
        """Return the stamp [ns] at which the bound on V starts; None unless the effort sent is the law's own."""
        return self._supervisor.bound_start

    @property
    def seconds(self) -> dict[str, float]:
        """Return times by the stamps [s]: "in saturation", "in saturation: <joint>", "stopped"."""
        return {**self._output.limits.seconds, "stopped": self._stopped * 1e-9}

    def warm_up(self) -> None:
        """Evaluate everything once, so that the first sample takes no longer than any other."""
        n = len(self._state.q_l)
        self._supervisor.reference.jets(0)
        self._output.policy.moving(np.zeros(n), np.zeros(n))
        self._measurement.warm_up()

    def start(self, reference: Reference | None = None) -> None:
        """Start again: the next sample is the first, and the rules of a start apply to it.

        reference: to be tracked, with time 0 at that sample; None: that of the last start. Pending requests and a stop
        are discarded. Law, settings, events and counters remain.
        """
        self._reference = self._reference if reference is None else reference
        self._stamps.reset()
        self._supervisor = Supervisor(self._reference, self._supervisor.settings, self._state, self._journal)
        self._recheck_wiring()

    def command(self, sample: JointSample, arrival: int) -> Command | None:
        """Return the command for a sample that arrived at `arrival` [ns, steady clock]; None: send nothing.

        Raise StateError if the sample has no velocities and there is no observer.
        """
        stamp = sample.stamp
        order = self._stamps.classify(stamp, arrival)
        if order is Order.OLDER or order is Order.DOUBTED:
            self._journal.count("states older than the last" if order is Order.OLDER else "jumps doubted")
            return None
        if not self._measurement.update(sample, order, self._output.limits.left):
            return self._without_effort(stamp)
        self._check_wiring(order, stamp)
        supervisor, settling = self._supervisor, self._measurement.settling(order)
        if not supervisor.continues(order, stamp, settling):
            try:
                supervisor = supervisor.advanced(order, stamp, settling)
            except TrajectoryError:  # there is no transition from a state that far away
                return self._without_effort(stamp)
        jets, last = supervisor.jets(stamp), self._stamps.last
        u, V = self._output.select(supervisor, jets, order, stamp, 0 if last is None else stamp - last)
        if not u.dot(u) < np.inf:
            return self._without_effort(stamp)
        if supervisor is not self._supervisor:
            self._supervisor = supervisor.committed(self._journal)
        self._output.policy.remember(self._state.q_l)
        u = self._output.send(self._supervisor, u, V, stamp)
        self._output.law.accept()
        self._wiring.sent(u, order)
        self._accept(stamp, arrival)
        return self._command(u, jets, V, order is Order.BACK)

    def silence(self, now: int) -> Array | None:
        """Return the stop effort (n,) once if nothing came for state_timeout; None otherwise.

        now [ns]: of the arrival clock; with simulated time, of the clock of the stamps.
        """
        if not self._stamps.silent(now):
            return None
        seconds = self._stamps.timeout * 1e-9
        self._journal.report(WARN, "silences", f"no state for more than {seconds:g} s: the stop effort is sent")
        return self.stop_effort()

    def stop_effort(self) -> Array:
        """Return the stop policy's effort (n,) without a sample, finite and within the limits; it counts as sent.

        zero: zeros. gravity_hold: B_m^-1 grad P_l(q_l) at the last valid sample, zeros before the first.
        """
        return self._output.send_without_sample(self._supervisor)

    def apply(self, settings: Settings) -> None:
        """Replace the settings from the next sample on; a stop and transitions in progress remain."""
        self._stamps.set_timeout(settings.state_timeout)
        self._supervisor.apply(settings)
        self._output.apply(settings)
        self._journal.report(INFO, "settings changed", "limits and stop policy changed")

    def use(self, law: StaticLaw) -> None:
        """Replace the law (other gains) from the next sample on; the certificate starts again.

        Raise GainsError if its effort is not finite; then the law remains.
        """
        self._output.use(law)
        self._supervisor.bound_start = None
        self._journal.report(INFO, "gains changed", "gains changed: the certificate starts again")

    def jets_at(self, stamp: int) -> Array | None:
        """Return the jets (5, n) of the active reference at `stamp` [ns]; None before the first sample.

        The next trajectory starts from them: Spline(..., start=tracker.jets_at(start)).
        """
        return self._supervisor.reference.jets(stamp) if self._supervisor.reference.begun else None

    def follow(self, reference: Reference, start: int | None = None) -> None:
        """Track a reference whose time 0 is at the stamp `start` [ns]; None: at the next sample.

        Until `start` the active reference continues; a law that predicts the state takes the new one over `lead`
        earlier. If the jets of the new one at time 0 equal those of the active one at `start` (to 1e-6), the switch is
        immediate and without a step of u. Otherwise a transition over recovery.join_time leads to it (0: at once).
        Before the first sample it replaces the reference, with time 0 at that sample. It replaces a pending reference
        and a pending hold. While stopped it is kept until resume().
        """
        self._supervisor.follow(reference, start)

    def hold(self) -> None:
        """Come to a standstill from the next sample on, C^4 from the active reference.

        The speed dq is reduced to 0 within T = max |dq| / hold.deceleration (0.2 s to 2 s), over the distance dq T / 2.
        While stopped, or before the first sample, hold the link positions of the next sample.
        """
        self._supervisor.hold()

    def resume(self) -> None:
        """End a stop: track again from the next sample on, as after a recovery; without a stop do nothing.

        If recovery.join_time is 0 a refused start is checked again. A sample that violates a limit stops again.
        """
        if self._supervisor.reason:
            self._recheck_wiring()
        self._supervisor.resume()

    def _recheck_wiring(self) -> None:
        """Check the wiring from the next sample on, and enable the stop policy again."""
        self._output.policy.released = False
        self._wiring.restart()

    def _check_wiring(self, order: Order, stamp: int) -> None:
        """Stop without any effort if the samples up to this one show a wiring fault."""
        fault = self._wiring.check(order, stamp)
        if fault is not None:
            self._output.policy.released = True
            self._supervisor.refuse_wiring(*fault)

    def _accept(self, stamp: int, arrival: int) -> None:
        elapsed = self._stamps.accept(stamp, arrival)
        if self._supervisor.reason:
            self._stopped += elapsed
        self._journal.episodes.discard(NOT_FINITE)

    def _without_effort(self, stamp: int) -> Command:
        """Return the stop policy's effort for a sample that has no finite effort."""
        sentence = "the effort is not finite for a state: the stop effort is sent instead"
        self._journal.report_episode(ERROR, NOT_FINITE, sentence)
        self._measurement.reset()
        self._output.law.reset()
        u = self._output.send(self._supervisor, self._output.policy.standing(), math.nan, stamp)
        return self._command(u, self._supervisor.reference.jets(stamp), math.nan, False)

    def _command(self, u: Array, jets: Array, V: float, restarted: bool) -> Command:
        return Command(u, jets, V, self._state.velocity, self.state, restarted, self._state.position)
