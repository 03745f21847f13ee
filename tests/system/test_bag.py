# SPDX-License-Identifier: Apache-2.0
"""A recorded bag contains every byte sent, with send times, in a format that other tools read."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fjr_bringup.runner import JOINT_COMMANDS, _Run
from fjr_monitor.recording.bag import header_stamp, read_bag
from fjr_monitor.recording.files import Topic
from fjr_monitor.recording.message_types import type_hash
from fjr_monitor.recording.recorder import QUEUE_DEPTH, BagWriter, Recorder, Track
from nodes.harness import Ros
from system.bags import JOINT_STATE, TALKER, joint_state
from system.executables import wait_for

COUNT = 300


def message(k: int) -> bytes:
    """Return a serialised JointState of varying size, order and content, without undefined padding bytes."""
    names = ["elbow", "shoulder"] if k % 2 else ["shoulder", "elbow"]
    values = {"shoulder": float(k), "elbow": -float(k)}
    position = [values[name] for name in names]
    return joint_state(k * 1_000_000 + 5, names, "f" * (k % 7), position=position, effort=[0.5] * (k % 3))


@pytest.fixture
def node(ros: Ros) -> Node:
    return ros.add(Node("talker", context=ros.context))


def matched(recorder: Recorder, *publishers: Publisher) -> None:
    wait_for(lambda: all(p.get_subscription_count() and recorder.matched(p.topic_name) for p in publishers), "a match")


def last(recorder: Recorder, topic: str) -> bytes:
    """The latest serialised message of a topic; empty before the first."""
    return (recorder.ends(topic) or (b"", b""))[1]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[bytes]]:
    """Return a closed bag with COUNT joint states, and the messages sent."""
    bag, sent = tmp_path_factory.mktemp("recorded") / "bag", [message(k) for k in range(COUNT)]
    with Ros() as ros, Recorder(bag) as recorder:
        publisher = ros.add(Node("talker", context=ros.context)).create_publisher(JointState, "/joint_states", COUNT)
        matched(recorder, publisher)
        for data in sent:
            publisher.publish(data)
        wait_for(lambda: last(recorder, "/joint_states") == sent[-1], "a message")
    assert recorder.failure is None
    return bag, sent


def test_elapsed_time_can_be_read_during_a_drain(tmp_path: Path) -> None:
    """Read the elapsed time between any two messages of the first drain, as another thread may."""
    elapsed: list[float] = []
    waiting = [(message(k), {"publication_sequence_number": k}) for k in (0, 1500, 2000)]
    waiting = [(data, {**info, "received_timestamp": 1, "source_timestamp": 1}) for data, info in waiting]

    def take_message(_kind: type, _raw: bool) -> tuple[bytes, dict[str, int]] | None:
        elapsed.append(_Run._elapsed(SimpleNamespace(recorder=recorder)))
        return waiting.pop(0) if waiting else None

    recorder = Recorder(tmp_path / "bag")
    subscription = SimpleNamespace(handle=SimpleNamespace(take_message=take_message), msg_type=JointState)
    channel = recorder.writer.add_topic(JOINT_COMMANDS, JOINT_STATE, [], "")
    recorder._tracks[JOINT_COMMANDS] = Track(subscription, channel, [])
    with recorder:
        wait_for(lambda: len(elapsed) > 4 or recorder.failure is not None, "a message")
    assert recorder.failure is None
    assert set(elapsed) == {0.0, 2.0}


def test_every_byte_is_in_the_bag_in_order_of_growing_send_times(recorded: tuple[Path, list[bytes]]) -> None:
    folder, sent = recorded
    bag, now = read_bag(folder), time.time_ns()
    topic = bag.topic("/joint_states")
    assert [message.data for message in topic.messages] == sent
    assert bag.complete
    assert topic.lost == 0
    assert (np.diff(topic.publish_time) > 0).all()
    assert all(message.publish_time <= message.log_time for message in topic.messages)
    assert (np.abs(topic.publish_time - now) < 600 * 10**9).all()
    with AnyReader([folder]) as reader:  # by the recorded definitions
        wanted = [c for c in reader.connections if c.topic == "/joint_states"]
        positions = [reader.deserialize(raw, c.msgtype).position[0] for c, _, raw in reader.messages(wanted)]
    assert [abs(position) for position in positions] == list(range(COUNT))


def test_joints_are_columns_by_name(recorded: tuple[Path, list[bytes]]) -> None:
    table = read_bag(recorded[0]).joints("/joint_states", ("shoulder", "elbow", "wrist"))
    k = np.arange(COUNT)
    np.testing.assert_array_equal(table.position[:, :2], np.column_stack([k, -k]))
    assert np.isnan(table.position[:, 2]).all()
    assert np.isnan(table.velocity).all()
    np.testing.assert_array_equal(table.stamp, k * 1_000_000 + 5)
    assert header_stamp(message(2500)) == 2_500_000_005


def test_metadata_agrees_with_the_file_and_with_rosbags(recorded: tuple[Path, list[bytes]]) -> None:
    folder, _ = recorded
    metadata = yaml.safe_load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    with open(folder / metadata["relative_file_paths"][0], "rb") as stream:
        reader = make_reader(stream)
        summary, header = reader.get_summary(), reader.get_header()
    assert summary is not None
    assert summary.statistics is not None
    assert header.profile == "ros2"
    assert summary.chunk_indexes
    assert all(index.message_index_offsets and index.compression == "" for index in summary.chunk_indexes)
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}
    assert (metadata["version"], metadata["storage_identifier"]) == (9, "mcap")
    assert metadata["message_count"] == summary.statistics.message_count == metadata["files"][0]["message_count"]
    start = metadata["starting_time"]["nanoseconds_since_epoch"]
    assert start == summary.statistics.message_start_time
    assert start + metadata["duration"]["nanoseconds"] == summary.statistics.message_end_time
    counts = {each["topic_metadata"]["name"]: each["message_count"] for each in metadata["topics_with_message_count"]}
    with Reader(folder) as rosbag:
        assert rosbag.message_count == metadata["message_count"]
        assert {connection.topic: connection.msgcount for connection in rosbag.connections} == counts
    assert {"/joint_states", "/rosout", "/parameter_events"} <= set(counts)
    topics = {each["name"]: each for each in (of["topic_metadata"] for of in metadata["topics_with_message_count"])}
    for topic in topics.values():
        assert topic["type_description_hash"] == type_hash(topic["type"])
        assert topic["serialization_format"] == "cdr"
    (offered,) = topics["/joint_states"]["offered_qos_profiles"]
    assert (offered["reliability"], offered["durability"]) == ("reliable", "volatile")
    assert offered["lifespan"] == {"sec": 9223372036, "nsec": 854775807}
    assert topics["/rosout"]["offered_qos_profiles"][0]["durability"] == "transient_local"


def test_latched_later_and_weaker_publishers_are_recorded_with_their_qos(node: Node, tmp_path: Path) -> None:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    early, strong = node.create_publisher(String, "/before", latched), node.create_publisher(String, "/shared", 10)
    early.publish(String(data="sent before the recorder came"))
    with Recorder(tmp_path / "bag") as recorder:
        wait_for(lambda: bool(last(recorder, "/before")), "a message")
        matched(recorder, strong)
        weak = node.create_publisher(String, "/shared", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
        wait_for(lambda: recorder.matched("/shared") == 2 and weak.get_subscription_count() > 0, "a message")
        for publisher, text in ((weak, b"weak"), (strong, b"strong")):
            publisher.publish(String(data=text.decode()))
            wait_for(lambda wanted=text: wanted in last(recorder, "/shared"), "a message")
    bag = read_bag(tmp_path / "bag")
    assert [message.data for message in bag.topic("/before").decoded] == ["sent before the recorder came"]
    assert [message.data for message in bag.topic("/shared").decoded] == ["weak", "strong"]


def test_a_topic_faster_than_the_disk_keeps_no_other_waiting(
    node: Node, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fast = node.create_publisher(String, "/fast", QUEUE_DEPTH)
    write, slow_disk = BagWriter.write, threading.Event()

    def slow_write(*arguments: Any) -> None:
        if slow_disk.is_set():
            fast.publish(String(data="two come"))
            fast.publish(String(data="while one is written"))
        write(*arguments)

    monkeypatch.setattr(BagWriter, "write", slow_write)
    slow = node.create_publisher(String, "/slow", 10)
    with Recorder(tmp_path / "bag") as recorder:
        matched(recorder, fast, slow)
        slow_disk.set()
        fast.publish(String(data="first"))
        wait_for(lambda: bool(last(recorder, "/fast")), "a message")
        slow.publish(String(data="in its turn"))
        wait_for(lambda: bool(last(recorder, "/slow")), "a message")
        slow_disk.clear()


def test_lost_messages_show_in_the_numbering(recorded: tuple[Path, list[bytes]]) -> None:
    messages = read_bag(recorded[0]).topic("/joint_states").messages
    topic = Topic("/joint_states", "", "")
    for message in (*messages[:10], *messages[13:]):
        topic.note(message)
    assert topic.lost == 3
    topic.note(messages[5])  # of a second publisher
    topic.note(messages[-1])
    assert topic.lost is None


TALKING_RECORDER = f"""{TALKER}
for k in range(100000):
    publisher.publish(String(data=str(k)))
    print(k, time.monotonic(), flush=True)
    time.sleep(0.005)
"""


def test_killed_recorder_loses_at_most_the_last_second(tmp_path: Path) -> None:
    command = [sys.executable, "-c", TALKING_RECORDER, str(tmp_path / "bag")]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        lines = [process.stdout.readline().split() for _ in range(400)]
        now = time.monotonic()
        process.send_signal(signal.SIGKILL)
    bag, due = read_bag(tmp_path / "bag"), sum(float(when) < now - 1.0 for _, when in lines)
    words = [message.data for message in bag.topic("/words").decoded]
    assert not bag.complete
    assert 100 < due <= len(words)
    assert words == [str(k) for k in range(len(words))]
