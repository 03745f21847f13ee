# SPDX-License-Identifier: Apache-2.0
"""The native loops: what differs from those in rclpy, a fault that is not silent, and independence of Python.

Other Python threads hold Python's lock (GIL) for milliseconds, NumPy and imports for longer. Here it is held until a
number of further states has been answered: a loop that waited for Python would never answer them. States are counted,
not timed.
"""

from __future__ import annotations

import ctypes
import os
import re
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray

from design.exports.c_program import built
from fjr_controller.native import controller_program
from fjr_core.runtime.events import KINDS
from fjr_msgs_py.native import program as native_program
from fjr_msgs_py.native.program import NativeError
from fjr_msgs_py.node.scheduling import SLICE, slice_of
from fjr_plant.host import NativePlantHost, RclpyPlantHost
from fjr_plant.native import plant_program
from fjr_plant.time_base import SendError
from nodes.harness import PATIENCE, Peer, Ros, nanoseconds, stamped
from nodes.plants import CommandLoop, numbers
from time_limits import HANG


def loop_of(node: Any) -> Any:
    return node._control._command_loop


def test_trajectories_arrive_in_a_participant_of_their_own_beside_the_native_loop(ros: Ros) -> None:
    """The thread of a participant that receives a trajectory of 20 MB would keep the states waiting."""
    node = ros.controller()
    assert loop_of(node).native

    def found() -> list[bytes]:
        return [
            bytes(info.endpoint_gid)[:12]
            for topic in ("/joint_states", "/fjr_controller/joint_trajectory")
            for info in node.get_subscriptions_info_by_topic(topic)
            if "fjr_controller" in info.node_name
        ]

    ros.until(lambda: len(set(found())) == 2, "the discovery of both subscriptions")


def test_listeners_have_every_answered_state_and_topics_for_observers_a_rate_of_their_own(ros: Ros, peer: Peer) -> None:
    certificates: list[Float64MultiArray] = []
    peer.create_subscription(Float64MultiArray, "fjr_controller/certificate", certificates.append, 10)
    node, heard = ros.controller(auxiliary_rate=100.0), []
    loop_of(node).add_listener(lambda sample, command: heard.append((sample.stamp, command.u[0])))
    for k in range(101):
        peer.state_publisher.publish(stamped(0.001 * k))
        ros.until(lambda k=k: len(peer.commands) == k + 1, "the command")
    ros.until(lambda: len(certificates) >= 10 and len(heard) == 101, "the certificates and all samples")
    assert heard == [(nanoseconds(message), message.effort[0]) for message in peer.commands]
    assert [nanoseconds(error) - 100 * 10**9 for error in peer.errors] == [k * 10_000_000 for k in range(11)]
    assert len(peer.references) == 11


def test_a_fault_in_the_thread_ends_the_node_with_the_stop_effort_and_one_sentence(ros: Ros, peer: Peer) -> None:
    node = ros.controller(on_stop="zero")
    assert peer.ask(stamped(0.0, [0.5, 0.4])).effort[0] != 0
    loop = loop_of(node)
    ffi = loop.program.ffi
    kinds = dict(ffi.typeof("struct fjr_step_functions").fields)
    loop._struct.step.step = fails = ffi.callback(kinds["step"].type, lambda *_: -1)  # noqa: F841
    peer.state_publisher.publish(stamped(0.001))
    ros.until(lambda: node.ended is not None, "the end")
    ros.until(lambda: len(peer.commands) == 2, "the last command")
    assert peer.commands[-1].effort[0] == 0
    assert node.state == "inactive"
    assert str(node.ended) == "the native command loop failed: the control step failed; the stop effort was sent"


def test_a_first_effort_that_only_one_topic_takes_is_followed_by_the_stop_effort(ros: Ros, peer: Peer) -> None:
    node = ros.controller(on_stop="zero")
    loop = loop_of(node)
    ffi, lib, publish = loop.program.ffi, loop.program.lib, loop._struct.publish

    def half(host: Any, output: int, message: Any) -> int:
        return int(lib.FJR_FAILED if output == lib.FJR_COMMANDS else publish(host, output, message))

    loop._struct.publish = refused = ffi.callback("int(void*, int32_t, const struct fjr_message*)", half)  # noqa: F841
    peer.state_publisher.publish(stamped(0.0, [0.5, 0.4]))
    ros.until(lambda: node.ended is not None, "the end")
    ros.until(lambda: peer.efforts and peer.efforts[-1].data[0] == 0, "the stop effort")


