# SPDX-License-Identifier: Apache-2.0
"""The motion interface: trajectories on a topic, and the services ~/hold, ~/play and ~/resume."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from fjr_core import FjrError, Reference
from fjr_core.motions.motion_limits import MotionLimits, check_motion
from fjr_core.motions.transition import transition
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import Event, State
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import MessageError
from fjr_msgs_py.node.participant import SeparateSubscription

from .planner import Outcome, Planner, PlanningRules, TrajectoryPlan
from .reports import TRAJECTORY_REFUSED, Reports

GIVEN_UP = "trajectories given up"


class TrajectoryInterface:
    """Accept JointTrajectory messages and service calls while `is_active()`.

    `on_replaced` is called with the reason whenever another motion replaces the present one.
    """

    def __init__(
        self,
        node: Node,
        joints: tuple[str, ...],
        step: ControlStep,
        reports: Reports,
        is_active: Callable[[], bool],
        built_in: Callable[[], Reference],
        apart: bool,
    ) -> None:
        """built_in: returns the reference that the parameters describe; raises FjrError if it violates its limits.

        apart: receive trajectories in a DDS participant of their own, beside a native command loop.
        """
        self._node, self._joints, self._step, self._reports = node, joints, step, reports
        self._is_active, self._built_in = is_active, built_in
        self.planner = Planner(node, step, is_active)
        self.on_replaced: Callable[[str], None] = lambda reason: None
        self._close_subscription = self._subscribe(apart)
        self._services = [
            node.create_service(Trigger, name, self._service(act))
            for name, act in ((names.HOLD, self._hold), (names.PLAY, self._play), (names.RESUME, self._resume))
        ]

    def apply(self, limits: MotionLimits, join_time: float, allow_partial: bool) -> None:
        """Replace the limits of requested motions; join_time [s]: transition to the built-in reference.

        allow_partial: accept trajectories that do not name every joint.
        """
        self._limits, self._join_time = limits, join_time
        self.planner.rules = PlanningRules(self._joints, limits, allow_partial)

    def follow(
        self, message: JointTrajectory, reason: str, on_done: Callable[[TrajectoryPlan | None], object] = lambda _: None
    ) -> None:
        """Plan the trajectory of the message, then track it in place of the present motion.

        reason: passed to `on_replaced`. on_done: called with the plan that is tracked from then on, or with None if the
        message was refused or replaced by a newer one, after that was reported.
        """

        def end(outcome: Outcome) -> None:
            if isinstance(outcome, TrajectoryPlan):
                self._begin(outcome, reason)
            else:
                self._report(outcome)
            on_done(outcome if isinstance(outcome, TrajectoryPlan) else None)

        self.planner.request(message, end)

    def hold(self) -> None:
        """Come to a standstill; a trajectory that is being planned is tracked when it is ready."""
        self._step.hold()
        self._reports.publish_events()

    def close(self) -> None:
        """Destroy the subscription, the services and the planner."""
        self.planner.close()
        self._close_subscription()
        for service in self._services:
            self._node.destroy_service(service)

    def _subscribe(self, apart: bool) -> Callable[[], object]:
        """Subscribe to trajectories; return what ends the subscription."""
        what = JointTrajectory, names.JOINT_TRAJECTORY, lambda data: self.planner.read(data, self._on_read)
        if apart:
            return SeparateSubscription(self._node, *what).close
        subscription = self._node.create_subscription(*what, 10, raw=True)
        return lambda: self._node.destroy_subscription(subscription)

    def _begin(self, plan: TrajectoryPlan, reason: str) -> None:
        self.on_replaced(reason)
        if plan.reference is None:
            self._step.hold()
        else:
            self._step.follow(plan.reference, plan.start)
        self._reports.count["trajectories accepted"] += 1
        self._reports.publish_events()

    def _report(self, error: FjrError | None) -> None:
        """Report why a trajectory is not tracked; None: it was discarded."""
        if error is None:
            self._reports.event(Event("info", GIVEN_UP, "a trajectory was discarded before it was planned"))
            return
        kind = error.kind if isinstance(error, MessageError) else "cannot be followed"
        self._reports.event(Event("warn", f"{TRAJECTORY_REFUSED}: {kind}", f"{TRAJECTORY_REFUSED}: {error}"))

    def _on_read(self, message: JointTrajectory | MessageError | None) -> None:
        if isinstance(message, JointTrajectory):
            self.follow(message, "another trajectory was accepted")
        else:
            self._report(message)

    def _service(self, act: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def respond(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                if not self._is_active():
                    raise MessageError("inactive", "the controller is inactive; expected an active one")
                response.message = act()
                response.success = True
            except FjrError as error:
                response.success, response.message = False, str(error)
            self._reports.publish_events()
            return response

        return respond

    def _hold(self) -> str:
        self.planner.drop()
        self.on_replaced("~/hold was called")
        self._step.hold()
        return "the motion comes to a standstill"

    def _play(self) -> str:
        reference, start = self._with_transition(self._built_in())
        self.planner.drop()
        self.on_replaced("~/play was called")
        self._step.follow(reference, start)
        return "transition to the built-in reference"

    def _with_transition(self, reference: Reference) -> tuple[Reference, int | None]:
        """Return the reference with a checked transition from the last jets, and its start; alone before a sample."""
        start = self._step.last_stamp
        if start is None or not self._join_time or self._step.state is State.STOPPED:
            return reference, None
        jets = self._step.jets_at(start)
        assert jets is not None
        joined = transition(jets, 0.0, reference, self._join_time)
        check_motion(joined.segment, self._limits, 0.0, self._join_time, self._joints)
        return joined, start

    def _resume(self) -> str:
        if self._step.state is not State.STOPPED:
            raise MessageError("not stopped", "the controller is not stopped; expected a stopped one")
        if outside := self._step.outside():
            raise MessageError("outside the limits", f"the controller stays stopped: {outside}")
        self._step.resume()
        return "tracking resumes"
