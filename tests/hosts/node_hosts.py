# SPDX-License-Identifier: Apache-2.0
"""Efforts of a recorded sequence from running controller nodes: in rclpy, and in a native thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from fjr_controller.controller_node import ControllerNode
from fjr_msgs_py import names
from fjr_msgs_py.node.participant import leave
from hosts.inputs import Input, Kind, Sequence
from hosts.step_hosts import Efforts
from nodes.harness import EventsExecutor, subscriptions
from time_limits import Limit

EXECUTORS = {"rclpy": "events", "native": "native"}
"""Values of the parameter `executor` by host."""
LIMIT = 20.0  # s; timeout of an answer
RECORDS = 1000  # samples between two readings of the queue of a native loop
POLLS = 100  # of a native thread, between two events of its node
OPTIONS = {"realtime_priority": 0, "certificate": "false"}


class NodeHost:
    """A controller node, with a publisher of states and a listener to efforts in its namespace.

    A state is published once the last one was answered; or the callback of the command loop gets the message with its
    recorded time of arrival, so that no clock of this machine decides.
    """

    def __init__(self, context: Context, host: str, sequence: Sequence, file: Path) -> None:
        """Start the node with the parameters of the sequence, which are written to `file`."""
        self._context, self._host, self._sequence, self._file = context, host, sequence, file
        file.write_text(sequence.document, encoding="utf-8")
        self._peer = rclpy.create_node("peer", namespace=host, context=context, enable_rosout=False)
        self._states = self._peer.create_publisher(JointState, names.JOINT_STATES, names.LATEST)
        self._listener = self._peer.create_subscription(
            Float64MultiArray, names.EFFORT_COMMANDS, lambda _: None, QoSProfile(depth=1000)
        )
        self._heard: list[bytes] = []
        self._start()

    def efforts(self, counts: Iterable[int]) -> Efforts:
        """Feed the node with all inputs; return its efforts (k, n).

        counts: number of efforts after each input; an effort that does not come ends the replay.
        """
        for each, count in zip(self._sequence.repeated(), counts, strict=True):
            self._feed(each)
            if not self._until(lambda count=count: len(self._heard) >= count):
                break
        self._take()
        n = len(self._sequence.scenario.joints)
        return np.frombuffer(b"".join(raw[-8 * n :] for raw in self._heard)).reshape(-1, n)

    def close(self) -> None:
        """Destroy the nodes."""
        self._end()
        leave(self._peer)

    def _start(self) -> None:
        options = {**OPTIONS, "executor": EXECUTORS[self._host], "use_sim_time": str(self._sequence.simulated).lower()}
        words = [word for name, value in options.items() for word in ("-p", f"{name}:={value}")]
        arguments = ["--ros-args", "--params-file", str(self._file), *words, "-r", f"__ns:=/{self._host}"]
        self._node = ControllerNode(context=self._context, cli_args=arguments)
        self._loop: Any = self._node._control._command_loop
        self._native = self._host == "native"
        assert self._loop.native == self._native
        self._executor = EventsExecutor(context=self._context)
        if self._sequence.published:
            self._executor.add_node(self._node)
        else:
            self._loop._host.stop()  # the loop serves requests and messages of the caller
        states, answers = self._states, self._listener
        heard = [each for each in subscriptions(self._node) if each.topic_name == states.topic_name]  # by the loop
        sent = [each for each in self._node.publishers if each.topic_name == answers.topic_name]
        assert self._until(lambda: states.get_subscription_count() and all(one.get_publisher_count() for one in heard))
        assert self._until(lambda: answers.get_publisher_count() and all(one.get_subscription_count() for one in sent))

    def _end(self) -> None:
        self._executor.shutdown()
        self._node.destroy_node()

    def _feed(self, each: Input) -> None:
        tracker = self._node._control.step
        if each.kind is Kind.STATE:
            self._publish(each.raw) if self._sequence.published else self._deliver(each.raw, each.time)
        elif each.kind is Kind.TICK:
            self._loop.check_silence(each.time)
        elif each.kind is Kind.CHANGE:
            assert self._node.set_parameters_atomically(_parameters(each)).successful
        elif each.kind is Kind.PARAMETERS:
            self._refuses(each)
        elif each.kind is Kind.RESTART:
            self._end()
            self._start()
        else:
            {Kind.HOLD: tracker.hold, Kind.RESUME: tracker.resume}[each.kind]()

    def _publish(self, raw: bytes) -> None:
        before = self._received
        self._states.publish(raw)
        assert self._until(lambda: self._received > before)

    def _deliver(self, raw: bytes, arrival: int) -> None:
        program, struct = self._loop.program, self._loop._struct
        given = struct, 0, raw, len(raw), arrival, program.ffi.new("int64_t*")
        assert program.lib.fjr_controller_message(*given) == program.lib.FJR_GO_ON
        if self._received % RECORDS == 0:
            self._loop._drain()  # in simulated time a full queue would wait for this

    def _refuses(self, each: Input) -> None:
        for parameter in _parameters(each):
            with suppress(ParameterNotDeclaredException):
                assert not self._node.set_parameters([parameter])[0].successful

    @property
    def _received(self) -> int:
        """Number of states that the node has received."""
        return int(self._loop._struct.received)

    def _until(self, happened: Callable[[], Any]) -> bool:
        """Take efforts and let the node work until `happened()`; return False after the time limit."""
        limit, polls = None, 0
        self._take()
        while not happened():
            limit = limit or Limit(LIMIT)
            if limit.passed():
                return False
            polls += 1
            if self._sequence.published and (not self._native or polls % POLLS == 0):
                self._executor.spin_once(timeout_sec=0.0 if self._native else 0.01)
            self._take()
        return True

    def _take(self) -> None:
        while (taken := self._listener.handle.take_message(Float64MultiArray, True)) is not None:
            self._heard.append(taken[0])


def _parameters(each: Input) -> list[Parameter]:
    return [Parameter(name, value=value) for name, value in each.parameters.items()]
