# SPDX-License-Identifier: Apache-2.0
"""A process that joins while it loads knows the others when its node is built, and leaves the domain on a signal."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from rclpy.node import Node
from std_msgs.msg import Empty

from nodes.harness import Ros
from time_limits import HANG

JOINING = """
import sys, time
from fjr_msgs_py.node import participant
participant.join()
while not participant._hidden.get_count_publishers("/other"):
    time.sleep(0.01)
print("discovered", flush=True)
"""
BUILDING = """
import rclpy
participant.initialise(None)
node = rclpy.create_node("real")
participant.hand_over()
print(node.count_publishers("/other"), participant.discovered_at() < time.monotonic() + participant.LATER, flush=True)
"""
SCHEDULING = """
import os
def scheduling():
    threads = [int(thread) for thread in os.listdir("/proc/self/task")]
    return {(os.sched_getscheduler(each), frozenset(os.sched_getaffinity(each))) for each in threads}
before = scheduling()
"""
COMPARING = "print(scheduling() == before, flush=True)"
WAITING = "sys.stdin.read()"


@contextmanager
def child(*code: str) -> Iterator[subprocess.Popen]:
    command = [sys.executable, "-c", "\n".join(code)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture
def other(ros: Ros) -> Node:
    node = ros.add(Node("other_node", context=ros.context))
    node.create_publisher(Empty, "/other", 1)
    return node


def starting(node: Node) -> list[str]:
    return [name for name in node.get_node_names() if name.startswith("_starting")]


def test_the_node_knows_at_once_whom_the_process_has_discovered_and_replaces_the_hidden_one(
    ros: Ros, other: Node
) -> None:
    with child(JOINING, BUILDING, WAITING) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "discovered\n"
        assert process.stdout.readline() == "1 True\n"
        ros.until(lambda: "real" in other.get_node_names() and not starting(other), "the real node alone")


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for policies and cores")
def test_joining_leaves_no_thread_with_another_policy_or_on_one_core(ros: Ros, other: Node) -> None:
    with child(SCHEDULING, JOINING, COMPARING, WAITING) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "discovered\n"
        assert process.stdout.readline() == "True\n"


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_after_joining_leaves_and_exits_with_0(ros: Ros, other: Node, number: signal.Signals) -> None:
    with child(JOINING, WAITING) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "discovered\n"
        ros.until(lambda: starting(other), "the hidden node")
        process.send_signal(number)
        _, output = process.communicate(timeout=HANG)
        assert (process.returncode, output) == (0, "")
        ros.until(lambda: not starting(other), "its end")
