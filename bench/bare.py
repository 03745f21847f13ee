# SPDX-License-Identifier: Apache-2.0
"""Bare rclpy nodes with the messages of our nodes but no computation, each in its own process: the cost of ROS.

    python -m bench.bare echo|ping|pong --ros-args ...

They have the executor, garbage collection and priority of our nodes (fjr_msgs_py.node.process) and reuse messages.
"""

from __future__ import annotations

import sys
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from fjr_core.config.process import process_parameters
from fjr_msgs_py import names
from fjr_msgs_py.node import process

JOINTS = tuple(f"joint{i}" for i in range(1, 8))
PERIOD = 1_000_000  # ns
RESEND = 0.1  # s


class Bare(Node):
    """A node with the process parameters of our nodes, and without what ends them (EndingNode)."""

    host: process.NodeProcess | None = None
    ended = None

    def __init__(self, name: str) -> None:
        super().__init__(name, automatically_declare_parameters_from_overrides=True)
        given = {key: value.value for key, value in self.get_parameters_by_prefix("").items()}
        self.values: dict[str, Any] = {p.name: given.get(p.name, p.default) for p in process_parameters()}
        self.build()

    def build(self) -> None:
        """Create publishers, subscriptions and timers."""

    def stop(self) -> None:
        """Do nothing on shutdown."""

    def publisher(self, topic: str, kind: Any = JointState) -> Publisher:
        """Create a publisher with the QoS of our nodes."""
        return self.create_publisher(kind, topic, names.LATEST)

    def every(self, seconds: float, call: Any) -> None:
        """Create a timer of the steady clock."""
        self.create_timer(seconds, call, clock=Clock(clock_type=ClockType.STEADY_TIME))


class Echo(Bare):
    """Reply to a JointState with the four messages of the controller."""

    def build(self) -> None:
        """Create the endpoints of the controller node."""
        self._effort = Float64MultiArray()
        self._effort.layout.dim = [MultiArrayDimension(label=",".join(JOINTS), size=7, stride=7)]
        self._command, self._reference, self._error = (JointState(name=JOINTS) for _ in range(3))
        self._efforts = self.publisher(names.EFFORT_COMMANDS, Float64MultiArray)
        self._commands = self.publisher(names.JOINT_COMMANDS)
        self._references, self._errors = self.publisher(names.REFERENCE), self.publisher(names.TRACKING_ERROR)
        self.create_subscription(JointState, names.JOINT_STATES, self._reply, names.LATEST)

    def _reply(self, message: JointState) -> None:
        position, velocity, effort = message.position[:7], message.velocity[:7], message.effort[:7]
        self._effort.data = effort
        self._efforts.publish(self._effort)
        self._command.header.stamp, self._command.effort = message.header.stamp, effort
        self._commands.publish(self._command)
        for values, publisher in ((self._reference, self._references), (self._error, self._errors)):
            values.header.stamp, values.position, values.velocity = message.header.stamp, position, velocity
            publisher.publish(values)


class Ping(Bare):
    """Send a JointState, and the next, one period later by its stamp, on the reply."""

    def build(self) -> None:
        """Create the endpoints of the plant node in lock-step."""
        zeros = [0.0] * 14
        self._state = JointState(name=names.state_names(JOINTS), position=zeros, velocity=zeros, effort=zeros)
        self._sent = self._seen = 0
        self._states = self.publisher(names.JOINT_STATES)
        self.create_subscription(JointState, names.JOINT_COMMANDS, self._send, names.LATEST)
        self.every(RESEND, self._resend)

    def _send(self, _: JointState | None) -> None:
        self._sent += 1
        stamp = self._state.header.stamp
        stamp.sec, stamp.nanosec = divmod(self._sent * PERIOD, 1_000_000_000)
        self._states.publish(self._state)

    def _resend(self) -> None:
        if self._sent == self._seen:
            self._send(None)
        self._seen = self._sent


class Pong(Bare):
    """Reply to a JointState with a JointState of efforts."""

    def build(self) -> None:
        """Create the endpoints of the controller node, commands only."""
        self._command = JointState(name=JOINTS)
        self._commands = self.publisher(names.JOINT_COMMANDS)
        self.create_subscription(JointState, names.JOINT_STATES, self._reply, names.LATEST)

    def _reply(self, message: JointState) -> None:
        self._command.header.stamp, self._command.effort = message.header.stamp, message.effort[:7]
        self._commands.publish(self._command)


KINDS = {"echo": Echo, "ping": Ping, "pong": Pong}

if __name__ == "__main__":
    kind = sys.argv[1]
    sys.exit(process.run(lambda: KINDS[kind](f"bare_{kind}"), sys.argv[2:]))
