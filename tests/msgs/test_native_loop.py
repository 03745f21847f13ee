# SPDX-License-Identifier: Apache-2.0
"""The thread of a native loop: messages, ticks, requests, failure and end, with real publishers."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.node import Node
from sensor_msgs.msg import JointState

from fjr_msgs_py.messages.cdr import joint_state
from fjr_msgs_py.names import LATEST
from fjr_msgs_py.native.loop import NativeLoop, NativeMessage, NativeReader, NativeSubscription, Ring
from fjr_msgs_py.native.program import Program
from fjr_msgs_py.node.participant import leave
from time_limits import HANG, Limit

NAMES = ["one", "two"]
CAPACITY = 4


@cache
def program() -> Program:
    header, source = (Path(__file__).with_name(f"echo_host.{kind}").read_text() for kind in "hc")
    return Program("fjr_test_echo", [header], [source])


class Echo:
    """A node with the echo host, and a peer in the same context."""

    def __init__(self) -> None:
        ffi, lib = program().ffi, program().lib
        self.context = Context()
        rclpy.init(context=self.context)
        self.node, self.peer = (Node(name, context=self.context) for name in ("echo", "peer"))
        self.subscription = NativeSubscription(self.node, JointState, "states", LATEST)
        self.publisher = self.node.create_publisher(JointState, "answers", LATEST)
        self.reader, self.ring = NativeReader(program(), NAMES, 4), Ring(program(), "int64_t", CAPACITY)
        self.answer = NativeMessage(program(), joint_state(NAMES, (0, 0, 2)))
        self.state = ffi.new("struct echo*")
        echo = {f"on_{name}": ffi.addressof(lib, f"echo_{name}") for name in ("message", "tick", "request", "end")}
        self.loop = NativeLoop(program(), {"self": self.state, **echo}, [self.subscription])
        self.loop.use([self.publisher])
        self.state.loop, self.state.reader, self.state.answer = (
            self.loop.pointer,
            self.reader.pointer,
            self.answer.pointer,
        )
        self.state.ring = self.ring.pointer
        self.states = self.peer.create_publisher(JointState, "states", LATEST)
        self.answers = self.peer.create_subscription(JointState, "answers", lambda _: None, LATEST)
        self.until(lambda: self.states.get_subscription_count() and self.subscription.publishers)
        self.until(lambda: self.publisher.get_subscription_count() and self.answers.get_publisher_count())

    def until(self, happened) -> object:
        limit = Limit(10.0)
        while not (found := happened()):
            assert not limit.passed()
            time.sleep(0.001)
        return found

    def send(self, k: int) -> None:
        message = JointState(name=NAMES, effort=[0.5 * k, -k])
        message.header.stamp.sec = k
        self.states.publish(message)

    def answered(self) -> JointState:
        with self.answers.handle:
            return self.until(lambda: self.answers.handle.take_message(JointState, False))[0]

    def close(self) -> None:
        self.loop.close()
        self.node.destroy_node()
        leave(self.peer)
        self.context.try_shutdown()


@pytest.fixture
def echo() -> Iterator[Echo]:
    made = Echo()
    yield made
    made.close()


@pytest.mark.skipif(len(os.sched_getaffinity(0)) < 2, reason="one core")
def test_a_loop_whose_priority_is_refused_keeps_to_the_core_that_python_has_left(echo) -> None:
    cores = os.sched_getaffinity(0)
    before = {int(thread) for thread in os.listdir("/proc/self/task")}
    os.sched_setaffinity(0, cores - {max(cores)})
    try:
        echo.loop.start(1000)  # no system grants it
        (started,) = {int(thread) for thread in os.listdir("/proc/self/task")} - before
        echo.until(lambda: os.sched_getaffinity(started) == {max(cores)})
    finally:
        os.sched_setaffinity(0, cores)
    echo.send(1)
    assert echo.answered().header.stamp.sec == 1


def test_records_come_in_order_and_those_without_a_place_are_counted(echo) -> None:
    echo.loop.start()
    for k in range(1, CAPACITY + 3):
        echo.send(k)
        echo.answered()
    assert [stamp // 10**9 for stamp in echo.ring.take(1)] == [1]
    assert [stamp // 10**9 for stamp in echo.ring.take()] == list(range(2, CAPACITY + 1))
    assert (len(echo.ring.take()), echo.ring.lost) == (0, 2)


def test_the_first_round_of_a_queue_meets_no_page_fault() -> None:
    def faults() -> int:
        return resource.getrusage(resource.RUSAGE_THREAD).ru_minflt

    ring = Ring(program(), "int64_t", 1 << 20)
    before = faults()
    ring._slots.fill(1)
    assert faults() - before < ring._slots.nbytes // resource.getpagesize() // 10


def test_messages_from_before_the_start_and_after_the_end_are_ignored(echo) -> None:
    echo.send(1)
    assert echo.states.wait_for_all_acked(Duration(seconds=HANG))
    echo.loop.start()
    echo.send(2)
    assert echo.answered().header.stamp.sec == 2
    echo.loop.stop()
    echo.send(3)
    assert echo.states.wait_for_all_acked(Duration(seconds=HANG))
    echo.loop.start()
    echo.send(4)
    assert echo.answered().header.stamp.sec == 4
    assert (echo.state.messages, echo.state.ends) == (2, 1)


def test_requests_are_answered_by_the_thread_and_without_one_by_the_caller(echo) -> None:
    runs = []
    for change in (echo.loop.start, echo.loop.stop):
        echo.loop.request(7)
        runs.append((echo.state.requests, echo.state.by_thread))
        change()
        echo.loop.request(8)
        runs.append((echo.state.requests, echo.state.by_thread))
    assert runs == [(1, 0), (2, 1), (3, 1), (4, 0)]


def test_a_failure_ends_the_thread(echo) -> None:
    echo.state.fault = 3
    echo.loop.start()
    for k in (1, 2, 3):
        echo.send(k)
        echo.until(lambda k=k: echo.state.messages == k)
    echo.until(lambda: not echo.loop.runs)
    assert echo.state.ends == 11
    echo.loop.request(5)
    assert echo.state.requests == 1


def test_a_running_thread_outlives_the_destruction_of_its_node(echo) -> None:
    echo.loop.start()
    echo.node.destroy_node()
    echo.send(1)
    assert echo.answered().header.stamp.sec == 1
