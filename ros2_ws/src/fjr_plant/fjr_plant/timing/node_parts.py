# SPDX-License-Identifier: Apache-2.0
"""Components of the plant node that each time base uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rclpy.node import Node

from fjr_msgs_py.messages.joint_states import EffortReader
from fjr_msgs_py.node.diagnostics import Health

from ..channel import Transport
from ..simulated_robot import SimulatedRobot


@dataclass(frozen=True)
class NodeParts:
    """Components of the plant node."""

    node: Node
    values: dict[str, Any]
    robot: SimulatedRobot
    transport: Transport
    reader: EffortReader
    health: Health
