# SPDX-License-Identifier: Apache-2.0
"""The supervisor: a state machine that starts, recovers, holds and stops tracking."""

from __future__ import annotations

import math
from copy import copy

import numpy as np

from fjr_core import Reference
from fjr_core.control.safety_settings import Settings
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.point_to_point import standing

from .active_reference import ActiveReference
from .bumpless_transfer import BumplessTransfer
from .events import ERROR, INFO, STARTS_REFUSED, STOPS, WARN, Journal
from .measured_state import MeasuredState
from .stamp_order import Order
from .state_limits import StateLimits

BLEND = 0.05  # of the transition time: a longer blend has a larger error, and no smaller step of u


class Supervisor:
    """The active reference, the bumpless transfer and the stop, advanced sample by sample.

    Start: ramp from the stop policy's effort over start.ramp_time; transition from the measured state over
    start.join_time, or without one refuse the start if |q_l - q_ld| exceeds limits.start_error.
    Recovery (after a gap of the samples, or resume()): transition of the reference from the measured state over
    recovery.join_time, and blend of the effort over BLEND of that time. The clock of the reference continues.
    Stop: at a violated limit, or where a law in Python fails, latched until resume(). Outside the limits nothing is
    started or resumed.

    reason: why tracking is stopped, one sentence; empty otherwise. settling: samples left before the velocities of an
    observer that was reset are used; until then their limits and that of the tracking error are not checked. starting:
    tracking has not begun on this time line. bound_start: stamp t0 [ns] since which the law alone acts, so that
    V(t) <= V(t0) exp(-2 beta (t - t0)); None if the last effort was not the law's own, or the law has changed.
    """

    def __init__(self, reference: Reference, settings: Settings, state: MeasuredState, journal: Journal) -> None:
        self.settings, self.reference = settings, ActiveReference(reference)
        self.transfer = BumplessTransfer()
        self.bound_start: int | None = None
        self.reason, self.settling, self.starting = "", 0, True
        self._state, self._limits, self._journal = state, StateLimits(settings, state), journal
        self._resuming = self._holding = self._joining = False

    @property
    def joining(self) -> bool:
        """True during a transition of the reference, a transfer of the effort, or while velocities settle."""
        return self.transfer.active or self.settling > 0 or self._joining

    def apply(self, settings: Settings) -> None:
        """Replace the settings; a stop and transitions in progress remain."""
        self.settings = settings
        self._limits.apply(settings)

    def follow(self, reference: Reference, start: int | None) -> None:
        """Request a reference; see Tracker.follow."""
        self._holding = False
        self.reference.replace(reference, start)
        self._journal.report(INFO, "references changed", f"another reference: {type(reference).__name__}")

    def hold(self) -> None:
        """Request a standstill; see Tracker.hold."""
        self._holding = True
        self.reference.drop()
        self._journal.report(INFO, "holds", "hold: the motion comes to a standstill")

    def resume(self) -> None:
        """Request the end of a stop; see Tracker.resume."""
        self._resuming = bool(self.reason)

    def refuse_wiring(self, sentence: str, joint: str) -> None:
        """Stop because of a wiring fault, which the sentence describes."""
        self._journal.count("stops: wiring")
        self._stop("stops", f"stopped: {sentence}", joint)

    def refuse_law(self, sentence: str) -> None:
        """Stop because a law in Python failed, which the sentence describes."""
        self._journal.count("stops: law")
        self._stop(STOPS, f"stopped: {sentence}")

    def continues(self, order: Order, stamp: int, settling: int) -> bool:
        """Return True if this sample triggers no state transition."""
        requested = self._resuming or self._holding or self.reference.is_due(stamp)
        return order is Order.NEXT and not (settling or self.settling or requested)

    def advanced(self, order: Order, stamp: int, settling: int) -> Supervisor:
        """Return a copy of the supervisor after the transitions triggered by this sample; self is unchanged.

        settling: samples that the velocities need before they are used, because their observer was reset.
        The copy has a journal of its own until `committed`. Raise TrajectoryError if there is no transition from the
        measured state to the reference.
        """
        supervisor = copy(self)
        supervisor.reference, supervisor.transfer = copy(self.reference), copy(self.transfer)
        supervisor._journal = Journal()
        supervisor._handle_order(order, stamp, settling)
        supervisor._handle_requests(order, stamp)
        return supervisor

    def committed(self, journal: Journal) -> Supervisor:
        """Return this supervisor with `journal`, to which everything reported so far is added."""
        journal.events.extend(self._journal.events)
        journal.counters.update(self._journal.counters)
        self._journal = journal
        return self

    def jets(self, stamp: int) -> Array:
        """Return the reference jets (5, n) at the stamp [ns]; stop if the state violates a limit."""
        jets, self._joining = self.reference.jets(stamp), stamp < self.reference.transition_end
        if not self.reason:
            self._check_limits(None if self.settling else jets[0])
        return jets

    def _handle_order(self, order: Order, stamp: int, settling: int) -> None:
        if order is Order.REPEATED:
            self._journal.count("states repeated")
            return
        if order is Order.FIRST:
            self._begin(stamp)
        elif order is Order.BACK:
            sentence = "the time of the states jumped back: the reference starts again"
            self._journal.report(WARN, "reference restarts", sentence)
            self._begin(stamp)
        elif order is Order.FORWARD:
            self._journal.report(WARN, "forward jumps", "the time of the states jumped forward")
        elif order is Order.NEXT and settling:
            sentence = "the velocity observer was reset: a gap, or a state without an effort"
            self._journal.report(WARN, "observer restarts", sentence)
        if order is not Order.NEXT or settling:
            self.transfer.stop()
            self.settling = 1 + settling

    def _begin(self, stamp: int) -> None:
        """Set the reference's time 0 to this stamp [ns]."""
        if self._holding:
            self.reference.stand(self._state.q_l, stamp)
            self._holding = False
        self.reference.begin(stamp)
        self.bound_start = None
        self.starting = True

    def _handle_requests(self, order: Order, stamp: int) -> None:
        """Carry out requests since the last sample; start or recover once the velocities have settled."""
        ready = False
        if self.settling and order is not Order.REPEATED:
            self.settling -= 1
            ready = not self.settling
        if self._resuming:
            ready = self._resume(stamp)
        if ready and not self.reason:
            self._start_or_recover(stamp)
        if self._holding:
            self._hold(stamp)
        self.reference.advance(stamp, 0.0 if self.reason else self.settings.recovery_join_time)

    def _hold(self, stamp: int) -> None:
        if self.reason:
            self.reference.stand(self._state.q_l, stamp)
        else:
            self.reference.brake(stamp, self.settings.hold_deceleration)
        self._holding = False

    def _resume(self, stamp: int) -> bool:
        """End the stop unless the state violates a limit; return True if tracking can recover at this sample."""
        self.reason, self._resuming = "", False
        self._check_limits(None)
        if self.reason:
            return False
        self._journal.count("resumes")
        self.starting = self.starting and self.settings.recovery_join_time == 0
        if self.starting:
            self._begin(stamp)
        return self.settling == 0

    def _start_or_recover(self, stamp: int) -> None:
        self._check_limits(None)
        if self.reason:
            return
        if self.starting:
            self._start(stamp)
        else:
            self._recover(stamp)

    def _start(self, stamp: int) -> None:
        self.transfer.begin(stamp, self.settings.ramp_time, ramp=True)
        if self.settings.start_join_time > 0:
            jets0 = standing(self._state.q_l, self._state.dq_l)
            self.reference.begin_transition(jets0, stamp, self.settings.start_join_time)
        else:
            self._check_start(self.reference.jets(stamp)[0])
        self.starting = bool(self.reason)

    def _check_start(self, q_ld: Array) -> None:
        """Refuse the start if |q_l - q_ld| exceeds limits.start_error at a joint."""
        error, limit = np.abs(self._state.q_l - q_ld), np.asarray(self.settings.start_error)
        far = error > limit
        if not far.any():
            return
        i = int(np.argmax(far))
        joint, unit = self.settings.joints[i], self.settings.units[i].position
        sentence = (
            f"start refused: |q_l - q_ld| of {joint} is {error[i]:.6g} {unit}; "
            f"expected at most {limit[i]:.6g} {unit}, or a start.join_time above 0"
        )
        self._stop(STARTS_REFUSED, sentence, joint, float(error[i]), float(limit[i]))

    def _recover(self, stamp: int) -> None:
        self.bound_start = None
        seconds = self.settings.recovery_join_time
        sentence = "recovery: tracking continues at once"
        if seconds > 0:
            self.reference.begin_transition(standing(self._state.q_l, self._state.dq_l), stamp, seconds)
            self.transfer.begin(stamp, BLEND * seconds, ramp=False)
            sentence = f"recovery: transition to the reference within {seconds:g} s"
        self._journal.report(INFO, "recoveries", sentence)

    def _check_limits(self, q_ld: Array | None) -> None:
        """Stop at a violated limit; that of the tracking error is checked if q_ld (n,) is given."""
        v = self._limits.violation(q_ld, velocities=not self.settling)
        if v is not None:
            self._journal.count(f"stops: {v.kind}")
            self._stop(STOPS, f"stopped: {v.sentence}", v.joint, v.value, v.limit)

    def _stop(
        self, kind: str, sentence: str, joint: str = "", value: float = math.nan, limit: float = math.nan
    ) -> None:
        self.reason = sentence
        self.transfer.stop()
        self.bound_start = None
        numbers = {} if math.isnan(value) else {"value": value, "limit": limit}
        where = {"joint": joint} if joint else {}
        self._journal.report(ERROR, kind, sentence, **where, **numbers)
