# SPDX-License-Identifier: Apache-2.0
"""Names, QoS profiles and the steady clock that the nodes share.

The names are relative, so that namespaces and remaps work.
"""

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from fjr_core.numerics.checks import MOTOR

JOINT_STATES = "joint_states"
EFFORT_COMMANDS = "effort_controller/commands"
JOINT_COMMANDS = "joint_commands"
REFERENCE = "~/reference"
TRACKING_ERROR = "~/tracking_error"
CERTIFICATE = "~/certificate"
DIAGNOSTICS = "/diagnostics"  # absolute, as diagnostic monitors expect it
EVENTS = "~/events"
JOINT_TRAJECTORY = "~/joint_trajectory"
FOLLOW_JOINT_TRAJECTORY = "~/follow_joint_trajectory"
HOLD = "~/hold"
PLAY = "~/play"
RESUME = "~/resume"

ROBOT_DESCRIPTION = "robot_description"
CLOCK = "/clock"
EXTERNAL_TORQUE = "~/external_torque"
CONTACT = "~/contact"
CONTACT_TORQUE = "~/contact_torque"
RESET = "~/reset"
PAUSE = "~/pause"
ADVANCE = "~/advance"

STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock of timers in real time, which may be those of a node in simulated time."""

LATEST = QoSProfile(depth=1)
"""States and commands: reliable, volatile, only the newest message is kept."""

HISTORY = QoSProfile(depth=5000)
"""Samples in simulated time: reliable, volatile, sent again to a recorder that had no core; lock-step waits for it."""

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Constant data: reliable, late subscribers receive the last message."""


WRENCH = ("force_x", "force_y", "force_z", "moment_x", "moment_y", "moment_z")
"""Names in CONTACT, after the joints, of the force on the arm [N] and its moment [N m] about the origin of the base."""


def motor_name(joint: str) -> str:
    """Return the name of a joint's motor side in a JointState."""
    return f"{joint}{MOTOR}"


def contact_names(joints: tuple[str, ...]) -> list[str]:
    """Return the names in CONTACT_TORQUE: joints, then the thresholds of their torques."""
    return [*joints, *(f"{joint}_threshold" for joint in joints)]


def sample_qos(node: Node, lock_step: bool = False) -> QoSProfile:
    """Return the QoS of a publisher of samples: HISTORY in lock-step or with use_sim_time, else LATEST.

    In real time an old sample is of no use, and sending it again would delay the newest one. Simulated time may run
    many times faster than real time, and every sample of it counts.
    """
    return HISTORY if lock_step or node.get_parameter("use_sim_time").value else LATEST


def full_name(node: Node) -> str:
    """Return the name of a node with its namespace, as in `left/fjr_plant`."""
    return str(node.get_fully_qualified_name()).lstrip("/")


def state_names(joints: tuple[str, ...]) -> list[str]:
    """Return the names of a full JointState: link sides, then motor sides."""
    return [*joints, *(motor_name(joint) for joint in joints)]