def test_without_headers_of_ros_the_same_c_runs_in_rclpy(ros: Ros, peer: Peer, monkeypatch, capfd) -> None:
    def options() -> None:
        raise NativeError("rcl.h is missing")

    monkeypatch.setattr(native_program, "ros_options", options)
    controller_program.cache_clear()
    try:
        node = ros.controller()
    finally:
        controller_program.cache_clear()
    assert not loop_of(node).native
    assert "in rclpy's executor instead of a native thread: rcl.h is missing\n" in capfd.readouterr().err
    assert peer.ask(stamped(0.0, [0.5, 0.4])).effort[0] != 0


def test_the_loop_in_rclpy_reads_the_other_byte_order(ros: Ros, peer: Peer) -> None:
    ros.controller(executor="events")
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


def test_a_node_restarts_its_thread_with_each_activation(ros: Ros, peer: Peer) -> None:
    node = ros.controller()
    loop = loop_of(node)
    for k in (1, 2):
        peer.answer(stamped(k))
        node.trigger_deactivate()
        ros.until(lambda k=k: len(peer.commands) == 2 * k, "the stop effort")
        node.trigger_activate()
        ros.meet()
    assert loop._host.runs
    ros.executor.remove_node(node)
    node.destroy_node()
    assert not loop._host.runs


def test_the_thread_has_short_slices_though_python_steps_back(ros: Ros) -> None:
    node = ros.controller(autostart=False)
    node.trigger_configure()
    os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))  # as the process of a node does
    try:
        before = set(os.listdir("/proc/self/task"))
        node.trigger_activate()
        (thread,) = (int(each) for each in set(os.listdir("/proc/self/task")) - before)
        Peer(ros)
        ros.meet()  # the thread runs
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    ros.until(lambda: os.sched_getscheduler(thread) == os.SCHED_OTHER, "the scheduling of the thread")
    assert slice_of(thread) in (SLICE, 0)  # 0: before Linux 6.12
    planner = node._control._interface.planner
    assert planner._worker.submit(os.sched_getscheduler, 0).result() == os.SCHED_BATCH


# Another thread holds Python's lock.


HELD, EARLY, LATER = 300, 700, 1500  # states: of a hold, of the first and the later instants
Hold = Callable[[Any, int], bool]


@pytest.fixture(scope="module")
def hold(tmp_path_factory: pytest.TempPathFactory) -> Hold:
    """Hold the GIL until a loop has answered a number of states in total; return whether it did."""
    source = Path(__file__).with_name("hold_gil.c")
    library = built(("cc", "-shared", "-fPIC", "-O1"), [source], tmp_path_factory.mktemp("gil") / "hold_gil.so")
    holding = ctypes.PyDLL(str(library)).hold_gil  # unlike CDLL, PyDLL does not release the GIL
    holding.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64]

    def until(loop: Any, answered: int) -> bool:
        ffi = loop.program.ffi
        address = int(ffi.cast("uintptr_t", ffi.addressof(loop._struct, "answered")))
        return bool(holding(address, answered, round(1000 * HANG / 20)))

    return until


@pytest.mark.parametrize("lockstep", [True, False], ids=["lock-step", "real time"])
def test_every_state_is_answered_while_the_lock_is_held(ros: Ros, hold: Hold, lockstep: bool) -> None:
    rng = np.random.default_rng(0)
    early, later = rng.integers(1, EARLY, 4), rng.integers(EARLY, LATER, 2)
    node = ros.controller(use_sim_time=lockstep)
    ros.plant(lockstep=lockstep, command_timeout=PATIENCE)
    loop = loop_of(node)
    for instant in sorted([*early, *later]):
        ros.until(lambda instant=instant: loop._struct.answered >= instant, f"state {instant}")
        assert hold(loop, loop._struct.answered + HELD), f"no states were answered after state {instant}"
    assert node.state == "active"
    stale = loop._struct.controller.journal.count[KINDS.index("states stale")]  # of a machine that was late itself
    assert not (lockstep and stale)
    assert loop._struct.received - loop._struct.answered - stale in (0, 1)  # the newest may be on its way


def test_the_first_state_is_answered_while_the_lock_is_held(ros: Ros, peer: Peer, hold: Hold) -> None:
    node = ros.controller()
    peer.state_publisher.publish(stamped(0.0))
    assert hold(loop_of(node), 1)


# Modules and memory.


