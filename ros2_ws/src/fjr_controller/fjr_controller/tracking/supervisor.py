# SPDX-License-Identifier: Apache-2.0
"""When tracking begins, joins, recovers and stops: what is between the measured state and the reference."""

from __future__ import annotations

import math
from copy import copy

import numpy as np

from fjr_core import Reference
from fjr_core.control.safety_settings import Settings
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.point_to_point import standing

from .active_reference import RunningReference
from .bound_start import Watch
from .bumpless_transfer import Fade
from .events import ERROR, INFO, STARTS_REFUSED, STOPS, WARN, Journal
from .limits import StateLimits
from .stamp_order import Order

BLEND = 0.05  # of the joining time: longer makes no smaller step of u, and a larger error


class Course:
    """The reference with its clock, the fade of the effort and the stop, moved on sample by sample.

    reason: why it is stopped, one sentence; empty otherwise. blind: samples left in which the velocities do not
    count yet. starting: tracking has not begun on this time line. The state is looked up in `limits`, what happens is
    written into `journal`.
    """

    def __init__(self, reference: Reference, settings: Settings, limits: StateLimits, journal: Journal) -> None:
        self.settings, self.reference = settings, RunningReference(reference)
        self.fade, self.watch = Fade(), Watch()
        self.reason, self.blind, self.starting = "", 0, True
        self._limits, self._journal = limits, journal
        self._resuming = self._holding = self._joining = False

    @property
    def joining(self) -> bool:
        """Whether the effort or the reference is still led into the wanted one."""
        return self.fade.active or self.blind > 0 or self._joining

    def follow(self, reference: Reference, start: int | None) -> None:
        """See Tracker.follow."""
        self._holding = False
        self.reference.replace(reference, start)
        self._journal.say(INFO, "references changed", f"another reference: {type(reference).__name__}")

    def hold(self) -> None:
        """See Tracker.hold."""
        self._holding = True
        self.reference.drop()
        self._journal.say(INFO, "holds", "hold: the motion comes to rest")

    def resume(self) -> None:
        """See Tracker.resume."""
        self._resuming = bool(self.reason)

    def refuse_wiring(self, sentence: str, joint: str) -> None:
        """Stop because efforts or sensors are connected wrongly, with what was found."""
        self._journal.count("stops: wiring")
        self._stop("stops", f"stopped: {sentence}", joint)

    def is_even(self, order: Order, stamp: int, observed: int) -> bool:
        """Whether the sample is the occasion for nothing: what is under way goes on."""
        asked = self._resuming or self._holding or self.reference.is_due(stamp)
        return order is Order.NEXT and not (observed or self.blind or asked)

    def turned(self, order: Order, stamp: int, observed: int) -> Course:
        """A course after everything that the sample is the occasion for, with a journal of its own; this one stays.

        observed: samples that the velocities need before they count, because their observer has begun anew.
        Raises TrajectoryError for a state from which no motion leads back.
        """
        course = copy(self)
        course.reference, course.fade, course.watch = copy(self.reference), copy(self.fade), copy(self.watch)
        course._journal = Journal()
        course._arrange(order, stamp, observed)
        course._advance(order, stamp)
        return course

    def taken(self, journal: Journal) -> Course:
        """This course, which writes into `journal`, also what it has written so far."""
        journal.take(self._journal)
        self._journal = journal
        return self

    def jets(self, stamp: int) -> Array:
        """The reference (5, n) for the state, whose limits are checked with it."""
        jets, self._joining = self.reference.jets(stamp), stamp < self.reference.joined_at
        if not self.reason:
            self._check(None if self.blind else jets[0])
        return jets

    def _arrange(self, order: Order, stamp: int, observed: int) -> None:
        if order is Order.REPEATED:
            self._journal.count("states repeated")
            return
        if order is Order.FIRST:
            self._begin(stamp)
        elif order is Order.BACK:
            text = "the time of the states jumped back: the reference starts again"
            self._journal.say(WARN, "reference restarts", text)
            self._begin(stamp)
        elif order is Order.FORWARD:
            self._journal.say(WARN, "forward jumps", "the time of the states jumped forward")
        elif order is Order.NEXT and observed:
            text = "the observer of the velocities began anew: a gap, or a state without an effort"
            self._journal.say(WARN, "observer restarts", text)
        if order is not Order.NEXT or observed:
            self.fade.stop()
            self.blind = 1 + observed

    def _begin(self, stamp: int) -> None:
        """The reference's time 0 is here."""
        if self._holding:
            self.reference.stand(self._limits.q_l, stamp)
            self._holding = False
        self.reference.begin(stamp)
        self.watch.void()
        self.starting = True

    def _advance(self, order: Order, stamp: int) -> None:
        """What was asked for since the last sample, and a start or a recovery when its time has come."""
        ready = False
        if self.blind and order is not Order.REPEATED:
            self.blind -= 1
            ready = not self.blind
        if self._resuming:
            ready = self._resume(stamp)
        if ready and not self.reason:
            self._lead(stamp)
        if self._holding:
            self._hold(stamp)
        self.reference.advance(stamp, 0.0 if self.reason else self.settings.recovery_join_time)

    def _hold(self, stamp: int) -> None:
        if self.reason:
            self.reference.stand(self._limits.q_l, stamp)
        else:
            self.reference.brake(stamp, self.settings.hold_deceleration)
        self._holding = False

    def _resume(self, stamp: int) -> bool:
        """End the stop, unless the state is outside its limits; whether the reference can be led from it."""
        self.reason, self._resuming = "", False
        self._check(None)
        if self.reason:
            return False
        self._journal.count("resumes")
        self.starting = self.starting and self.settings.recovery_join_time == 0
        if self.starting:
            self._begin(stamp)
        return self.blind == 0

    def _lead(self, stamp: int) -> None:
        """Lead reference and effort from the measured state, unless that is outside its limits."""
        self._check(None)
        if self.reason:
            return
        if self.starting:
            self._start(stamp)
        else:
            self._recover(stamp)

    def _start(self, stamp: int) -> None:
        m = self._limits
        self.fade.ramp(stamp, self.settings.ramp_time)
        if self.settings.start_join_time > 0:
            self.reference.join(standing(m.q_l, m.dq_l), stamp, self.settings.start_join_time)
        else:
            self._check_start(self.reference.jets(stamp)[0])
        self.starting = bool(self.reason)

    def _check_start(self, q_ld: Array) -> None:
        error, limit = np.abs(self._limits.q_l - q_ld), np.asarray(self.settings.start_error)
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
        """Lead the reference from the measured state, and the effort from the last one sent."""
        self.watch.void()
        seconds = self.settings.recovery_join_time
        if seconds > 0:
            self.reference.join(standing(self._limits.q_l, self._limits.dq_l), stamp, seconds)
            self.fade.blend(stamp, BLEND * seconds)
        text = f"recovery: the reference is joined within {seconds:g} s" if seconds else "recovery: tracking goes on"
        self._journal.say(INFO, "recoveries", text)

    def _check(self, q_ld: Array | None) -> None:
        """Stop at a broken limit; of the tracking error where q_ld (n,) is given, of the velocities unless blind."""
        v = self._limits.violation(q_ld, velocities=not self.blind)
        if v is not None:
            self._journal.count(f"stops: {v.kind}")
            self._stop(STOPS, f"stopped: {v.sentence}", v.joint, v.value, v.limit)

    def _stop(self, kind: str, sentence: str, joint: str, value: float = math.nan, limit: float = math.nan) -> None:
        self.reason = sentence
        self.fade.stop()
        self.watch.void()
        numbers = {} if math.isnan(value) else {"value": value, "limit": limit}
        self._journal.say(ERROR, kind, sentence, joint=joint, **numbers)
