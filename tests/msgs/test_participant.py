# SPDX-License-Identifier: Apache-2.0
"""A process that joins while it loads knows the others when its node is built, and leaves the domain in any event."""

from __future__ import annotations

import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from rclpy.node import Node
from std_msgs.msg import Empty

from fjr_msgs_py.native.program import ros_options
from nodes.harness import Ros
from program_cache import built
from time_limits import HANG

JOINING = """
import os, sys, time
from fjr_msgs_py.node import participant
os.getloadavg = lambda: (0.0, 0.0, 0.0)  # as on a quiet machine
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
EXCHANGING = """
import time
from contextlib import contextmanager
from pathlib import Path
import rclpy
from rclpy.context import Context
from std_msgs.msg import Empty
from fjr_core.config.process import process_parameters
from fjr_msgs_py.node.parameters import ParameterNode
from fjr_msgs_py.node.participant import own_node

class Here(ParameterNode):
    def build(self):
        pass

@contextmanager
def as_parameter_node():
    rclpy.init()
    yield Here("here", lambda n: process_parameters())

def woken():
    threads = [path for path in Path("/proc/self/task").iterdir() if (path / "comm").read_text().startswith("dds.shm")]
    statuses = [(path / "status").read_text().splitlines() for path in threads]
    return sum(int(line.split()[1]) for status in statuses for line in status if line.startswith("voluntary_ctxt"))

with NODE as here:
    context = Context()
    rclpy.init(context=context)
    there = rclpy.create_node("there", context=context)
    publisher = here.create_publisher(Empty, "/message", 1)
    subscription = there.create_subscription(Empty, "/message", lambda _: None, 1)
    while not (publisher.get_subscription_count() and subscription.get_publisher_count()):
        time.sleep(0.01)
    before = woken()
    for _ in range(100):
        publisher.publish(Empty())
        while subscription.handle.take_message(Empty, False) is None:
            pass
    print(min(100, woken() - before), "woken", flush=True)
import os
os._exit(0)
"""
LEAVING = """
import ctypes, os, signal, sys, time
import rclpy
from fjr_msgs_py.node.participant import own_node
signal.alarm(120)  # ends this process even where Python does not run any more
slow = ctypes.CDLL(sys.argv[1])
for _ in range(5):
    with own_node("leaving"):
        before = slow.callbacks_begun()
        slow.listen_slowly(int(os.environ["ROS_DOMAIN_ID"]))
        while slow.callbacks_begun() < before + 2:
            time.sleep(0.001)
"""


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


def test_a_signal_after_joining_leaves_and_exits_with_0(ros: Ros, other: Node) -> None:
    with child(JOINING, WAITING) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "discovered\n"
        ros.until(lambda: starting(other), "the hidden node")
        process.send_signal(signal.SIGTERM)
        _, output = process.communicate(timeout=HANG)
        assert (process.returncode, output) == (0, "")
        ros.until(lambda: not starting(other), "its end")


def test_a_participant_leaves_while_discovery_callbacks_run(ros: Ros, tmp_path: Path) -> None:
    """Without `stop_discovery` the wheels' Fast DDS waits forever, in one of two rounds, for a callback to end."""
    include, *_, lib = (option for option in ros_options() if option[:2] in ("-I", "-L"))
    options = (f"-I{Path(include[2:]).parent}", lib, "-Wl,--no-as-needed,-l:libfastrtps.so,--allow-shlib-undefined")
    source, command = Path(__file__).with_name("slow_listener.cpp"), ("c++", "-std=c++17", "-shared", "-fPIC")
    library = built(command, [source], tmp_path / "slow.so", *options)
    joining = ros.add(Node("joining", context=ros.context))
    with subprocess.Popen([sys.executable, "-c", LEAVING, str(library)]) as process:
        while process.poll() is None:
            publisher = joining.create_publisher(Empty, "/message", 1)
            ros.executor.spin_once(timeout_sec=0.004)
            joining.destroy_publisher(publisher)
    assert process.returncode == 0


@pytest.mark.skipif(sys.platform != "linux", reason="asks Linux for threads")
@pytest.mark.parametrize("node", ["own_node('here')", "as_parameter_node()"])
def test_participants_of_one_process_exchange_messages_through_their_receiving_threads(
    monkeypatch: pytest.MonkeyPatch, node: str
) -> None:
    """With the delivery within a process the sender's thread would run callbacks of the receiver under its locks."""
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")
    with child(EXCHANGING.replace("NODE", node)) as process:
        output, _ = process.communicate(timeout=HANG)
    assert (process.returncode, output) == (0, "100 woken\n")
