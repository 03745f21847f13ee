# SPDX-License-Identifier: Apache-2.0
"""`fjr play` publishes bags of both storages, written by the rosbags library."""

from __future__ import annotations

import os
import signal
import tracemalloc
from collections.abc import Iterable
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fjr_monitor.recording import bag as reader
from fjr_monitor.recording.bag import in_order, read_bag
from fjr_monitor.recording.topics import due
from fjr_msgs_py.names import LATCHED
from fjr_msgs_py.node.participant import own_node
from system.bags import JOINT_STATE, STORE, joint_state, text_message
from system.executables import Start, documented_keys, fjr_here, fjr_json, wait_for

pytestmark = pytest.mark.system
STATES, EFFORTS, MODEL = "/left/joint_states", "/left/joint_commands", "/left/robot_description"
PERIOD = 50_000_000  # ns
LONG = 10_000  # messages of a bag whose end no test reaches, in 500 s


def written(folder: Path, storage: StoragePlugin, count: int) -> Path:
    """Write numbered states and commands, and one text."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        topics = {name: writer.add_connection(name, JOINT_STATE, typestore=STORE) for name in (STATES, EFFORTS)}
        model = writer.add_connection(MODEL, "std_msgs/msg/String", typestore=STORE)
        writer.write(model, PERIOD, text_message("robot"))
        for k in range(count):
            for connection in topics.values():
                writer.write(connection, (1 + k) * PERIOD, joint_state(k * 10**9))
    return folder


def test_bag_without_metadata_is_played_in_order_until_ctrl_c_without_commands_to_the_robot(
    start: Start, tmp_path: Path
) -> None:
    bag = written(tmp_path / "bag", StoragePlugin.MCAP, LONG)
    (bag / "metadata.yaml").unlink()
    numbers: list[int] = []
    with own_node("test_play") as node:
        subscription = node.create_subscription(JointState, STATES, lambda _: None, 1000)
        command = start("fjr", "play", str(bag))

        def are_there() -> bool:
            while (taken := subscription.handle.take_message(JointState, False)) is not None:
                numbers.append(taken[0].header.stamp.sec)
            return len(numbers) >= 5

        wait_for(are_there, "messages")
        assert node.count_publishers(EFFORTS) == 0
        late, texts = node.create_subscription(String, MODEL, lambda _: None, LATCHED), []
        wait_for(lambda: bool(texts.append(late.handle.take_message(String, False)) or texts[-1]), "the text")
        command.signal(signal.SIGINT)
        code, said = command.end()
    assert code == 0, said
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert texts[-1][0].data == "robot"  # latched: it was sent before the subscription
    assert f"{EFFORTS} not played: --efforts commands a robot" in said
    assert "stopped before the end of the bag" in said


def test_named_topics_and_efforts_are_played_to_the_end(tmp_path: Path) -> None:
    bag = written(tmp_path / "bag", StoragePlugin.MCAP, 5)
    found = fjr_json("play", str(bag), STATES, EFFORTS, "--efforts", "--rate", "100")
    assert found == {"messages": {STATES: 5, EFFORTS: 5}, "complete": True}
    assert set(found) == documented_keys()["play"]
    assert [due(each, 5_000_000_000, 2.0) for each in (5_000_000_000, 6_000_000_000, 8_000_000_000)] == [0.0, 0.5, 1.5]
    kept = {name: (each.count, each.first, each.last) for name, each in read_bag(bag).topics.items()}
    assert kept == {STATES: (5, PERIOD, 5 * PERIOD), EFFORTS: (5, PERIOD, 5 * PERIOD), MODEL: (1, PERIOD, PERIOD)}
    sentence = f"holds no message of /left/other; it holds {EFFORTS}, {STATES}"
    assert sentence in fjr_here("play", str(bag), "/left/other", code=2)
    assert f"{EFFORTS} commands a robot; expected --efforts" in fjr_here("play", str(bag), EFFORTS, code=2)


@pytest.mark.parametrize("storage", [StoragePlugin.MCAP, StoragePlugin.SQLITE3], ids=lambda each: each.name)
def test_messages_come_by_receive_time(tmp_path: Path, storage: StoragePlugin) -> None:
    texts(tmp_path / "bag", storage, [3, 1, 2, 5, 4])
    assert [message.log_time for _, message in in_order(tmp_path / "bag", {MODEL})] == [1, 2, 3, 4, 5]
    assert not list(in_order(tmp_path / "bag", {STATES}))


@pytest.mark.parametrize("limit", ["AHEAD_MESSAGES", "AHEAD_BYTES"])
def test_a_bag_is_read_only_a_few_messages_ahead_and_closed_when_nobody_reads_on(
    tmp_path: Path, limit: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    texts(tmp_path / "bag", StoragePlugin.SQLITE3, range(1000), "x" * 10_000)
    monkeypatch.setattr(reader, limit, 100)
    tracemalloc.start()
    try:
        messages = in_order(tmp_path / "bag", {MODEL})
        next(messages)
        tracemalloc.reset_peak()  # opening a file may take a large buffer
        assert sum(1 for _ in messages) == 999
        assert tracemalloc.get_traced_memory()[1] < 5e6  # of 10 MB
    finally:
        tracemalloc.stop()
    messages = in_order(tmp_path / "bag", {MODEL})
    next(messages)
    assert open_files(tmp_path)
    messages.close()
    assert not open_files(tmp_path)


def open_files(folder: Path) -> list[Path]:
    """Return the files below a folder that this process has open."""
    links = (Path(os.path.realpath(each)) for each in Path("/proc/self/fd").iterdir())
    return [file for file in links if folder in file.parents]


def texts(folder: Path, storage: StoragePlugin, times: Iterable[int], text: str = "robot") -> None:
    """Write a text at each of the receive times [ns]."""
    with Writer(folder, version=9, storage_plugin=storage) as writer:
        model = writer.add_connection(MODEL, "std_msgs/msg/String", typestore=STORE)
        for each in times:
            writer.write(model, each, text_message(text))


def test_hint_names_the_installed_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from fjr_msgs_py.console.ros2 import play_command

    monkeypatch.setenv("PATH", str(tmp_path))
    assert play_command(Path("my bag")) == "fjr play 'my bag'"
    (tmp_path / "ros2").write_text("#!/bin/sh\n")
    (tmp_path / "ros2").chmod(0o755)
    assert play_command(Path("my bag")) == "ros2 bag play 'my bag'"
