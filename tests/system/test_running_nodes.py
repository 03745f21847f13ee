# SPDX-License-Identifier: Apache-2.0
"""Commands for running nodes: `fjr echo`, `record`, `call`, `set`, `lifecycle` and `send`; which ros2 replaces them."""

from __future__ import annotations

import shlex
import signal
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest
import yaml
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rosbags.highlevel import AnyReader

from fjr_bringup import clients
from fjr_bringup.clients import ServiceClient
from fjr_monitor.recording.bag import read_bag
from fjr_msgs_py.console.ros2 import play_command
from nodes.harness import Listener, Ros
from system.bags import STORE
from system.executables import SLOW, TIME_LIMIT, Start, documented_keys, fjr_here, fjr_json, running, wait_for
from time_limits import Limit

pytestmark = pytest.mark.system
WAIT = ("--timeout", "600")  # s
CONTROLLER, PLANT = "/left/fjr_controller", "/left/fjr_plant"
T = np.arange(1001) / 1000  # s
MOTION = 0.5 * (1 - np.cos(3 * T)) ** 3
HOLDING = ("-p", "reference.type:=hold", "-p", "limits.acceleration:=[200.0]")


def holding(loop: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Return the ROS arguments of a loop whose controller holds the arm until a motion is sent."""
    return {**loop, "controller": (*loop["controller"], *HOLDING)}


@pytest.fixture(scope="module")
def loop() -> Iterator[None]:
    """Plant and controller under /left, for all tests of this file."""
    with running(holding(SLOW), "-r", "__ns:=/left"):
        yield


def test_echo_prints_messages_as_yaml_latched_ones_too(loop: None) -> None:
    said = fjr_here("echo", "/left/joint_states", "--count", "3", *WAIT)
    printed = "".join(line for line in said.splitlines(keepends=True) if not line.startswith("fjr: "))  # of its wait
    first, *others = yaml.safe_load_all(printed.rstrip().removesuffix("---"))
    assert len(others) == 2
    assert first["name"] == ["joint1", "joint1_motor"]
    assert len(first["position"]) == len(first["velocity"]) == len(first["effort"]) == 2
    said = fjr_here("echo", "left/robot_description", "--once", *WAIT)
    assert '<robot name="single_link">' in yaml.safe_load(said.split("---")[0])["data"]


def test_echo_without_messages_lists_the_topics(loop: None) -> None:
    fjr_here("echo", "left/joint_states", "--once", *WAIT)
    limit, said = Limit(TIME_LIMIT), ""
    while "/left/joint_states" not in said:  # topics discovered within 3 s depend on the machine
        assert not limit.passed(), said
        said = fjr_here("echo", "/nothing", "--timeout", "3", code=1)
        assert "no message of /nothing for 3 s" in said


def test_record_keeps_the_named_topics_and_overwrites_nothing(loop: None, tmp_path: Path) -> None:
    fjr_here("echo", "left/joint_commands", "--once", *WAIT)
    named, output = ("left/joint_states", "/left/joint_commands", "/other"), ("--output", str(tmp_path / "bag"))
    said = fjr_here("record", *named, "--duration", "5", *output)
    assert "nothing came on /other" in said
    assert "messages of 2 topics" in said
    with AnyReader([tmp_path / "bag"], default_typestore=STORE) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert set(counts) == {"/left/joint_states", "/left/joint_commands"}
        assert reader.duration > 4.5e9, "5 s count from the first message on, not from the start of the command"
        connection, _, raw = next(reader.messages())
        assert np.isfinite(reader.deserialize(raw, connection.msgtype).effort).all()
    assert "not overwritten" in fjr_here("record", *output, code=1)


def test_record_of_all_topics_ends_with_ctrl_c(loop: None, start: Start, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    command = start("fjr", "record", "--output", str(bag))
    wait_for(lambda: any(bag.glob("*.mcap")) and read_bag(bag).holds("/left/joint_states"), "a state in the bag")
    command.signal(signal.SIGINT)
    code, said = command.end()
    assert code == 0, said
    assert "/left/joint_states (sensor_msgs/msg/JointState)" in said
    assert (bag / "metadata.yaml").is_file()


REPLACED = {
    "echo /joint_states": "ros2 topic echo /joint_states",
    "record": "ros2 bag record --storage mcap --all",
    "record /a /b": "ros2 bag record --storage mcap /a /b",
    "play bag /a": "ros2 bag play bag --topics /a",
    "call /a '{data: true}'": "ros2 service call /a TYPE '{data: true}'",
    "set /a b -0.5": "ros2 param set /a b -0.5",
    "lifecycle /a": "ros2 lifecycle get /a",
    "lifecycle /a activate": "ros2 lifecycle set /a activate",
}


def test_installed_ros2_is_recommended_instead_without_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as without:
        without.setenv("PATH", str(tmp_path))
        assert play_command(Path("my bag")) == "fjr play 'my bag'"
    (tmp_path / "ros2").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "ros2").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    assert play_command(Path("my bag")) == "ros2 bag play 'my bag'"
    for line, better in REPLACED.items():
        said = fjr_here(*shlex.split(line), code=1)
        assert f"use `{better}`" in said
        assert "--force" in said
    assert "no message of /nothing" in fjr_here("echo", "/nothing", "--timeout", "0.5", "--force", code=1)


def test_request_is_a_mapping_or_the_only_value_and_may_be_refused(loop: None) -> None:
    said = fjr_json("call", "left/fjr_plant/pause", "{data: true}", *WAIT)
    assert said["success"] is True
    assert "paused" in said["message"]
    assert "running" in fjr_here("call", "left/fjr_plant/pause", "false", *WAIT)
    said = fjr_here("call", f"{PLANT}/advance", *WAIT, code=1)  # the robot is not paused
    assert f"fjr: {PLANT}/advance refused: " in said


def test_parameter_takes_the_value_in_the_declared_type(loop: None, ros: Ros) -> None:
    asked = Listener(ros, only=[])
    for parameter, text, sent in (
        ("imperfections.state_loss", "0", 0.0),  # an integer where the node declares a double
        ("imperfections.motor_coulomb_friction", "[0.01]", [0.01]),
        ("advance_samples", "7", 7),
    ):
        said = fjr_json("set", PLANT, parameter, text, *WAIT)
        assert said == {"node": PLANT, "parameter": parameter, "value": sent}
        assert set(said) == documented_keys()["set"]
        (found,) = asked.call(GetParameters, f"{PLANT}/get_parameters", names=[parameter]).values
        assert sent in (found.double_value, list(found.double_array_value), found.integer_value)


WRONG = {
    f"call {PLANT}/pause 3": (2, "data is 3; expected boolean"),
    f"call {PLANT}/pause '{{dat: true}}'": (2, "'dat' is not a field of SetBool_Request; expected data (bool"),
    f"set {PLANT} imperfections.state_loss 1.5": (1, f"{PLANT} refused imperfections.state_loss: "),
    f"set {PLANT} no_parameter 1": (1, f"{PLANT} refused no_parameter: unknown parameter 'no_parameter'"),
    f"set {PLANT} imperfections.state_loss lots": (2, "imperfections.state_loss is lots; expected a number"),
    f"set {PLANT} imperfections.motor_coulomb_friction 0.1": (2, "expected a list of numbers, e.g. [0.5]"),
    "call /nobody/hold --timeout 0.3": (1, "no node offers the service /nobody/"),
    "call '/a b/hold'": (2, "'/a b"),
}


@pytest.mark.parametrize("line", WRONG)
def test_a_wrong_name_or_value_ends_in_one_sentence(loop: None, line: str) -> None:
    code, sentence = WRONG[line]
    said = fjr_here(*shlex.split(line), *(() if "--timeout" in line else WAIT), code=code)
    assert sentence in said
    assert len(said.strip().splitlines()) == 1


def test_lifecycle_reads_and_changes_the_state_and_refuses_what_is_not_offered(loop: None) -> None:
    assert f"{CONTROLLER} is active; transitions: deactivate, shutdown" in fjr_here("lifecycle", CONTROLLER, *WAIT)
    for transition, state in (("deactivate", "inactive"), ("activate", "active")):
        said = fjr_json("lifecycle", CONTROLLER, transition, *WAIT)
        assert said["state"] == state
        assert set(said) == documented_keys()["lifecycle"]
    said = fjr_here("lifecycle", CONTROLLER, "configure", *WAIT, code=1)
    assert f"{CONTROLLER} is active and has no transition 'configure'; expected deactivate, shutdown" in said


def test_node_that_stands_still_has_not_discovered_new_subscriptions(
    ros: Ros, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clients, "RETRY_AFTER", 0.5)
    node = Node("asking", context=ros.context)
    client = ServiceClient(node, TIME_LIMIT)
    try:
        assert not client.discovered_by("nobody")
        plant = start("plant", "--ros-args", "-p", "start_paused:=true", "-p", "compile:=false")
        wait_for(lambda: client.discovered_by("fjr_plant"), "the answer of the plant")
        plant.signal(signal.SIGSTOP)
        assert not client.discovered_by("fjr_plant")
        plant.signal(signal.SIGCONT)
        wait_for(lambda: client.discovered_by("fjr_plant"), "the answer of the plant after its pause")
    finally:
        client.close()
        node.destroy_node()


# A motion that is sent; test_real_time.py shows that it is tracked.


def motion_file(folder: Path, q: np.ndarray, header: str = "time,joint1") -> str:
    np.savetxt(folder / "motion.csv", np.stack([T, q], axis=1), "%.6f", ",", header=header, comments="")
    return str(folder / "motion.csv")


def test_a_motion_is_refused_with_the_reason_or_accepted(loop: None, tmp_path: Path) -> None:
    left = ("--namespace", "left")
    fjr_here("echo", "left/joint_commands", "--once", *WAIT)
    said = fjr_here("send", motion_file(tmp_path, MOTION, "time,elbow"), *left, "--lead", "0.05", code=2)
    assert "the header is 'time, elbow', without joint1; expected the columns time, joint1" in said
    said = fjr_here("send", motion_file(tmp_path, MOTION + 1.0), *left, "--lead", "0.05", code=1)
    assert "trajectory refused: joint 'joint1' would reach" in said
    said = fjr_here("send", motion_file(tmp_path, MOTION), *left, "--tolerance", "0.002")
    assert "accepted: smoothed within" in said
    rest = float(said.partition("s at [")[2].partition("] rad")[0])  # beyond the last sample
    assert MOTION[-1] < rest < MOTION[-1] + 0.5


def test_without_a_controller_the_command_ends_with_one_sentence(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(clients, "RESPONSE_LIMIT", 0.5)
    said = fjr_here("send", motion_file(tmp_path, MOTION), "--namespace", "right", code=1)
    missing = "/right/fjr_controller is not running, or its parameters are not available; expected an active controller"
    assert said == f"fjr: {missing}\n"
