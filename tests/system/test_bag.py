# SPDX-License-Identifier: Apache-2.0
"""A recorded bag contains every byte sent, with send times, in a format that other tools read; `fjr play` publishes it.

Bags of both storages that are played are written by the rosbags library.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
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
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from fjr_bringup.runner import JOINT_COMMANDS, _Run
from fjr_monitor.recording import bag as reader
from fjr_monitor.recording.bag import header_stamp, in_order, read_bag
from fjr_monitor.recording.files import Topic, files_of
from fjr_monitor.recording.message_types import type_hash
from fjr_monitor.recording.recorder import QUEUE_DEPTH, BagWriter, Recorder, Track
from fjr_monitor.recording.topics import due
from fjr_msgs_py.names import LATCHED
from fjr_msgs_py.node.participant import own_node
from nodes.harness import Ros
from system.bags import JOINT_STATE, STORE, TALKER, joint_state, text_message
from system.executables import Start, documented_keys, fjr_here, fjr_json, wait_for

pytestmark = pytest.mark.system
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
    bag = read_bag(recorded[0])
    table = bag.table(bag.topic("/joint_states"), ("shoulder", "elbow", "wrist"))
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


def test_a_publisher_that_returns_with_a_weaker_qos_is_recorded(node: Node, tmp_path: Path) -> None:
    """As of a node that is started again while the recorder runs; there is one publisher before and after."""
    first = node.create_publisher(String, "/again", 10)
    with Recorder(tmp_path / "bag") as recorder:
        matched(recorder, first)
        weaker = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        node.destroy_publisher(first)
        second = node.create_publisher(String, "/again", weaker)
        wait_for(lambda: second.get_subscription_count() > 0, "a subscriber")
        wait_for(lambda: recorder.matched("/again") == 1, "a publisher")
        second.publish(String(data="again"))
        wait_for(lambda: b"again" in last(recorder, "/again"), "a message")


def test_echo_prints_what_a_later_and_weaker_publisher_sends(node: Node) -> None:
    strong = node.create_publisher(String, "/shared", 10)

    def talk() -> None:
        wait_for(lambda: strong.get_subscription_count() > 0, "fjr echo")
        strong.publish(String(data="strong"))
        weak = node.create_publisher(String, "/shared", QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
        wait_for(lambda: weak.get_subscription_count() > 0, "fjr echo")
        weak.publish(String(data="weak"))

    with ThreadPoolExecutor() as thread:
        talking = thread.submit(talk)
        said = fjr_here("echo", "/shared", "--count", "2", "--timeout", "20")
        talking.result()
    assert [each["data"] for each in yaml.safe_load_all(said.rstrip().removesuffix("---"))] == ["strong", "weak"]


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


# `fjr play`.


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
def test_messages_come_by_receive_times_that_go_on_where_the_clock_stepped_back(
    tmp_path: Path, storage: StoragePlugin
) -> None:
    """So that the bag is played in its own time, not after an hour."""
    texts(tmp_path / "mixed", storage, [3, 1, 2, 5, 4])
    assert [message.log_time for _, message in in_order(tmp_path / "mixed", {MODEL})] == [1, 2, 3, 4, 5]
    assert not list(in_order(tmp_path / "mixed", {STATES}))
    hour, now = 3600 * 10**9, 2 * 3600 * 10**9
    texts(tmp_path / "bag", storage, [now, now + PERIOD, now + 2 * PERIOD - hour, now + 3 * PERIOD - hour])
    times = [message.log_time - now for _, message in in_order(tmp_path / "bag", {MODEL})]
    assert times == [0, PERIOD, PERIOD + 1, 2 * PERIOD + 1]  # the step takes a nanosecond
    bag = read_bag(tmp_path / "bag")
    assert (bag.topics[MODEL].first, bag.topics[MODEL].last) == (now, now + 2 * PERIOD + 1)
    assert bag.notes == ("the clock stepped back by 3599.95 s: send times go on from there",)


def test_files_of_a_split_bag_come_by_number_and_of_separate_ones_by_time(tmp_path: Path) -> None:
    """A file of earlier times than the one before it, by name, shows no step of the clock."""
    hour, bag = 3600 * 10**9, tmp_path / "bag"
    bag.mkdir()
    times = {f"split_{k}": k * hour for k in range(1, 12)} | {"upstairs": 30 * 60 * 10**9}
    for name, at in times.items():
        texts(tmp_path / name, StoragePlugin.MCAP, [at])
        next((tmp_path / name).glob("*.mcap")).rename(bag / f"{name}.mcap")
    assert [file.stem for file in files_of(bag) if "split" in file.stem] == [*times][:-1]
    assert read_bag(bag).notes == ()
    assert [message.log_time for _, message in in_order(bag, {MODEL})] == sorted(times.values())


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
