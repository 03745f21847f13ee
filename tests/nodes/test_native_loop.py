# SPDX-License-Identifier: Apache-2.0
"""The native command loop: what differs from the loop in rclpy, and a fault that is not silent."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from std_msgs.msg import Float64MultiArray

from fjr_controller.native import controller_program
from fjr_msgs_py.native import program as native_program
from fjr_msgs_py.native.program import NativeError
from fjr_msgs_py.node.scheduling import SLICE, slice_of
from nodes.harness import Listener, Peer, Ros, stamped
from time_limits import HANG

HOSTS = ("events", "native")


def loop_of(node: Any) -> Any:
    return node._control._command_loop


@pytest.mark.parametrize("host", HOSTS, indirect=True)
def test_trajectories_arrive_in_a_participant_of_their_own_beside_the_native_loop(ros: Ros, host: str) -> None:
    """The thread of a participant that receives a trajectory of 20 MB would keep the states waiting."""
    node = ros.controller(compile=True)
    assert loop_of(node).native == (host == "native")

    def found() -> list[bytes]:
        return [
            bytes(info.endpoint_gid)[:12]
            for topic in ("/joint_states", "/fjr_controller/joint_trajectory")
            for info in node.get_subscriptions_info_by_topic(topic)
            if "fjr_controller" in info.node_name
        ]

    ros.until(lambda: len(found()) == 2, "the discovery of both subscriptions")
    assert len(set(found())) == (2 if host == "native" else 1)


def test_every_answered_state_reaches_the_listeners_in_order(ros: Ros, peer: Peer) -> None:
    node = ros.controller(executor="native", compile=True, use_sim_time=True)
    heard = []
    loop_of(node).add_listener(lambda sample, command: heard.append((sample.stamp, command.u[0])))
    peer.meet_controller()
    for k in range(100):
        peer.ask(stamped(0.001 * k))
    ros.until(lambda: len(heard) == 100, "all samples")
    assert heard == [
        (message.header.stamp.sec * 10**9 + message.header.stamp.nanosec, message.effort[0])
        for message in peer.commands
    ]


@pytest.mark.parametrize("host", HOSTS, indirect=True)
def test_topics_for_observers_have_a_rate_of_their_own_in_real_time(ros: Ros, host: str) -> None:
    ros.controller(auxiliary_rate=100.0, compile=True)
    peer, certificates = Peer(ros), []
    peer.create_subscription(Float64MultiArray, "fjr_controller/certificate", certificates.append, 10)
    peer.meet_controller()
    for k in range(101):
        peer.state_publisher.publish(stamped(0.001 * k))
        ros.until(lambda k=k: len(peer.commands) == k + 1, "the command")
    ros.until(lambda: len(certificates) >= 10, "the certificates")
    stamps = [
        round((message.header.stamp.sec - 100) * 1e3 + message.header.stamp.nanosec * 1e-6) for message in peer.errors
    ]
    assert stamps == list(range(0, 101, 10))
    assert len(peer.references) == 11


def test_a_fault_in_the_thread_ends_the_node_with_the_stop_effort_and_one_sentence(ros: Ros, capfd) -> None:
    node = ros.controller(executor="native", compile=True, on_stop="zero")
    peer = Peer(ros)
    peer.meet_controller()
    assert peer.ask(stamped(0.0, [0.5, 0.4])).effort[0] != 0
    loop = loop_of(node)
    ffi = loop.program.ffi
    kinds = dict(ffi.typeof("struct fjr_step_functions").fields)
    fails = ffi.callback(kinds["step"].type, lambda *_: -1)
    loop._struct.step.step = fails
    peer.state_publisher.publish(stamped(0.001))
    ros.until(lambda: node.ended is not None, "the end")
    ros.until(lambda: len(peer.commands) == 2, "the last command")
    assert peer.commands[-1].effort[0] == 0
    assert node.state == "inactive"
    assert str(node.ended) == "the native command loop failed: the control step failed; the stop effort was sent"


def test_a_law_in_python_runs_in_rclpy_and_says_why(ros: Ros, capfd) -> None:
    node = ros.controller(executor="native", compile=False)
    assert not loop_of(node).native
    assert "the law or the observer is evaluated in Python" in capfd.readouterr().err


def test_without_headers_of_ros_the_same_c_runs_in_rclpy(ros: Ros, monkeypatch, capfd) -> None:
    def options() -> None:
        raise NativeError("rcl.h is missing")

    monkeypatch.setattr(native_program, "ros_options", options)
    controller_program.cache_clear()
    try:
        node = ros.controller(executor="native", compile=True)
    finally:
        controller_program.cache_clear()
    assert not loop_of(node).native
    assert "in rclpy's executor instead of a native thread: rcl.h is missing\n" in capfd.readouterr().err
    peer = Peer(ros)
    peer.meet_controller()
    assert peer.ask(stamped(0.0, [0.5, 0.4])).effort[0] != 0


def test_the_loop_in_rclpy_reads_the_other_byte_order(ros: Ros) -> None:
    ros.controller(executor="events", compile=True)
    peer = Peer(ros)
    peer.meet_controller()
    names, numbers = (b"joint1\0", b"joint1_motor\0"), (0.5, 0.4)
    data = struct.pack(">iiI4xI", 100, 0, 1, 2)  # stamp, an empty frame with its padding, two names
    for name in names:
        data += struct.pack(f">I{len(name) + -len(name) % 4}s", len(name), name)
    for _ in range(3):
        data += struct.pack(">I", 2)
        data += bytes(-len(data) % 8) + struct.pack(">2d", *numbers)
    peer.state_publisher.publish(b"\x00\x00\x00\x00" + data)
    ros.until(lambda: peer.commands, "the command")
    assert peer.commands[-1].header.stamp.sec == 100


def test_a_node_restarts_its_thread_with_each_activation(ros: Ros) -> None:
    node = ros.controller(executor="native", compile=True)
    peer = Peer(ros)
    peer.meet_controller()
    for k in (1, 2):
        peer.answer(stamped(k))
        node.trigger_deactivate()
        ros.until(lambda k=k: len(peer.commands) == 2 * k, "the stop effort")
        node.trigger_activate()
        peer.meet_controller()
    assert loop_of(node)._host.runs


def test_the_thread_has_short_slices_though_python_steps_back(ros: Ros) -> None:
    node = ros.controller(executor="native", compile=True, autostart=False)
    node.trigger_configure()
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # as the process of a node does
    try:
        before = set(os.listdir("/proc/self/task"))
        node.trigger_activate()
        (thread,) = (int(each) for each in set(os.listdir("/proc/self/task")) - before)
        Peer(ros).meet_controller()  # the thread runs
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    assert os.sched_getscheduler(thread) == os.SCHED_OTHER
    assert slice_of(thread) in (SLICE, 0)  # 0: before Linux 6.12
    planner = node._control._interface.planner
    assert planner._worker.submit(os.sched_getscheduler, 0).result() == os.SCHED_BATCH


def test_no_module_is_loaded_while_the_controller_is_active() -> None:
    """An import takes up to 300 ms and locks the memory map, for which page faults of the loop wait."""
    tests = str(Path(__file__).parents[1])
    outside = {**os.environ, "PYTHONPATH": f"{tests}:{os.environ.get('PYTHONPATH', '')}"}
    command = [sys.executable, "-m", "nodes.late_imports"]
    done = subprocess.run(command, env=outside, capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "changed\nlate:\n"


def test_a_destroyed_node_leaves_no_thread(ros: Ros) -> None:
    node = ros.controller(executor="native", compile=True)
    listener = Listener(ros)
    ros.until(lambda: listener.heard("joint_commands"), "the controller")
    ros.executor.remove_node(node)
    node.destroy_node()
    assert not loop_of(node)._host.runs
