# SPDX-License-Identifier: Apache-2.0
"""Record topics of the ROS graph into a rosbag2 bag with little load, next to a 1 kHz loop.

`BagWriter` writes MCAP storage and metadata version 9 as in Jazzy. Messages are grouped in chunks with a message index;
`flush` ends the current chunk, so that flushed messages are readable even if the process is killed.

`Recorder` has no executor: one thread polls the graph and empties the subscription queues 100 times a second. The
middleware stamps send and receive times of each message, so that batching costs no accuracy and saves wake-ups.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import rclpy
import yaml
from mcap.writer import CompressionType, Writer
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSDurabilityPolicy, QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rclpy.topic_endpoint_info import TopicEndpointInfo

from fjr_core.files.text_file import write_text
from fjr_monitor.recording.message_types import SchemaError, definition, interface_class
from fjr_monitor.recording.message_types import type_hash as hash_of
from fjr_msgs_py.console.output import tell
from fjr_msgs_py.node.participant import leave

METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # in C where PyYAML was built with libyaml
QUEUE_DEPTH = 5000  # messages per topic between two drains: 5 s at 1 kHz
BATCH = 500  # messages taken of one topic before the next has its turn: no fast topic keeps the others waiting
DRAIN_PERIOD = 0.01  # s
DISCOVERY_PERIOD = 0.1  # s
FLUSH_PERIOD = 0.5  # s; a kill loses at most this much and the batch in progress


@dataclass
class RecordedTopic:
    """A recorded topic: id in the file, type, QoS offered by its publishers, number of messages."""

    id: int
    topic: str
    type_name: str
    type_hash: str
    offered_qos: list[dict[str, Any]] = field(default_factory=list)
    count: int = 0


class BagWriter:
    """Write raw CDR messages into ``<folder>/<folder name>_0.mcap`` and, on close, ``metadata.yaml``."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self.folder = folder
        self.path = folder / f"{folder.name}_0.mcap"
        self.channels: list[RecordedTopic] = []
        self._first_time = 2**63 - 1
        self._last_time = 0
        self._schemas: dict[str, int] = {}
        self.stream = open(self.path, "wb")  # noqa: SIM115 (closed in close)
        self._mcap = Writer(self.stream, compression=CompressionType.NONE)
        self._mcap.start(profile="ros2", library="fjr_bringup")

    def add_topic(self, topic: str, type_name: str, offered: Sequence[QoSProfile], type_hash: str) -> RecordedTopic:
        """Register a topic with the QoS that its publishers offer; write its schema once per type."""
        if type_name not in self._schemas:
            text = definition(type_name).encode()
            self._schemas[type_name] = self._mcap.register_schema(type_name, "ros2msg", text)
        qos = [qos_as_dict(profile) for profile in offered]
        metadata = {"offered_qos_profiles": yaml.dump(qos, Dumper=DUMPER), "topic_type_hash": type_hash}
        number = self._mcap.register_channel(topic, "cdr", self._schemas[type_name], metadata)
        self.channels.append(RecordedTopic(number, topic, type_name, type_hash, qos))
        return self.channels[-1]

    def write(self, channel: RecordedTopic, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add one message; times [ns] since the epoch, sequence: number by its publisher."""
        self._mcap.add_message(channel.id, log_time, data, publish_time, sequence & 0xFFFFFFFF)
        channel.count += 1
        self._first_time, self._last_time = min(self._first_time, log_time), max(self._last_time, log_time)

    def flush(self) -> None:
        """End the current chunk and write it to the file."""
        self._mcap.flush()

    def close(self) -> None:
        """Write index, summary and metadata.yaml."""
        metadata = self._metadata()
        text = yaml.dump(metadata, Dumper=DUMPER, sort_keys=False)
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})
        self._mcap.finish()
        self.stream.close()
        text = yaml.dump({"rosbag2_bagfile_information": metadata}, Dumper=DUMPER, sort_keys=False)
        write_text(self.folder / "metadata.yaml", text)

    def _metadata(self) -> dict[str, Any]:
        count = sum(channel.count for channel in self.channels)
        start = {"nanoseconds_since_epoch": self._first_time if count else 0}
        duration = {"nanoseconds": self._last_time - self._first_time if count else 0}
        name = self.path.name
        topics = [
            {
                "topic_metadata": {
                    "name": channel.topic,
                    "type": channel.type_name,
                    "serialization_format": "cdr",
                    "offered_qos_profiles": channel.offered_qos,
                    "type_description_hash": channel.type_hash,
                },
                "message_count": channel.count,
            }
            for channel in self.channels
        ]
        one_file = {"path": name, "starting_time": dict(start), "duration": dict(duration), "message_count": count}
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [name],
            "files": [one_file],
            "custom_data": None,
            "ros_distro": ROS_DISTRO,
        }


def qos_as_dict(profile: QoSProfile) -> dict[str, Any]:
    """Return a QoS profile in the format of rosbag2's metadata version 9."""

    def seconds(duration: Duration) -> dict[str, int]:
        sec, nsec = divmod(duration.nanoseconds, 10**9)
        return {"sec": sec, "nsec": nsec}

    return {
        **{key: getattr(profile, key).name.lower() for key in ("history", "reliability", "durability", "liveliness")},
        **{key: seconds(getattr(profile, key)) for key in ("deadline", "lifespan", "liveliness_lease_duration")},
        **{key: getattr(profile, key) for key in ("depth", "avoid_ros_namespace_conventions")},
    }


@dataclass
class Track:
    """A recorded topic: subscription, channel in the file, publishers, first and last message, its send time [ns].

    ends: replaced as a whole, because other threads read it; None before the first message.
    """

    subscription: Subscription
    channel: RecordedTopic
    publishers: list[TopicEndpointInfo]
    ends: tuple[bytes, bytes] | None = None
    sent: int = 0


class Recorder:
    """Record from `start` to `close`; a context manager. Owns an rclpy context and one thread."""

    def __init__(self, folder: Path, topics: Collection[str] = ()) -> None:
        """topics: absolute names of the topics to record; empty: all."""
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node: Node = rclpy.create_node(
            "fjr_recorder", context=self.context, enable_rosout=False, start_parameter_services=False
        )
        self.writer = BagWriter(folder)
        self.skipped: dict[str, str] = {}  # topic -> why it is not recorded
        self.failure: Exception | None = None
        self.loss = ""  # why writing stopped; subscriptions stay active
        self._wanted = frozenset(topics)
        self._tracks: dict[str, Track] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder")

    def start(self) -> Recorder:
        """Start to discover and record topics."""
        self._thread.start()
        return self

    def close(self) -> None:
        """Empty the queues a last time and close the bag."""
        if not self._stop.is_set():
            self._stop.set()
            self._thread.join()
            self._write(self.writer.close)
            if self.loss:
                with suppress(OSError):
                    self.writer.stream.close()
            leave(self.node)
            self.context.try_shutdown()

    def __enter__(self) -> Recorder:
        return self.start()

    def __exit__(self, *_: object) -> None:
        self.close()

    def ends(self, topic: str) -> tuple[bytes, bytes] | None:
        """Return the first and latest serialised message of a topic; None before the first."""
        return self._tracks[topic].ends if topic in self._tracks else None

    def sent(self, topic: str) -> int:
        """Return the time at which the latest message of a topic was sent [ns]; 0 before the first."""
        return self._tracks[topic].sent if topic in self._tracks else 0

    def matched(self, topic: str) -> int:
        """Return the number of publishers of a topic that are matched with this recorder."""
        return self._tracks[topic].subscription.get_publisher_count() if topic in self._tracks else 0

    def _run(self) -> None:
        look = flush = 0.0
        left = False  # messages in a queue
        try:
            while not self._stop.wait(0.0 if left else DRAIN_PERIOD):
                now = time.monotonic()
                if now >= look:
                    self._discover()
                    look = now + DISCOVERY_PERIOD
                left = self._drain_all(BATCH)
                if now >= flush:
                    self._write(self.writer.flush)
                    flush = now + FLUSH_PERIOD
            self._drain_all(QUEUE_DEPTH)
        except Exception as error:  # the caller reads it and stops the run
            self.failure = error

    def _write(self, write: Callable[..., object], *arguments: object) -> None:
        """Write unless an earlier write failed; a full or missing disk ends the recording, which `loss` says."""
        if self.loss:
            return
        try:
            write(*arguments)
        except OSError as error:
            self.loss = f"recording stopped: {error.strerror or error}"
            tell(f"{self.loss}; {self.writer.path} holds the messages so far")

    def _drain_all(self, most: int) -> bool:
        """Write at most `most` messages of each topic; return whether one may have more."""
        return sum(self._drain(track, most) for track in tuple(self._tracks.values())) > 0

    def _drain(self, track: Track, most: int) -> bool:
        """Write at most `most` messages of a subscription; return whether there were as many."""
        take, kind = track.subscription.handle.take_message, track.subscription.msg_type
        write, keep, channel = self._write, self.writer.write, track.channel
        first = last = b""
        count = sent = 0
        while count < most and (taken := take(kind, True)) is not None:
            count += 1
            last, info = taken
            first = first or last
            sent = info["source_timestamp"]
            write(keep, channel, info["received_timestamp"], sent, info["publication_sequence_number"] or 0, last)
        if last:
            track.sent = sent
            track.ends = (track.ends[0] if track.ends else first, last)
        return count == most

    def _discover(self) -> None:
        """Subscribe to new topics; adapt the QoS to new publishers."""
        for topic, types in self.node.get_topic_names_and_types():
            publishers = self.node.get_publishers_info_by_topic(topic)
            if not publishers or topic in self.skipped or (self._wanted and topic not in self._wanted):
                continue
            if topic not in self._tracks:
                self._subscribe(topic, types[0], publishers)
            elif any(each not in self._tracks[topic].publishers for each in publishers):
                self._follow(self._tracks[topic], publishers)

    def _subscribe(self, topic: str, type_name: str, publishers: list[TopicEndpointInfo]) -> None:
        try:
            subscription = followed(self.node, interface_class(type_name), topic, publishers)
            digest = str(publishers[0].topic_type_hash)
            digest = digest if digest.startswith("RIHS") else hash_of(type_name)
            offered = [info.qos_profile for info in publishers]
            channel = self.writer.add_topic(topic, type_name, offered, digest)
        except SchemaError as error:
            self.skipped[topic] = str(error)
            return
        self._tracks[topic] = Track(subscription, channel, publishers)

    def _follow(self, track: Track, publishers: list[TopicEndpointInfo]) -> None:
        """Adapt the subscription to other publishers if their QoS requires it."""
        self._drain(track, QUEUE_DEPTH)
        track.publishers, old = publishers, track.subscription
        track.subscription = followed(self.node, old.msg_type, old.topic, publishers, old)
        if track.subscription is not old:
            self.node.destroy_subscription(old)


def followed(
    node: Node, kind: type, topic: str, publishers: list[TopicEndpointInfo], old: Subscription | None = None
) -> Subscription:
    """Return a subscription that suits all publishers, the old one if it does; the caller empties its queue, raw."""
    wanted = adapted_qos(publishers)
    if old is not None and old.qos_profile == wanted:
        return old
    return node.create_subscription(kind, topic, lambda _: None, wanted, raw=True)


def adapted_qos(publishers: list[TopicEndpointInfo]) -> QoSProfile:
    """Return the strongest QoS that all publishers offer, with a deep queue on the reader's side.

    A full queue refuses what is reliable, and the publisher sends it again: a plant in lock-step waits for that.
    """
    offers = [info.qos_profile for info in publishers]
    reliable = all(offer.reliability == QoSReliabilityPolicy.RELIABLE for offer in offers)
    latched = all(offer.durability == QoSDurabilityPolicy.TRANSIENT_LOCAL for offer in offers)
    return QoSProfile(
        history=QoSHistoryPolicy.KEEP_ALL if reliable else QoSHistoryPolicy.KEEP_LAST,
        depth=QUEUE_DEPTH,
        reliability=QoSReliabilityPolicy.RELIABLE if reliable else QoSReliabilityPolicy.BEST_EFFORT,
        durability=QoSDurabilityPolicy.TRANSIENT_LOCAL if latched else QoSDurabilityPolicy.VOLATILE,
    )
