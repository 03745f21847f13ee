# SPDX-License-Identifier: Apache-2.0
"""Bare rclpy nodes with the messages of our nodes but no computation, each in its own process, and a robot driver.

    python -m bench.bare echo|ping|pong --ros-args ...
    python -m bench.bare driver --ros-args -p rounds:=3 -p sides:="[ours, bare]" -p position:="[...]"

They have the executor, garbage collection and priority of our nodes (fjr_msgs_py.node.process) and reuse messages: the
cost of ROS. The driver sends states at 1 kHz and measures the time until the effort arrives. Blocks of states go to the
sides (namespaces) in turns; a state waits for the effort of the previous one. It prints JSON: for each side its rounds,
each a list of the times [us]. Its states and efforts pass a native loop (driver.c), so that the times are those of the
nodes under test.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from fjr_core.config.process import process_parameters
from fjr_msgs_py import names
from fjr_msgs_py.messages.cdr import joint_state
from fjr_msgs_py.native.loop import NativeLoop, NativeMessage, NativeSubscription
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node import process

JOINTS = tuple(f"joint{i}" for i in range(1, 8))
PERIOD = 1_000_000  # ns
RESEND = 0.1  # s
BLOCK = 250  # consecutive states of the driver to one side
BLOCKS = 4  # of each side per round
LONGEST = 100_000_000  # ns; timeout of an effort
LOOK_PERIOD = 0.05  # s


class Bare(Node):
    """A node with the process parameters of our nodes, and without what ends them (EndingNode)."""

    host: process.NodeProcess | None = None
    ended = None

    def __init__(self, name: str) -> None:
        self.over = Future()  # never done: signals end the process
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


class Driver(Bare):
    """Publish <side>/joint_states and subscribe to <side>/effort_controller/commands."""

    def build(self) -> None:
        """Create the endpoints and the loop, which starts once all peers are connected."""
        self._sides: list[str] = list(self.get_parameter("sides").value)
        self._rounds = self.get_parameter("rounds").value + 1  # the first is discarded
        self._states = [self.publisher(f"{side}/{names.JOINT_STATES}") for side in self._sides]
        topics = [f"{side}/{names.EFFORT_COMMANDS}" for side in self._sides]
        self._efforts = [NativeSubscription(self, Float64MultiArray, topic, names.LATEST) for topic in topics]
        self._times = np.zeros(self._rounds * BLOCKS * BLOCK * len(self._sides))
        self._loop = self._native_loop()
        self._started = False
        self.every(LOOK_PERIOD, self._look)

    def stop(self) -> None:
        """End the loop and print the measured times."""
        self._loop.stop()
        print(json.dumps(rounds(self._times, self._sides, self._rounds)), flush=True)

    def _native_loop(self) -> NativeLoop:
        texts = {kind: Path(__file__).with_name(f"driver.{kind}").read_text(encoding="utf-8") for kind in "hc"}
        program = Program("bench_driver", [texts["h"]], [texts["c"]])
        ffi, n = program.ffi, 2 * len(JOINTS)
        self._message = NativeMessage(program, joint_state(names.state_names(JOINTS), (n, n, n)))
        position = np.array(self.get_parameter("position").value)
        program.lib.fjr_put_numbers(self._message.pointer, 0, ffi.from_buffer("double[]", position))
        self._struct = ffi.new(
            "struct driver*",
            {
                "state": self._message.pointer,
                "period": PERIOD,
                "longest": LONGEST,
                "sides": len(self._sides),
                "block": BLOCK,
                "total": len(self._times),
                "times": ffi.from_buffer("double[]", self._times),
            },
        )
        functions = ("message", "tick", "request", "end")
        driver = {f"on_{name}": ffi.addressof(program.lib, f"driver_{name}") for name in functions}
        loop = NativeLoop(program, {"self": self._struct, **driver}, self._efforts)
        loop.use(self._states)
        self._struct.loop = loop.pointer
        return loop

    def _look(self) -> None:
        connected = all(states.get_subscription_count() for states in self._states)
        if not self._started and connected and all(efforts.publishers for efforts in self._efforts):
            self._started = True
            self._loop.start()
        elif self._started and not self._loop.runs:
            os.kill(os.getpid(), signal.SIGINT)


def rounds(times: NDArray[np.float64], sides: Sequence[str], count: int) -> dict[str, list[list[float]]]:
    """Return the times of each side by round, without the first round; blocks of the sides alternate."""
    blocks = np.reshape(times, (count, BLOCKS, len(sides), BLOCK))
    return {side: blocks[1:, :, k].reshape(count - 1, -1).tolist() for k, side in enumerate(sides)}


KINDS = {"echo": Echo, "ping": Ping, "pong": Pong, "driver": Driver}

if __name__ == "__main__":
    kind = sys.argv[1]
    sys.exit(process.run(lambda: KINDS[kind](f"bare_{kind}"), sys.argv[2:]))
