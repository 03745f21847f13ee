# SPDX-License-Identifier: Apache-2.0
"""Names and QoS profiles that the nodes share; the names are relative, so that namespaces and remaps work."""

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

PLANT = "fjr_plant"
CONTROLLER = "fjr_controller"

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
RESET = "~/reset"
PAUSE = "~/pause"
ADVANCE = "~/advance"

LATEST = QoSProfile(depth=1)
"""States and commands: reliable, volatile, only the newest message is kept."""

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""Constant data: reliable, late subscribers receive the last message."""


def motor_name(joint: str) -> str:
    """Return the name of a joint's motor side in a JointState."""
    return f"{joint}_motor"


def full_name(node: Node) -> str:
    """Return the name of a node with its namespace, as in `left/fjr_plant`."""
    return str(node.get_fully_qualified_name()).lstrip("/")


def state_names(joints: tuple[str, ...]) -> list[str]:
    """Return the names of a full JointState: link sides, then motor sides."""
    return [*joints, *(motor_name(joint) for joint in joints)]
