# SPDX-License-Identifier: Apache-2.0
"""What the controller is asked to do: follow a trajectory, hold, play the built-in reference, go on after a stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from rclpy.node import Node
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

from fjr_core import FjrError, Reference, Spline
from fjr_core.motion_limits import MotionLimits, check_motion
from fjr_msgs_py import names
from fjr_msgs_py.messages import MessageError
from fjr_msgs_py.trajectories import SECOND, TrajectoryReader, Waypoints

from .events import Event, State
from .reports import Reports
from .tracker import Tracker

REFUSED = "trajectory refused"


@dataclass(frozen=True)
class Plan:
    """A checked trajectory whose time 0 is at the stamp `start` [ns]; None is a stop."""

    reference: Reference | None
    start: int

    @property
    def end(self) -> float:
        """Stamp [ns] of its last point."""
        return self.start if self.reference is None else self.start + self.reference.end * SECOND


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
        """built_in: makes the reference that the node's parameters describe now."""
        self._node, self._joints, self._tracker, self._reports = node, joints, tracker, reports
        self._is_active, self._built_in = is_active, built_in
        self.replaced: Callable[[str], None] = lambda reason: None
        self._subscription = node.create_subscription(JointTrajectory, names.JOINT_TRAJECTORY, self._on_trajectory, 10)
        self._services = [
            node.create_service(Trigger, name, self._served(act))
            for name, act in ((names.HOLD, self._hold), (names.PLAY, self._play), (names.RESUME, self._resume))
        ]

    def limit(self, limits: MotionLimits, allow_partial: bool) -> None:
        """Check what is asked for from now on by these."""
        self._limits = limits
        self._reader = TrajectoryReader(self._joints, allow_partial)

    def plan(self, message: JointTrajectory) -> Plan:
        """What the message asks for, as it can be followed from the running reference on; raises FjrError."""
        now = self._now()
        waypoints = self._reader.read(message)
        if not waypoints.times.size:
            return Plan(None, now)
        waypoints = waypoints.upcoming(now)
        assert waypoints.start is not None
        spline = self._spline(waypoints, waypoints.start)
        check_motion(spline, self._limits, 0.0, spline.end, self._joints)
        return Plan(spline, waypoints.start)

    def begin(self, plan: Plan, reason: str) -> None:
        """Follow the plan, or hold where it is a stop."""
        self.replaced(reason)
        if plan.reference is None:
            self._tracker.hold()
        else:
            self._tracker.follow(plan.reference, plan.start)
        self._reports.count["trajectories accepted"] += 1
        self._reports.empty()

    def hold(self) -> None:
        """Come to rest and stand."""
        self._tracker.hold()
        self._reports.empty()

    def refuse(self, error: FjrError) -> None:
        """Say why a trajectory is refused."""
        kind = error.kind if isinstance(error, MessageError) else "cannot be followed"
        self._reports.event(Event("warn", f"{REFUSED}: {kind}", f"{REFUSED}: {error}"))

    def close(self) -> None:
        """Take no more."""
        self._node.destroy_subscription(self._subscription)
        for service in self._services:
            self._node.destroy_service(service)

    def _now(self) -> int:
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

    def _spline(self, waypoints: Waypoints, start: int) -> Spline:
        jets = self._tracker.jets_at(start)
        assert jets is not None
        full = waypoints.completed(jets[0])
        return Spline(full.times / SECOND, full.positions, full.velocities, full.accelerations, start=jets)

    def _on_trajectory(self, message: JointTrajectory) -> None:
        try:
            plan = self.plan(message)
        except FjrError as error:
            self.refuse(error)
        else:
            self.begin(plan, "another trajectory was taken")

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
        self.replaced("~/hold was called")
        self._tracker.hold()
        return "the motion comes to rest"

    def _play(self) -> str:
        reference = self._built_in()
        check_motion(reference, self._limits, 0.0, np.inf, self._joints)
        self.replaced("~/play was called")
        self._tracker.follow(reference)
        return "the built-in reference is joined"

    def _resume(self) -> str:
        if self._tracker.state is not State.STOPPED:
            raise MessageError("not stopped", "nothing is stopped; expected a controller that a limit has stopped")
        self._tracker.resume()
        return "the controller goes on"
