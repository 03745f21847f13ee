# SPDX-License-Identifier: Apache-2.0
"""When tracking begins, joins, recovers and stops: what is between the measured state and the reference."""

from __future__ import annotations

import numpy as np

from fjr_core import Reference
from fjr_core.checks import Array
from fjr_core.references import standing
from fjr_core.safety_parameters import Settings

from .certificate import Watch
from .events import ERROR, INFO, WARN, Journal
from .fading import Fade
from .running_reference import RunningReference
from .safety import StateLimits
from .stamps import Order

BLEND = 0.05  # of the joining time: longer makes no smaller step of u, and a larger error


class Course:
    """The reference with its clock, the fade of the effort and the stop, moved on sample by sample.

    reason: why it is stopped, one sentence; empty otherwise. blind: samples left in which the velocities do not
    count yet. The state is looked up in `limits`, what happens is written into `journal`.
    """

    def __init__(self, reference: Reference, settings: Settings, limits: StateLimits, journal: Journal) -> None:
        self.settings, self.reference = settings, RunningReference(reference)
        self.fade, self.watch = Fade(), Watch()
        self.reason, self.blind = "", 0
        self._limits, self._journal = limits, journal
        self._resuming = self._holding = self._refused = self._joining = False

    @property
    def joining(self) -> bool:
        """Whether the effort or the reference is still led into the wanted one."""
        return self.fade.active or self.blind > 0 or self._joining

    def forget(self) -> None:
        """As before the first sample."""
        self.reference.forget()
        self.fade.stop()
        self.watch.void()
        self.reason, self.blind, self._resuming, self._refused = "", 0, False, False

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

    def jets(self, order: Order, stamp: int, observed: int) -> Array:
        """The reference (5, n) for the state, after everything that this sample is the occasion for.

        observed: samples that the velocities need after a break.
        """
        if order is not Order.NEXT:
            self._arrange(order, stamp, observed)
        if self._resuming or self._holding or self.blind or self.reference.waits:
            self._advance(stamp)
        jets, self._joining = self.reference.jets(stamp), stamp < self.reference.joined_at
        if not self.reason and not self.blind:
            self._check(jets[0])
        return jets

    def _arrange(self, order: Order, stamp: int, observed: int) -> None:
        if order is Order.REPEATED:
            self._journal.count("states repeated")
        elif order is Order.FIRST:
            self._begin(stamp)
        elif order is Order.BACK:
            text = "the time of the states jumped back: the reference starts again"
            self._journal.say(WARN, "reference restarts", text)
            self._begin(stamp)
        else:
            if order is Order.FORWARD:
                self._journal.say(WARN, "forward jumps", "the time of the states jumped forward")
            self.blind = 1 + observed

    def _begin(self, stamp: int) -> None:
        """The reference's time 0 is here."""
        m, self.blind = self._limits, 0
        if self._holding:
            self.reference.stand(m.q_l, stamp)
            self._holding = False
        self.reference.begin(stamp)
        self.watch.void()
        if self.reason:
            return
        self.fade.ramp(stamp, self.settings.ramp_time)
        if self.settings.start_join_time > 0:
            self.reference.join(standing(m.q_l, m.dq_l), stamp, self.settings.start_join_time)
        else:
            self._check_start(self.reference.jets(stamp)[0])

    def _check_start(self, q_ld: Array) -> None:
        error, limit = np.abs(self._limits.q_l - q_ld), np.asarray(self.settings.start_error)
        far = error > limit
        if not far.any():
            return
        i = int(np.argmax(far))
        joint = self.settings.joints[i]
        sentence = (
            f"start refused: |q_l - q_ld| of {joint} is {error[i]:.6g} rad; "
            f"expected at most {limit[i]:.6g} rad, or a start.join_time above 0"
        )
        self._refused = True
        self._stop("starts refused", sentence, joint, float(error[i]), float(limit[i]))

    def _advance(self, stamp: int) -> None:
        """What was asked for since the last sample, and a recovery when its time has come."""
        if self._resuming:
            self._resume(stamp)
        if self._holding:
            self._hold(stamp)
        self.reference.advance(stamp, 0.0 if self.reason else self.settings.recovery_join_time)
        if self.blind:
            self.blind -= 1
            if not self.blind and not self.reason:
                self._recover(stamp, "states are back")

    def _hold(self, stamp: int) -> None:
        if self.reason:
            self.reference.stand(self._limits.q_l, stamp)
        else:
            self.reference.brake(stamp, self.settings.hold_deceleration)
        self._holding = False

    def _resume(self, stamp: int) -> None:
        again = self._refused and self.settings.recovery_join_time == 0
        self.reason, self._resuming, self._refused = "", False, False
        self._journal.count("resumes")
        if again:
            self._begin(stamp)
        elif not self.blind:
            self._recover(stamp, "resumed")

    def _recover(self, stamp: int, cause: str) -> None:
        """Lead the reference from the measured state, and the effort from the last one sent."""
        self.watch.void()
        seconds = self.settings.recovery_join_time
        if seconds > 0:
            self.reference.join(standing(self._limits.q_l, self._limits.dq_l), stamp, seconds)
            self.fade.blend(stamp, BLEND * seconds)
        text = f"{cause}: the reference is joined within {seconds:g} s" if seconds else f"{cause}: tracking goes on"
        self._journal.say(INFO, "recoveries", text)

    def _check(self, q_ld: Array) -> None:
        v = self._limits.violation(q_ld)
        if v is not None:
            self._journal.count(f"stops: {v.kind}")
            self._stop("stops", f"stopped: {v.sentence}", v.joint, v.value, v.limit)

    def _stop(self, kind: str, sentence: str, joint: str, value: float, limit: float) -> None:
        self.reason = sentence
        self.fade.stop()
        self.watch.void()
        self._journal.say(ERROR, kind, sentence, joint=joint, value=value, limit=limit)
