# SPDX-License-Identifier: Apache-2.0
"""`fjr echo`, `fjr record` and `fjr play`: print, record and publish topics without ros2cli."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription
from rclpy.validate_full_topic_name import validate_full_topic_name

from fjr_core.config import ros_yaml
from fjr_core.errors import FjrError, ParameterError
from fjr_monitor.recording.bag import bag_folder, in_order, read_bag
from fjr_monitor.recording.files import BagError, Topic
from fjr_monitor.recording.message_types import SchemaError, interface_class
from fjr_monitor.recording.recorder import Recorder, followed
from fjr_monitor.recording.run_folder import FolderError
from fjr_msgs_py import names
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.options import FIRST
from fjr_msgs_py.console.output import Result, heartbeat, json_text, tell
from fjr_msgs_py.console.ros2 import discover_quickly, refuse_over_ros2
from fjr_msgs_py.messages.plain import plain
from fjr_msgs_py.node.loading import domain
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.node.process import flush

POLL = 0.02  # s between looks at the graph, a queue or the recorder
PATIENCE = 2.0  # s without a message before a notice is printed
ELSEWHERE = "start the nodes, or set the ROS_DOMAIN_ID in which they run"
COMMANDS = (f"/{names.EFFORT_COMMANDS}", f"/{names.JOINT_COMMANDS}")  # that move a robot
LATCHED = (f"/{names.ROBOT_DESCRIPTION}", "/tf_static")  # without metadata.yaml
DISCOVERY = 1.0  # s from the publishers to the first message, in which subscribers discover them
ACKNOWLEDGED = 2.0  # s; longest wait for the last messages
DEPTH = 1000  # messages a publisher keeps for a slow subscriber


class TopicError(FjrError):
    """No message arrived."""


def absolute(given: str, kind: str = "topic", example: str = "/joint_states") -> str:
    """Return the absolute name of a topic, service or node (kind); raise ParameterError if the name is invalid."""
    name = given if given.startswith("/") else f"/{given}"
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException:
        raise ParameterError(
            f"'{given}' is not a {kind} name; expected letters, digits, _ and single /, e.g. {example}"
        ) from None
    return name


def nodes_seen(node: Node) -> str:
    """Return the other nodes in the ROS domain of a node, for a message."""
    found = node.get_node_names_and_namespaces()
    nodes = sorted(f"{space.rstrip('/')}/{name}" for name, space in found if name != node.get_name())
    return f"nodes in ROS domain {domain()}: {', '.join(nodes) or 'none'}"


def echo(topic: str, count: int | None, timeout: float | None, force: bool, as_json: bool) -> None:
    """Print messages of a topic as YAML, or one JSON document a line, until `count` have arrived or until Ctrl-C.

    timeout [s]: longest wait for a message; None: FIRST if one is to be printed, else any. Raise TopicError after it,
    SchemaError if the type is not installed.
    """
    refuse_over_ros2(f"ros2 topic echo {topic}", "with filters, fields and statistics", force)
    discover_quickly()
    topic, limit = absolute(topic), timeout or (FIRST if count == 1 else math.inf)
    with stoppable() as stop, own_node("fjr_echo") as node:
        for number, message in enumerate(_messages(node, topic, limit, stop), 1):
            values = plain(message)
            document = yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=math.inf) + "---"
            print(json_text(values) if as_json else document, flush=True)
            if number == count:
                return


def _messages(node: Node, topic: str, timeout: float, stop: threading.Event) -> Iterator[Any]:
    """Yield messages as they arrive, once there is a publisher."""
    subscription: Subscription | None = None
    received = time.monotonic()
    notified = False
    while not stop.wait(POLL):
        while subscription and (taken := subscription.handle.take_message(subscription.msg_type, False)) is not None:
            received = time.monotonic()
            yield taken[0]
        if publishers := node.get_publishers_info_by_topic(topic):
            old, kind = subscription, interface_class(publishers[0].topic_type)
            subscription = followed(node, kind, topic, publishers, old)
            if old not in (None, subscription):
                node.destroy_subscription(old)
        silent = time.monotonic() - received
        if silent > timeout:
            raise TopicError(
                f"no message of {topic} for {timeout:g} s; {_published(node)}; {nodes_seen(node)}; {ELSEWHERE}"
            )
        if silent > PATIENCE and not notified:
            notified = True
            tell(f"waiting for {topic} in ROS domain {domain()}; {_published(node)}")


def _published(node: Node) -> str:
    topics = (name for name, _ in node.get_topic_names_and_types() if name != "/parameter_events")
    published = sorted(name for name in topics if node.count_publishers(name))
    return f"published are {', '.join(published) or 'none'}"


def record(topics: Sequence[str], output: Path | None, duration: float | None, force: bool) -> Result:
    """Record the named topics, or all, for `duration` [s] from the first message on, if one comes, or until Ctrl-C.

    output: new folder of the bag; None: one named after the time. Raise FjrError.
    """
    refuse_over_ros2(
        f"ros2 bag record --storage mcap {' '.join(topics) or '--all'}", "with splitting and compression", force
    )
    discover_quickly()
    wanted = [absolute(topic) for topic in topics]
    folder = output or Path(f"bag_{datetime.now():%Y_%m_%d-%H_%M_%S}")
    if folder.exists():
        raise FolderError(f"{folder} exists: not overwritten; expected the name of a new folder")
    what, limit = ", ".join(wanted) or "all topics", "Ctrl-C ends" if duration is None else f"{duration:g} s long"
    tell(f"records {what} into {folder}; {limit}")
    with stoppable() as stop, Recorder(folder, topics=wanted) as recorder:
        end, heard = time.monotonic() + (duration or math.inf), False
        while not (recorder.loss or recorder.failure or stop.wait(POLL)) and time.monotonic() < end:
            if not heard and any(channel.count for channel in recorder.writer.channels):
                end, heard = time.monotonic() + (duration or math.inf), True
    if recorder.failure:  # also in its last round
        raise FjrError(f"the recorder failed: {recorder.failure}")
    return _recorded(recorder, wanted, folder)


def _recorded(recorder: Recorder, wanted: Sequence[str], folder: Path) -> Result:
    """Return one line per topic, then missing topics and the total."""
    channels = sorted(recorder.writer.channels, key=lambda channel: channel.topic)
    lines = [f"{each.count:9} {each.topic} ({each.type_name})" for each in channels if each.count]
    recorded = {channel.topic for channel in channels if channel.count}
    lines += [f"not recorded: {topic}, {reason}" for topic, reason in sorted(recorder.skipped.items())]
    lines += [f"not complete: {recorder.loss}"] if recorder.loss else []
    lines += [f"nothing came on {topic}" for topic in wanted if topic not in recorded | set(recorder.skipped)]
    counts = {channel.topic: channel.count for channel in channels}
    text = "\n".join([*lines, f"{sum(counts.values())} messages of {len(recorded)} topics in {folder}"])
    values = {"folder": folder, "messages": counts, "not_recorded": recorder.skipped, "loss": recorder.loss}
    return Result(text, values, code=1 if recorder.loss else 0)


def play(bag: Path, topics: Sequence[str], rate: float, efforts: bool, force: bool) -> Result:
    """Publish topics of a bag, or all, at their recorded times until its end or Ctrl-C; raise FjrError.

    rate: speed relative to the recording. efforts: also the topics that command a robot.
    """
    wanted = f" --topics {' '.join(topics)}" if topics else ""
    refuse_over_ros2(f"ros2 bag play {bag}{wanted}", "with pause, loop and clock", force)
    discover_quickly()
    path = bag_folder(bag)
    with stoppable() as stop:
        with heartbeat(lambda: f"fjr: reading {path}"):
            found = read_bag(path)
        for note in found.notes:
            tell(note)
        return _play(path, _selected(found.topics, topics, efforts, path), rate, stop)


def _selected(held: dict[str, Topic], wanted: Sequence[str], efforts: bool, path: Path) -> dict[str, Topic]:
    """Return the held topics to play by name; raise BagError if a wanted topic holds no message or commands a robot.

    Without `wanted` the topics that command a robot are left out with a notice, unless `efforts`.
    """
    commanding = [] if efforts else sorted(name for name in held if name.endswith(COMMANDS))
    chosen = [*map(absolute, wanted)]
    for name in chosen:
        if name not in held:
            raise BagError(f"{path} holds no message of {name}; it holds {', '.join(sorted(held)) or 'nothing'}")
        if name in commanding:
            raise BagError(f"{name} commands a robot; expected --efforts if it is to move")
    if commanding and not wanted:
        tell(f"{', '.join(commanding)} not played: --efforts commands a robot")
    found = {name: held[name] for name in chosen or held if name not in commanding}
    if not found:
        raise BagError(f"{path} holds no message to play")
    return found


def _play(path: Path, topics: dict[str, Topic], rate: float, stop: threading.Event) -> Result:
    """Publish the topics of a bag; return one line per topic, then the total."""
    with own_node("fjr_play") as node:
        publishers = _publishers(node, topics, _latched(path, topics))
        if not publishers:
            raise BagError(f"{path} holds no topic that can be played; its message types are not installed here")
        played = [topics[name] for name in publishers]
        first, last = min(each.first for each in played), max(each.last for each in played)
        length = due(last, first, rate)
        tell(f"plays {len(publishers)} topics for {length:.3g} s; Ctrl-C ends")
        counts = dict.fromkeys(publishers, 0)
        stop.wait(DISCOVERY)
        start = time.monotonic()
        for name, message in in_order(path, publishers):
            if stop.wait(max(0.0, start + due(message.log_time, first, rate) - time.monotonic())):
                break
            publishers[name].publish(message.data)
            counts[name] += 1
        flush(*publishers.values(), seconds=0.0 if stop.is_set() else ACKNOWLEDGED)
    complete = sum(counts.values()) == sum(each.count for each in played)
    lines = [f"{count:9} {topic}" for topic, count in sorted(counts.items())]
    end = "" if complete else ", stopped before the end of the bag"
    text = "\n".join([*lines, f"{sum(counts.values())} messages of {len(counts)} topics played{end}"])
    return Result(text, {"messages": counts, "complete": complete})


def due(log_time: int, first: int, rate: float) -> float:
    """Return the time [s] of a message after the first, from the receive times [ns] of both."""
    return (log_time - first) * 1e-9 / rate


def _latched(folder: Path, topics: Collection[str]) -> frozenset[str]:
    """Return the topics whose publishers kept the last message for late subscribers: by metadata.yaml, else by name."""

    def is_latched(metadata: dict[str, Any]) -> bool:
        profiles = metadata["offered_qos_profiles"]
        found = ros_yaml.parse(profiles) if isinstance(profiles, str) and profiles else profiles  # before version 9
        return any(profile["durability"] in ("transient_local", 1) for profile in found or ())

    try:
        document = ros_yaml.read(folder / "metadata.yaml", "metadata")
        entries = document["rosbag2_bagfile_information"]["topics_with_message_count"]
        return frozenset(each["topic_metadata"]["name"] for each in entries if is_latched(each["topic_metadata"]))
    except (FjrError, LookupError, TypeError, AttributeError):
        return frozenset(name for name in topics if name.endswith(LATCHED))


def _publishers(node: Node, topics: dict[str, Topic], latched: Collection[str]) -> dict[str, Publisher]:
    """Return a publisher for each topic of an installed type."""
    publishers = {}
    for name, topic in topics.items():
        durability = DurabilityPolicy.TRANSIENT_LOCAL if name in latched else DurabilityPolicy.VOLATILE
        try:
            kind = interface_class(topic.type_name)
        except SchemaError as error:
            tell(f"{name} not played: {error}")
            continue
        publishers[name] = node.create_publisher(kind, name, QoSProfile(depth=DEPTH, durability=durability))
    return publishers
