# SPDX-License-Identifier: Apache-2.0
"""`fjr echo` and `fjr record` with running nodes, and in comparison with ros2."""

from __future__ import annotations

import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from fjr_monitor.recording.bag import read_bag
from system.executables import LOCKSTEP, SLOW, TIME_LIMIT, Executable, fjr, fjr_here, running
from time_limits import Limit

pytestmark = pytest.mark.system
HANG = "600"  # s


@pytest.fixture(scope="module")
def loop() -> Iterator[None]:
    """Plant and controller under /left, which all tests of this file read."""
    with running(SLOW, "-r", "__ns:=/left"):
        yield


def test_echo_prints_messages_as_yaml(loop: None) -> None:
    said = fjr("echo", "/left/joint_states", "--count", "3", "--timeout", HANG)
    printed = "".join(
        line for line in said.splitlines(keepends=True) if not line.startswith("fjr: ")
    )  # the notice that it waits
    first, *others = yaml.safe_load_all(printed.rstrip().removesuffix("---"))
    assert len(others) == 2
    assert first["name"] == ["joint1", "joint1_motor"]
    assert len(first["position"]) == len(first["velocity"]) == len(first["effort"]) == 2


def test_echo_prints_latched_messages(loop: None) -> None:
    fjr_here("echo", "left/joint_states", "--once", "--timeout", HANG)
    said = fjr_here("echo", "left/robot_description", "--once", "--timeout", HANG)
    assert '<robot name="single_link">' in yaml.safe_load(said.split("---")[0])["data"]


def test_echo_without_messages_lists_the_topics(loop: None) -> None:
    fjr_here("echo", "left/joint_states", "--once", "--timeout", HANG)
    limit, said = Limit(TIME_LIMIT), ""
    while "/left/joint_states" not in said:  # topics discovered within 3 s depend on the machine
        assert not limit.passed(), said
        said = fjr_here("echo", "/nothing", "--timeout", "3", code=1)
        assert "no message of /nothing for 3 s" in said


def test_record_keeps_the_named_topics(loop: None, tmp_path: Path) -> None:
    fjr_here("echo", "left/joint_commands", "--once", "--timeout", HANG)
    bag = tmp_path / "bag"
    said = fjr("record", "left/joint_states", "/left/joint_commands", "/other", "--duration", "5", "--output", str(bag))
    assert "nothing came on /other" in said
    assert "messages of 2 topics" in said
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert set(counts) == {"/left/joint_states", "/left/joint_commands"}
        assert min(counts.values()) > 50
        connection, _, raw = next(reader.messages())
        assert np.isfinite(reader.deserialize(raw, connection.msgtype).effort).all()


def test_record_of_all_topics_ends_with_ctrl_c(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    command = Executable("fjr_bringup", "fjr", "record", "--output", str(bag))
    try:
        with running(LOCKSTEP, "-r", "__ns:=/right"):
            limit = Limit(TIME_LIMIT)
            while not (any(bag.glob("*.mcap")) and read_bag(bag).holds("/right/joint_states")):
                assert not limit.passed()
                time.sleep(0.05)
            command.signal(signal.SIGINT)
            code, said = command.end()
    finally:
        command.kill()
    assert code == 0, said
    assert "/right/joint_states (sensor_msgs/msg/JointState)" in said
    assert (bag / "metadata.yaml").is_file()


def test_record_does_not_overwrite(tmp_path: Path) -> None:
    (tmp_path / "bag").mkdir()
    assert "not overwritten" in fjr_here("record", "--output", str(tmp_path / "bag"), code=1)


@pytest.fixture
def ros2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a program ros2 on the PATH."""
    (tmp_path / "ros2").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "ros2").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")


@pytest.mark.parametrize(
    ("arguments", "better"),
    [
        (["echo", "/joint_states"], "ros2 topic echo /joint_states"),
        (["record"], "ros2 bag record --storage mcap --all"),
        (["record", "/a", "/b"], "ros2 bag record --storage mcap /a /b"),
        (["play", "bag", "/a"], "ros2 bag play bag --topics /a"),
        (["call", "/a", "{data: true}"], "ros2 service call /a TYPE '{data: true}'"),
        (["set", "/a", "b", "-0.5"], "ros2 param set /a b -0.5"),
        (["lifecycle", "/a"], "ros2 lifecycle get /a"),
        (["lifecycle", "/a", "activate"], "ros2 lifecycle set /a activate"),
    ],
)
def test_installed_ros2_is_recommended_instead(ros2: None, arguments: list[str], better: str) -> None:
    said = fjr_here(*arguments, code=1)
    assert f"use `{better}`" in said
    assert "--force" in said


def test_force_runs_the_command_despite_ros2(ros2: None) -> None:
    assert "no message of /nothing" in fjr("echo", "/nothing", "--timeout", "0.5", "--force", code=1)


@pytest.mark.parametrize("command", ["echo", "record"])
@pytest.mark.parametrize("name", ["//bad//", "/joint states", "/1st", "/"])
def test_invalid_topic_name_is_refused_in_one_sentence(command: str, name: str) -> None:
    assert f"'{name}' is not a topic name; expected" in fjr_here(command, name, code=2)
