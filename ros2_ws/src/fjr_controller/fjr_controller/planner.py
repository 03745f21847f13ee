# SPDX-License-Identifier: Apache-2.0
"""Plan trajectories in a thread of its own, so that commands are never late.

A trajectory is planned from the jets that the active reference has at the stamp where the plan begins. If the plan is
ready only after that stamp, it is reached by a short transition from the jets of that moment, without a step of the
effort. If the active reference has changed meanwhile, the trajectory is planned again.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from fjr_core import FjrError, Reference, Spline, TrajectoryError
from fjr_core.motions.motion_limits import MotionLimits, check_motion
from fjr_core.motions.transition import time_shifted, transition
from fjr_core.numerics.checks import Array
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from fjr_msgs_py.messages.joint_states import SECOND, MessageError, deserialised, nanoseconds
from fjr_msgs_py.messages.trajectories import TrajectoryPoints, read_trajectory
from fjr_msgs_py.node.scheduling import step_back

ATTEMPTS = 5  # to plan from a reference that changes meanwhile
JOIN_TIME, JOIN_FACTOR, JOIN_LONGEST = 20_000_000, 10, 2_000_000_000  # ns, per ns of delay, ns; see with_transition
LONG = 1 << 16  # bytes, of about 200 points of seven joints
SWITCH = 1e-4  # s; after which the planning thread yields to the command loop


@dataclass(frozen=True)
class TrajectoryPlan:
    """A checked trajectory whose time 0 is at the stamp `start` [ns]; reference None: hold."""

    reference: Reference | None
    start: int

    @property
    def end(self) -> float:
        """Return the stamp [ns] of the last point."""
        return self.start if self.reference is None else self.start + self.reference.end * SECOND


Outcome = TrajectoryPlan | FjrError | None
"""A plan, the error why there is none, or None if the request was discarded."""


@dataclass(frozen=True, eq=False)
class PlanningRules:
    """Joints, limits of the motion, and whether a trajectory may name some of the joints only."""

    joints: tuple[str, ...]
    limits: MotionLimits
    allow_partial: bool

    def read(self, message: JointTrajectory) -> TrajectoryPoints:
        """Return the waypoints of a message; raises MessageError."""
        return read_trajectory(message, self.joints, self.allow_partial)


@dataclass(frozen=True, eq=False)
class PlanningRequest:
    """A message that arrived at the stamp `now` [ns], and the callback for its outcome."""

    message: JointTrajectory
    now: int
    on_done: Callable[[Outcome], None]


@dataclass(frozen=True, eq=False)
class PlanningProblem:
    """A request to be planned from the jets (5, n) of the active reference at the stamp `begin` [ns]."""

    request: PlanningRequest
    begin: int
    jets: Array
    rules: PlanningRules

    def outcome(self) -> TrajectoryPlan | Exception:
        """Return the plan, or the error: a FjrError if the trajectory of the message cannot be tracked."""
        try:
            waypoints = self.rules.read(self.request.message).upcoming(self.request.now).upcoming(self.begin)
            waypoints = waypoints.completed(self.jets[0])
            times, start = waypoints.times / SECOND, waypoints.start
            assert start is not None
            spline = Spline(times, waypoints.positions, waypoints.velocities, waypoints.accelerations, start=self.jets)
            check_motion(spline, self.rules.limits, 0.0, spline.end, self.rules.joints)
            return TrajectoryPlan(spline, start)
        except Exception as error:
            return error

    def with_transition(self, plan: TrajectoryPlan, jets: Array, stamp: int) -> TrajectoryPlan:
        """Return the plan with a transition from jets (5, n) at the stamp [ns] after its start.

        The transition takes JOIN_TIME and JOIN_FACTOR times the delay, at most JOIN_LONGEST: a polynomial from a motion
        to another swings out by their jets times powers of its duration. Raise TrajectoryError, with the delay, if it
        violates a limit.
        """
        assert plan.reference is not None
        late = stamp - plan.start
        seconds = min(JOIN_TIME + JOIN_FACTOR * late, JOIN_LONGEST) / SECOND
        reference = transition(jets, 0.0, time_shifted(plan.reference, -late / SECOND), seconds)
        try:
            check_motion(reference.segment, self.rules.limits, 0.0, seconds, self.rules.joints)
        except TrajectoryError as error:
            delay = f"the plan was ready {late / SECOND:.3g} s after its start"
            sentence = f"{delay}, and in the transition of {seconds:.3g} s to it {error}"
            raise TrajectoryError(f"{sentence}; expected a header.stamp that is further ahead") from error
        return TrajectoryPlan(reference, stamp)


class Planner:
    """Plan the newest requested trajectory; callbacks are called on the thread that spins the node.

    With use_sim_time the trajectory is planned in the caller's thread, from the last sample on, while states wait, so
    that runs repeat to the last bit.
    """

    def __init__(self, node: Node, step: ControlStep, is_active: Callable[[], bool]) -> None:
        self._node, self._step, self._is_active = node, step, is_active
        simulated = bool(node.get_parameter("use_sim_time").value)
        self._worker = None if simulated else ThreadPoolExecutor(1, "fjr_planning", step_back)
        self.rules: PlanningRules  # also for the trajectory that is being planned
        self._request: PlanningRequest | None = None
        self._drops = 0

    def read(self, data: bytes, on_done: Callable[[JointTrajectory | MessageError | None], None]) -> None:
        """Call `on_done` with the message, on the thread that spins the node; None: it was replaced by a newer one.

        A message of more than LONG bytes is read on the planning thread: 100,000 points take a second, which the kernel
        does not give to a real-time thread without a pause for all on its core.
        """
        executor = self._node.executor
        if self._worker is None or executor is None or len(data) <= LONG or not self._is_active():
            on_done(_read(data))
            return
        self.drop()
        drops = self._drops

        def end(found: JointTrajectory | MessageError) -> None:
            on_done(found if drops == self._drops else None)

        self._worker.submit(lambda: executor.create_task(end, _read(data)))

    def request(self, message: JointTrajectory, on_done: Callable[[Outcome], None]) -> None:
        """Plan the trajectory in place of the one that is being planned; a message without points means hold.

        `on_done` is called with the outcome, before this returns if nothing has to be planned.
        """
        with nullcontext() if self._worker else self._step.between_samples():
            self.drop()
            try:
                now = self.newest()
                if not message.points:
                    self.rules.read(message)
            except FjrError as error:
                on_done(error)
                return
            if not message.points:
                on_done(TrajectoryPlan(None, now))
                return
            self._request = PlanningRequest(message, now, on_done)
            self._attempt(self._request, now, 1)

    def drop(self) -> None:
        """Discard the trajectory that is being read or planned."""
        self._drops += 1
        self._end(None)

    def close(self) -> None:
        """Discard the trajectory that is being planned, and end the thread."""
        self.drop()
        if self._worker is not None:
            self._worker.shutdown(cancel_futures=True)

    def newest(self) -> int:
        """Return the stamp [ns] of the last sample. Raise MessageError if no trajectory can begin there."""
        if not self._is_active():
            raise MessageError("inactive", "the controller is inactive; expected an active one")
        if self._step.state is State.STOPPED:
            raise MessageError("stopped", f"the controller has stopped ({self._step.reason}); expected ~/resume first")
        if self._step.last_stamp is None:
            raise MessageError("no state", "no state has arrived yet; expected one as the start")
        return self._step.last_stamp

    def _attempt(self, request: PlanningRequest, newest: int, number: int) -> None:
        begin = max(nanoseconds(request.message.header.stamp), newest)
        jets = self._step.jets_at(begin)
        assert jets is not None
        problem = PlanningProblem(request, begin, jets, self.rules)
        if self._worker is None:
            self._conclude(problem, number, problem.outcome())
        else:
            self._worker.submit(self._work, problem, number)

    def _work(self, problem: PlanningProblem, number: int) -> None:
        """Plan on the planning thread."""
        if problem.request is not self._request:
            return
        before = sys.getswitchinterval()
        sys.setswitchinterval(min(before, SWITCH))
        outcome = problem.outcome()
        sys.setswitchinterval(before)
        executor = self._node.executor
        if executor is not None:  # without an executor no caller waits
            executor.create_task(self._conclude, problem, number, outcome)

    def _conclude(self, problem: PlanningProblem, number: int, outcome: TrajectoryPlan | Exception) -> None:
        """End the request, or plan again. Raise nothing: in a task of the events executor that ends the process."""
        if problem.request is not self._request:
            return
        try:
            newest = self.newest()
            plan = self._checked(problem, outcome, newest)
            if plan is None and number < ATTEMPTS:
                self._attempt(problem.request, newest, number + 1)
                return
            sentence = f"the active reference changed {ATTEMPTS} times while planning; send it again"
            self._end(plan or MessageError("restless", sentence))
        except FjrError as error:
            self._end(error)
        except Exception as error:
            self._log(error)
            self._end(MessageError("failed", f"planning failed with an unexpected error, {error!r}"))

    def _checked(
        self, problem: PlanningProblem, outcome: TrajectoryPlan | Exception, newest: int
    ) -> TrajectoryPlan | None:
        """Return the plan that can be tracked now, or None to plan again; raise the error of planning."""
        if isinstance(outcome, MessageError) or not isinstance(outcome, (TrajectoryPlan, FjrError)):
            raise outcome
        if newest < problem.request.now:
            raise MessageError("restarted", "the time of the states jumped back while planning; send it again")
        jets, now = self._step.jets_at(problem.begin), self._step.jets_at(newest)
        assert jets is not None
        assert now is not None
        if problem.rules is not self.rules or not np.array_equal(jets, problem.jets):
            return None
        if isinstance(outcome, FjrError):
            raise outcome
        return outcome if newest <= outcome.start else problem.with_transition(outcome, now, newest)

    def _end(self, outcome: Outcome) -> None:
        request, self._request = self._request, None
        if request is None:
            return
        try:
            request.on_done(outcome)
        except Exception as error:  # the request has ended regardless
            self._log(error)

    def _log(self, error: Exception) -> None:
        """Log an unexpected error with its traceback."""
        self._node.get_logger().error("".join(traceback.format_exception(error)))


def _read(data: bytes) -> JointTrajectory | MessageError:
    try:
        return deserialised(data, JointTrajectory)
    except MessageError as error:
        return error
