# SPDX-License-Identifier: Apache-2.0
"""Trajectories are planned beside the answering of states, in a thread of their own.

What is asked for is planned from the jets that the running reference has at the stamp where the plan begins. When the
plan is ready after that stamp, it is joined from the jets of that moment: the two have hardly parted yet, and the
effort has no step. Where the running reference became another one meanwhile, it is planned once more.
"""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from fjr_core import FjrError, Reference, Spline
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.motion_limits import MotionLimits, check_motion
from fjr_core.trajectories.transition import join, shifted
from fjr_msgs_py.messages.joint_states import MessageError, nanoseconds
from fjr_msgs_py.messages.trajectories import SECOND, TrajectoryReader

from ..tracking.events import State
from ..tracking.tracker import Tracker

ATTEMPTS = 5
JOIN_TIME, JOIN_FACTOR = 20_000_000, 10  # ns, and of the delay: how soon a plan that came late is met
SWITCH = 1e-4  # s; after which the planning thread lets a waiting answer go first


@dataclass(frozen=True)
class Plan:
    """A checked trajectory whose time 0 is at the stamp `start` [ns]; None is a stop."""

    reference: Reference | None
    start: int

    @property
    def end(self) -> float:
        """Stamp [ns] of its last point."""
        return self.start if self.reference is None else self.start + self.reference.end * SECOND


Outcome = Plan | FjrError | None
"""A plan that can be followed, the reason why there is none, or None: it was given up meanwhile."""


@dataclass(frozen=True, eq=False)
class Rules:
    """How trajectories are read, and the limits of all motion."""

    joints: tuple[str, ...]
    limits: MotionLimits
    reader: TrajectoryReader


@dataclass(frozen=True, eq=False)
class Wish:
    """A message that came at the stamp `now` [ns], and who is to be told what becomes of it."""

    message: JointTrajectory
    now: int
    told: Callable[[Outcome], None]


@dataclass(frozen=True, eq=False)
class Question:
    """What is to be planned, from the jets (5, n) that the running reference has at the stamp `begin` [ns]."""

    wish: Wish
    begin: int
    jets: Array
    rules: Rules

    def answer(self) -> Plan:
        """The plan; raises FjrError where the message cannot be followed."""
        waypoints = self.rules.reader.read(self.wish.message).upcoming(self.wish.now).upcoming(self.begin)
        waypoints = waypoints.completed(self.jets[0])
        times, start = waypoints.times / SECOND, waypoints.start
        assert start is not None
        spline = Spline(times, waypoints.positions, waypoints.velocities, waypoints.accelerations, start=self.jets)
        check_motion(spline, self.rules.limits, 0.0, spline.end, self.rules.joints)
        return Plan(spline, start)

    def outcome(self) -> Plan | Exception:
        """The plan, or what was raised instead."""
        try:
            return self.answer()
        except Exception as error:
            return error

    def joined(self, plan: Plan, jets: Array, stamp: int) -> Plan:
        """The plan as it is joined from jets (5, n) at the stamp [ns], after its start; raises TrajectoryError."""
        assert plan.reference is not None
        late = stamp - plan.start
        seconds = (JOIN_TIME + JOIN_FACTOR * late) / SECOND
        reference = join(jets, 0.0, shifted(plan.reference, -late / SECOND), seconds)
        check_motion(reference.segment, self.rules.limits, 0.0, seconds, self.rules.joints)
        return Plan(reference, stamp)


