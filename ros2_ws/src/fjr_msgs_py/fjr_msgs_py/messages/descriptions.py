# SPDX-License-Identifier: Apache-2.0
"""URDF of a robot as a latched message."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import String

from ..names import LATCHED, ROBOT_DESCRIPTION


def publish_description(node: Node, urdf: str) -> Publisher:
    """Publish the URDF once on robot_description; late subscribers receive it while the publisher exists."""
    publisher = node.create_publisher(String, ROBOT_DESCRIPTION, LATCHED)
    publisher.publish(String(data=urdf))
    return publisher
