# SPDX-License-Identifier: Apache-2.0
"""Publish samples of the plant on /joint_states."""

from __future__ import annotations

from rclpy.node import Node
from sensor_msgs.msg import JointState

from fjr_core.numerics.checks import Array
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import JointStateWriter

Sample = tuple[int, Array, Array, Array]
"""Stamp [ns], positions, velocities, efforts: (2n,) each, or (0,) if not measured."""


class StatePublisher:
    """Publisher of samples on /joint_states."""

    def __init__(self, node: Node, joints: tuple[str, ...]) -> None:
        self._writer = JointStateWriter(names.state_names(joints))
        self._publisher = node.create_publisher(JointState, names.JOINT_STATES, names.LATEST)
        self._message = b""

    def send(self, sample: Sample) -> None:
        """Publish a sample."""
        self._message = self._writer.fill(*sample)
        self._publisher.publish(self._message)

    def send_again(self) -> None:
        """Publish the last sample again, unchanged."""
        self._publisher.publish(self._message)