class Planner:
    """Plans the newest trajectory that was asked for; everything but the planning happens on the caller's thread.

    With use_sim_time it plans at once, from the newest answered state on: stamps wait for the answers there, and a
    run can be repeated bit by bit.
    """

    def __init__(self, node: Node, tracker: Tracker, is_active: Callable[[], bool]) -> None:
        self._node, self._tracker, self._is_active = node, tracker, is_active
        by_stamps = bool(node.get_parameter("use_sim_time").value)
        self._worker = None if by_stamps else ThreadPoolExecutor(1, "fjr_planning")
        self._wish: Wish | None = None

    def limit(self, rules: Rules) -> None:
        """Read and check by these from now on, also what is being planned."""
        self._rules = rules

    def ask(self, message: JointTrajectory, told: Callable[[Outcome], None]) -> None:
        """Plan, and tell the outcome; what was being planned is given up. A message without points is a stop.

        `told` is called on the thread on which the node is spun, at once where nothing takes time.
        """
        self.drop()
        try:
            now = self.newest()
            if not message.points:
                self._rules.reader.read(message)
        except FjrError as error:
            told(error)
            return
        if not message.points:
            told(Plan(None, now))
            return
        self._wish = Wish(message, now, told)
        self._attempt(self._wish, now, 1)

    def drop(self) -> None:
        """Give up what is being planned."""
        self._end(None)

    def close(self) -> None:
        """Give up, and end the thread."""
        self.drop()
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)

    def newest(self) -> int:
        """The newest answered state's stamp [ns]; raises MessageError where nothing can begin there."""
        if not self._is_active():
            raise MessageError("inactive", "the controller is inactive; expected an active one")
        if self._tracker.state is State.STOPPED:
            raise MessageError(
                "stopped", f"the controller has stopped ({self._tracker.reason}); expected ~/resume first"
            )
        if self._tracker.last_stamp is None:
            raise MessageError("no state", "no state has been answered yet; expected one to begin from")
        return self._tracker.last_stamp

    def _attempt(self, wish: Wish, newest: int, number: int) -> None:
        begin = max(nanoseconds(wish.message.header.stamp), newest)
        jets = self._tracker.jets_at(begin)
        assert jets is not None
        question = Question(wish, begin, jets, self._rules)
        if self._worker is None:
            self._judge(question, number, question.outcome())
        else:
            self._worker.submit(self._work, question, number)

    def _work(self, question: Question, number: int) -> None:
        """On the planning thread."""
        if question.wish is not self._wish:
            return
        _give_way()
        before = sys.getswitchinterval()
        sys.setswitchinterval(min(before, SWITCH))
        outcome = question.outcome()
        sys.setswitchinterval(before)
        executor = self._node.executor
        if executor is not None:  # else nobody waits for it any more
            executor.create_task(self._judge, question, number, outcome)

    def _judge(self, question: Question, number: int, outcome: Plan | Exception) -> None:
        """End the wish, or plan once more; nothing is raised: in a task of the events executor it ends the process."""
        if question.wish is not self._wish:
            return
        try:
            newest = self.newest()
            plan = self._judged(question, outcome, newest)
            if plan is None and number < ATTEMPTS:
                self._attempt(question.wish, newest, number + 1)
                return
            self._end(plan or MessageError("restless", f"the reference changed {ATTEMPTS} times; expected it to go on"))
        except FjrError as error:
            self._end(error)
        except Exception as error:
            self._log(error)
            self._end(MessageError("failed", f"the planning failed by {error!r}; expected a plan or a reason"))

    def _judged(self, question: Question, outcome: Plan | Exception, newest: int) -> Plan | None:
        """The plan as it can be followed now; None where it is to be made once more; else what is wrong is raised."""
        if isinstance(outcome, MessageError) or not isinstance(outcome, (Plan, FjrError)):
            raise outcome
        if newest < question.wish.now:
            raise MessageError("restarted", "the time of the states jumped back meanwhile; expected it to go on")
        jets, now = self._tracker.jets_at(question.begin), self._tracker.jets_at(newest)
        assert jets is not None
        assert now is not None
        if question.rules is not self._rules or not np.array_equal(jets, question.jets):
            return None
        if isinstance(outcome, FjrError):
            raise outcome
        return outcome if newest <= outcome.start else question.joined(outcome, now, newest)

    def _end(self, outcome: Outcome) -> None:
        wish, self._wish = self._wish, None
        if wish is None:
            return
        try:
            wish.told(outcome)
        except Exception as error:  # the wish has ended all the same
            self._log(error)

    def _log(self, error: Exception) -> None:
        """An error that nobody foresaw."""
        self._node.get_logger().error("".join(traceback.format_exception(error)))


def _give_way() -> None:
    """Schedule this thread below those that answer, where these have real-time priority."""
    with suppress(OSError, AttributeError):
        answering = os.getpid()  # the main thread
        if os.sched_getscheduler(answering) == os.SCHED_FIFO:
            priority = os.sched_getparam(answering).sched_priority
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(max(priority - 1, 1)))
