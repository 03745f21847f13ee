# SPDX-License-Identifier: Apache-2.0
"""`fjr play`: publish the messages of a bag at their recorded times, without ros2cli."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

from mcap.records import Message
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from fjr_core.config import ros_yaml
from fjr_core.errors import FjrError
from fjr_monitor.recording.echo import absolute
from fjr_monitor.recording.message_types import SchemaError, interface_class
from fjr_monitor.recording.reader import bag_folder, in_order, read_bag
from fjr_monitor.recording.topic import BagError, Topic
from fjr_msgs_py import names
from fjr_msgs_py.console.output import Result, heartbeat
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.node.process import flush

EFFORTS = (f"/{names.EFFORT_COMMANDS}", f"/{names.JOINT_COMMANDS}")
LATCHED = (f"/{names.ROBOT_DESCRIPTION}", "/tf_static")  # without metadata.yaml
DISCOVERY = 1.0  # s from the publishers to the first message, in which subscribers discover them
ACKNOWLEDGED = 2.0  # s; longest wait for the last messages
DEPTH = 1000  # messages a publisher keeps for a slow subscriber


def play(path: Path, wanted: Sequence[str], rate: float, efforts: bool, stop: threading.Event) -> Result:
    """Publish topics of a bag, or all, until its end or `stop`; raise FjrError.

    rate: speed relative to the recording. efforts: also the topics that command a robot.
    """
    path = bag_folder(path)
    with heartbeat(lambda: f"fjr: reading {path}"):
        bag = read_bag(path)
    for note in bag.notes:
        print(f"fjr: {note}", file=sys.stderr)
    topics = selected(bag.topics, wanted, efforts, path)
    with own_node("fjr_play") as node:
        publishers = _publishers(node, topics, latched_topics(path, topics))
        if not publishers:
            raise BagError(f"{path} holds no topic that can be played; its message types are not installed here")
        played = [topics[name] for name in publishers]
        first, last = min(each.first for each in played), max(each.last for each in played)
        length = due(last, first, rate)
        print(f"fjr: plays {len(publishers)} topics for {length:.3g} s; Ctrl-C ends", file=sys.stderr, flush=True)
        counts = dict.fromkeys(publishers, 0)
        stop.wait(DISCOVERY)
        for name, data in _in_time(in_order(path, publishers), first, rate, stop):
            publishers[name].publish(data)
            counts[name] += 1
        flush(*publishers.values(), seconds=0.0 if stop.is_set() else ACKNOWLEDGED)
    return _played(counts, sum(counts.values()) == sum(each.count for each in played))


def _played(counts: dict[str, int], complete: bool) -> Result:
    """Return one line per topic, then the total."""
    lines = [f"{count:9} {topic}" for topic, count in sorted(counts.items())]
    end = "" if complete else ", stopped before the end of the bag"
    text = "\n".join([*lines, f"{sum(counts.values())} messages of {len(counts)} topics played{end}"])
    return Result(text, {"messages": counts, "complete": complete})


def selected(held: dict[str, Topic], wanted: Sequence[str], efforts: bool, path: Path) -> dict[str, Topic]:
    """Return the held topics to play by name; raise BagError if a wanted topic holds no message or commands a robot.

    Without `wanted` the topics that command a robot are left out with a notice, unless `efforts`.
    """
    commanding = sorted(name for name in held if name.endswith(EFFORTS))
    for name in map(absolute, wanted):
        if name not in held:
            raise BagError(f"{path} holds no message of {name}; it holds {', '.join(sorted(held)) or 'nothing'}")
        if name in commanding and not efforts:
            raise BagError(f"{name} commands a robot; expected --efforts if it is to move")
    if wanted:
        return {name: held[name] for name in map(absolute, wanted)}
    if commanding and not efforts:
        print(f"fjr: {', '.join(commanding)} not played: --efforts commands a robot", file=sys.stderr)
        held = {name: topic for name, topic in held.items() if name not in commanding}
    if not held:
        raise BagError(f"{path} holds no message to play")
    return held


def due(log_time: int, first: int, rate: float) -> float:
    """Return the time [s] of a message after the first, from the receive times [ns] of both."""
    return (log_time - first) * 1e-9 / rate


def latched_topics(folder: Path, topics: Collection[str]) -> frozenset[str]:
    """Return the topics whose publishers kept the last message for late subscribers: by metadata.yaml, else by name."""
    try:
        document = ros_yaml.read(folder / "metadata.yaml", "metadata")
        entries = document["rosbag2_bagfile_information"]["topics_with_message_count"]
        return frozenset(each["topic_metadata"]["name"] for each in entries if _is_latched(each["topic_metadata"]))
    except (FjrError, LookupError, TypeError, AttributeError):
        return frozenset(name for name in topics if name.endswith(LATCHED))


def _is_latched(metadata: dict[str, Any]) -> bool:
    profiles = metadata["offered_qos_profiles"]
    found = ros_yaml.parse(profiles) if isinstance(profiles, str) and profiles else profiles  # text before version 9
    return any(profile["durability"] in ("transient_local", 1) for profile in found or ())


def _publishers(node: Node, topics: dict[str, Topic], latched: Collection[str]) -> dict[str, Publisher]:
    """Return a publisher for each topic of an installed type."""
    publishers = {}
    for name, topic in topics.items():
        durability = DurabilityPolicy.TRANSIENT_LOCAL if name in latched else DurabilityPolicy.VOLATILE
        try:
            kind = interface_class(topic.type_name)
        except SchemaError as error:
            print(f"fjr: {name} not played: {error}", file=sys.stderr)
            continue
        publishers[name] = node.create_publisher(kind, name, QoSProfile(depth=DEPTH, durability=durability))
    return publishers


def _in_time(
    messages: Iterator[tuple[str, Message]], first: int, rate: float, stop: threading.Event
) -> Iterator[tuple[str, bytes]]:
    """Yield the topic and content of each message when it is due, until `stop`; first: the first receive time [ns]."""
    start = time.monotonic()
    for name, message in messages:
        if stop.wait(max(0.0, start + due(message.log_time, first, rate) - time.monotonic())):
            return
        yield name, message.data
