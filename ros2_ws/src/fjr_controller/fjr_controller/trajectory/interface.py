# SPDX-License-Identifier: Apache-2.0
"""What the controller is asked to do: follow a trajectory, hold, play the built-in reference, go on after a stop."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from fjr_core import FjrError, Reference
from fjr_core.trajectories.motion_limits import MotionLimits, check_motion
from fjr_core.trajectories.transition import join
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import MessageError
from fjr_msgs_py.messages.trajectories import TrajectoryReader

from ..ros.diagnostics import Reports
from ..tracking.events import Event, State
from ..tracking.tracker import Tracker
from .planner import Outcome, Plan, Planner, Rules

REFUSED, GIVEN_UP = "trajectory refused", "trajectories given up"


def _nobody(plan: Plan | None) -> None:
    """Nobody waits for it."""


class Motion:
    """Takes JointTrajectories and the services ~/hold, ~/play and ~/resume while `is_active()`.

    `replaced` is called whenever something else is asked for than before, with the reason in words.
    """

    def __init__(
        self,
        node: Node,
        joints: tuple[str, ...],
        tracker: Tracker,
        reports: Reports,
        is_active: Callable[[], bool],
        built_in: Callable[[], Reference],
    ) -> None:
        """built_in: makes the reference that the parameters describe; raises FjrError where it leaves its limits."""
        self._node, self._joints, self._tracker, self._reports = node, joints, tracker, reports
        self._is_active, self._built_in = is_active, built_in
        self._planner = Planner(node, tracker, is_active)
        self.replaced: Callable[[str], None] = lambda reason: None
        self._subscription = node.create_subscription(JointTrajectory, names.JOINT_TRAJECTORY, self._on_trajectory, 10)
        self._services = [
            node.create_service(Trigger, name, self._served(act))
            for name, act in ((names.HOLD, self._hold), (names.PLAY, self._play), (names.RESUME, self._resume))
        ]

    def limit(self, limits: MotionLimits, join_time: float, allow_partial: bool) -> None:
        """Check what is asked for from now on by these; join_time [s]: of the built-in reference."""
        self._limits, self._join_time = limits, join_time
        self._planner.limit(Rules(self._joints, limits, TrajectoryReader(self._joints, allow_partial)))

    def take(self, message: JointTrajectory, reason: str, told: Callable[[Plan | None], None] = _nobody) -> None:
        """Follow what the message asks for as soon as it is planned, in place of what is followed, for that reason.

        `told` then gets the plan that is followed from then on, or None where the message is refused or given up
        for a newer one, after that was reported.
        """

        def end(outcome: Outcome) -> None:
            if isinstance(outcome, Plan):
                self._begin(outcome, reason)
            elif outcome is None:
                self._reports.event(Event("info", GIVEN_UP, "a trajectory is given up before it was planned"))
            else:
                self._refuse(outcome)
            told(outcome if isinstance(outcome, Plan) else None)

        self._planner.ask(message, end)

    def hold(self) -> None:
        """Come to rest and stand, until what is being planned can be followed."""
        self._tracker.hold()
        self._reports.empty()

    def drop(self) -> None:
        """Give up what is being planned."""
        self._planner.drop()

    def close(self) -> None:
        """Take no more."""
        self._planner.close()
        self._node.destroy_subscription(self._subscription)
        for service in self._services:
            self._node.destroy_service(service)

    def _begin(self, plan: Plan, reason: str) -> None:
        self.replaced(reason)
        if plan.reference is None:
            self._tracker.hold()
        else:
            self._tracker.follow(plan.reference, plan.start)
        self._reports.count["trajectories accepted"] += 1
        self._reports.empty()

    def _refuse(self, error: FjrError) -> None:
        kind = error.kind if isinstance(error, MessageError) else "cannot be followed"
        self._reports.event(Event("warn", f"{REFUSED}: {kind}", f"{REFUSED}: {error}"))

    def _on_trajectory(self, message: JointTrajectory) -> None:
        self.take(message, "another trajectory was taken")

    def _served(self, act: Callable[[], str]) -> Callable[[Trigger.Request, Trigger.Response], Trigger.Response]:
        def answer(_: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                if not self._is_active():
                    raise MessageError("inactive", "the controller is inactive; expected an active one")
                response.message = act()
                response.success = True
            except FjrError as error:
                response.success, response.message = False, str(error)
            self._reports.empty()
            return response

        return answer

    def _hold(self) -> str:
        self.drop()
        self.replaced("~/hold was called")
        self._tracker.hold()
        return "the motion comes to rest"

    def _play(self) -> str:
        reference, start = self._joined(self._built_in())
        self.drop()
        self.replaced("~/play was called")
        self._tracker.follow(reference, start)
        return "the built-in reference is joined"

    def _joined(self, reference: Reference) -> tuple[Reference, int | None]:
        """The reference with a checked way to it from the newest state's jets, and its start; as it is before that."""
        start = self._tracker.last_stamp
        if start is None or not self._join_time or self._tracker.state is State.STOPPED:
            return reference, None
        jets = self._tracker.jets_at(start)
        assert jets is not None
        joined = join(jets, 0.0, reference, self._join_time)
        check_motion(joined.segment, self._limits, 0.0, self._join_time, self._joints)
        return joined, start

    def _resume(self) -> str:
        if self._tracker.state is not State.STOPPED:
            raise MessageError("not stopped", "nothing is stopped; expected a controller that a limit has stopped")
        self._tracker.resume()
        return "the controller goes on"