COUNTER = Path(__file__).with_name("allocations.c")
MIDDLEWARE = re.compile(r"lib(stdc\+\+|fastcdr|fastrtps|fastdds|rmw|rcl|rcutils|tracetools)")
"""Libraries of ROS 2 and Fast DDS, and the one that has the operator new of C++."""


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Return the lines that nodes/alone.py prints: of modules, then thread, caller and number of allocations."""
    counter = built(("cc", "-shared", "-fPIC", "-O1"), [COUNTER], tmp_path_factory.mktemp("counter") / "counter.so")
    path = f"{Path(__file__).parents[1]}:{os.environ.get('PYTHONPATH', '')}"
    outside = {**os.environ, "LD_PRELOAD": str(counter), "PYTHONPATH": path}
    command = [sys.executable, "-m", "nodes.alone"]
    done = subprocess.run(command, env=outside, capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_no_module_is_loaded_while_the_controller_is_active(alone: list[str]) -> None:
    """An import takes up to 300 ms and locks the memory map, for which page faults of the loop wait."""
    assert alone[:2] == ["changed", "late:"]


@pytest.mark.parametrize("loop", ["fjr_controller", "fjr_plant"])
def test_the_thread_of_a_native_loop_allocates_only_in_the_middleware(alone: list[str], loop: str) -> None:
    found = [[Path(word).name for word in line.split()[:2]] for line in alone[2:]]  # thread by its library, and caller
    callers = {caller for thread, caller in found if thread.startswith(loop)}
    assert "libstdc++.so.6" in callers  # the counter sees this thread
    assert not [caller for caller in callers if not MIDDLEWARE.match(caller)]


# The plant.


SAMPLES = 300
BAD = {
    "imperfections__motor_coulomb_friction": [0.05],
    "imperfections__actuator_lag": [2e-3],
    "imperfections__motor_encoder_bits": [14.0],
    "imperfections__link_position_noise": [1e-4],
    "imperfections__link_velocity_noise": [1e-2],
    "imperfections__state_delay": 1.5e-3,
    "imperfections__state_jitter": 2e-3,
    "imperfections__state_loss": 0.1,
    "imperfections__state_repetition": 0.1,
    "imperfections__command_jitter": 1e-3,
    "imperfections__command_loss": 0.1,
    "imperfections__period_jitter": 0.4e-3,
}


def states_of(host: str, **parameters: Any) -> tuple[list[tuple[int, bytes]], dict[str, int]]:
    """Return the states of SAMPLES samples in lock-step, and the counters of the plant."""
    with Ros() as ros:
        peer = Peer(ros)
        options = {"lockstep": True, "start_paused": True, "advance_samples": SAMPLES}
        node = ros.plant(executor=host, **options, **parameters)
        assert isinstance(node._time_base.host, NativePlantHost if host == "native" else RclpyPlantHost)
        CommandLoop(peer).listen()
        assert peer.advance().success
        ros.settle()
        count = dict(node._health.count)
        for busy in ("states sent again", "answers to other states"):
            del count[busy]
        return numbers(peer.states), count


def test_both_hosts_send_the_same_bits_of_a_non_ideal_robot_in_lock_step_which_another_seed_changes() -> None:
    one, other = states_of("events", **BAD), states_of("native", **BAD)
    assert one == other
    assert len(one[0]) > SAMPLES / 2
    assert states_of("native", **BAD, imperfections__seed=1) != one


@pytest.mark.parametrize("lockstep", [False, True])
def test_a_fault_in_the_thread_ends_the_node_with_one_sentence(ros: Ros, peer: Peer, lockstep: bool, capfd) -> None:
    node = peer.plant(lockstep=lockstep)
    host = node._time_base.host
    assert isinstance(host, NativePlantHost)
    host._addresses[0] = plant_program().ffi.cast("void*", host.subscriptions[0].address)  # no publisher
    ros.until(lambda: node.ended, "the end")
    assert isinstance(node.ended, SendError)
    assert str(node.ended).startswith("a message could not be sent: rcl_publish_serialized_message returned")
    assert ros.until_said(capfd, "ended: ").count("ended: ") == 1


@pytest.mark.parametrize(
    ("node", "parameters", "why"),
    [
        (
            "plant",
            {"compile": False},
            "the plant is evaluated in Python (compile is false, engine is drake, or an own pl",
        ),
        ("plant", {"compile": True, "use_sim_time": True}, "the time comes from /clock"),
        ("controller", {"compile": False}, "the law or the observer is evaluated in Python"),
    ],
)
def test_the_reason_for_another_host_is_logged(
    ros: Ros, capfd, node: str, parameters: dict[str, Any], why: str
) -> None:
    made = getattr(ros, node)(executor="native", **parameters)
    assert not (loop_of(made).native if node == "controller" else isinstance(made._time_base.host, NativePlantHost))
    assert f"rclpy's executor instead of a native thread: {why}" in capfd.readouterr().err
