# SPDX-License-Identifier: Apache-2.0
"""A robot's URDF as a message that whoever comes later still gets."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import String

from ..names import LATCHED, ROBOT_DESCRIPTION


def publish_description(node: Node, urdf: str) -> Publisher:
    """Publish the URDF's text on robot_description, once; it stays as long as the publisher."""
    publisher = node.create_publisher(String, ROBOT_DESCRIPTION, LATCHED)
    publisher.publish(String(data=urdf))
    return publisher
