# SPDX-License-Identifier: Apache-2.0
"""The v-dPBC tracking controller as a ROS 2 node: one effort command u(x, x, t) for every JointState."""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_core import TrackingLaw, config
from fjr_core.checks import Array
from fjr_msgs_py import names, process
from fjr_msgs_py.health import Health
from fjr_msgs_py.messages import EffortWriter, JointSample, JointStateWriter, MessageError, StateReader
from fjr_msgs_py.node_parameters import ParameterNode

from .tracker import Command, Tracker, is_sendable


class ControllerNode(ParameterNode):
    """Answers /joint_states with /effort_controller/commands and, stamped and named, /joint_commands.

    Publishes ~/reference and ~/tracking_error after each command. A message that is refused is not
    answered; an effort that is not finite is not sent.
    """

    def __init__(self, **node_kwargs: Any) -> None:
        super().__init__(names.CONTROLLER, config.controller_parameters, **node_kwargs)

    def build(self) -> None:
        """Make the law from the parameters and start to answer."""
        values = self.values
        self._robot = config.robot(values)
        law = TrackingLaw(self._robot, config.gains(values, self._robot.n), compile=values["compile"])
        self._tracker = Tracker(law, config.reference(values, self._robot.n), values["state_timeout"])
        self._tracker.warm_up()
        self._health = Health(self, ("states received", "states answered"))
        joints = values["joints"]
        self._reader = StateReader(joints)
        self._effort, self._command = EffortWriter(joints), JointStateWriter(joints)
        self._reference, self._error = JointStateWriter(joints), JointStateWriter(joints)
        self._last_stamp: int | None = None
        self._efforts = self.create_publisher(Float64MultiArray, names.EFFORT_COMMANDS, names.LATEST)
        self._commands = self.create_publisher(JointState, names.JOINT_COMMANDS, names.LATEST)
        self._references = self.create_publisher(JointState, names.REFERENCE, names.LATEST)
        self._errors = self.create_publisher(JointState, names.TRACKING_ERROR, names.LATEST)
        self.create_subscription(JointState, names.JOINT_STATES, self._on_state, names.LATEST)

    def stop(self) -> None:
        """Send a last zero effort and the counters."""
        if self._last_stamp is not None:
            self._send(self._last_stamp, np.zeros(self._robot.n))
        self._health.publish()
        process.flush(self._efforts, self._commands)

    def _on_state(self, message: JointState) -> None:
        self._health.count["states received"] += 1
        try:
            sample = self._reader.read(message)
        except MessageError as error:
            self._health.refuse("state", error)
            return
        x = self._robot.state(sample.q_l, sample.q_m, sample.dq_l, sample.dq_m)
        command = self._tracker.answer(sample.stamp, x, time.monotonic_ns())
        if command is None:
            self._health.warn("states older than the last", "dropped a state older than the last one")
        elif not is_sendable(command.u):
            self._health.warn("efforts not finite", f"effort {command.u.tolist()} is not finite: not sent")
        else:
            self._answer(sample, command)

    def _answer(self, sample: JointSample, command: Command) -> None:
        if command.restarted:
            self._health.warn("reference restarts", "the time of the states jumped back: the reference starts again")
        self._send(sample.stamp, command.u)
        self._last_stamp = sample.stamp
        self._health.count["states answered"] += 1
        q_ld, dq_ld = command.jets[0], command.jets[1]
        self._references.publish(self._reference.fill(sample.stamp, q_ld, dq_ld))
        self._errors.publish(self._error.fill(sample.stamp, sample.q_l - q_ld, sample.dq_l - dq_ld))

    def _send(self, stamp: int, u: Array) -> None:
        self._efforts.publish(self._effort.fill(u))
        self._commands.publish(self._command.fill(stamp, effort=u))


def main(args: list[str] | None = None) -> int:
    """Run the node until SIGINT or SIGTERM; return the exit code."""
    return process.run(ControllerNode, args)


if __name__ == "__main__":
    sys.exit(main())
