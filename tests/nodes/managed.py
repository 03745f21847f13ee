# SPDX-License-Identifier: Apache-2.0
"""A peer that also manages the controller like the ROS 2 tools: lifecycle, parameters and services."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from nodes.harness import Peer, Ros

CONTROLLER = "fjr_controller"
TRANSITIONS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "cleanup": Transition.TRANSITION_CLEANUP,
}
BY_ITSELF = ("configured", "activated", "deactivated", "cleaned up", "shut down", "tracking")


class Manager(Peer):
    def __init__(self, ros: Ros) -> None:
        super().__init__(ros)
        self.events: list[DiagnosticStatus] = []
        self.create_subscription(DiagnosticStatus, f"{CONTROLLER}/events", self.events.append, QoSProfile(depth=100))
        self.trajectories = self.create_publisher(JointTrajectory, f"{CONTROLLER}/joint_trajectory", 10)

    def state(self) -> str:
        return str(self.call(GetState, f"{CONTROLLER}/get_state").current_state.label)

    def change(self, transition: str) -> bool:
        """Request a transition by its id; return whether it succeeds, and what it made is connected."""
        asked = Transition(id=TRANSITIONS[transition])
        success = bool(self.call(ChangeState, f"{CONTROLLER}/change_state", transition=asked).success)
        self._ros.meet()
        return success

    def labels(self) -> list[str]:
        answer = self.call(GetAvailableStates, f"{CONTROLLER}/get_available_states")
        return [state.label for state in answer.available_states]

    def transitions(self) -> set[str]:
        answer = self.call(GetAvailableTransitions, f"{CONTROLLER}/get_available_transitions")
        return {description.transition.label for description in answer.available_transitions}

    def set(self, **values: Any) -> tuple[bool, str]:
        """Set parameters together, with `__` for a dot; return success and reason."""
        parameters = [Parameter(name.replace("__", "."), value=v).to_parameter_msg() for name, v in values.items()]
        service = f"{CONTROLLER}/set_parameters_atomically"
        result = self.call(SetParametersAtomically, service, parameters=parameters).result
        return result.successful, result.reason

    def set_one(self, name: str, value: Any) -> tuple[bool, str]:
        """Set one parameter, as `ros2 param set` does it."""
        asked = [Parameter(name, value=value).to_parameter_msg()]
        (result,) = self.call(SetParameters, f"{CONTROLLER}/set_parameters", parameters=asked).results
        return result.successful, result.reason

    def trigger(self, name: str) -> tuple[bool, str]:
        """Call ~/hold, ~/play or ~/resume."""
        answer = self.call(Trigger, f"{CONTROLLER}/{name}")
        return answer.success, answer.message

    def send(self, message: JointTrajectory) -> DiagnosticStatus:
        """Publish a trajectory; return the event that reports its outcome."""
        before = len(self.answers())
        self.trajectories.publish(message)
        self._ros.until(lambda: len(self.answers()) > before, "an event")
        return self.answers()[-1]

    def answers(self) -> list[DiagnosticStatus]:
        """Return the events that are not caused by a lifecycle transition or by elapsed time."""
        return [event for event in self.events if event.name not in BY_ITSELF]

    def kinds(self) -> list[str]:
        return [event.name for event in self.events]


def trajectory(
    *points: tuple[float, Any], joints: tuple[str, ...] = ("joint1",), start: int = 0, **fields: Any
) -> JointTrajectory:
    """Return a trajectory of (time [s], positions) from the stamp `start` [ns]; fields: one row per point."""
    message = JointTrajectory(joint_names=list(joints))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(start, 10**9)
    for i, (t, q) in enumerate(points):
        point = JointTrajectoryPoint(positions=listed(q), **{name: listed(rows[i]) for name, rows in fields.items()})
        sec, nanosec = divmod(round(t * 1e9), 10**9)
        point.time_from_start.sec, point.time_from_start.nanosec = sec, nanosec
        message.points.append(point)
    return message


def listed(values: Any) -> list[float]:
    return [float(v) for v in (values if isinstance(values, (list, tuple)) else [values])]
