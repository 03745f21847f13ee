# SPDX-License-Identifier: Apache-2.0
"""Write a rosbag2 bag (MCAP storage, metadata version 9 as in Jazzy) that stays readable after a kill.

Messages are grouped in chunks with a message index. `BagWriter.flush` ends the current chunk: flushed messages
are readable even if the process is killed before `BagWriter.close` writes summary and metadata.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from mcap.writer import CompressionType, Writer
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from fjr_core.files.text_file import write_text
from fjr_monitor.recording import message_types

METADATA_VERSION = 9
ROS_DISTRO = "jazzy"
DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)  # in C where PyYAML was built with libyaml


@dataclass
class Channel:
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
        self.channels: list[Channel] = []
        self._first_time = 2**63 - 1
        self._last_time = 0
        self._schemas: dict[str, int] = {}
        self._stream = open(self.path, "wb")  # noqa: SIM115 (closed in close)
        self._mcap = Writer(self._stream, compression=CompressionType.NONE)
        self._mcap.start(profile="ros2", library="fjr_bringup")
        self._stream.flush()

    def add_topic(self, topic: str, type_name: str, offered: Sequence[QoSProfile], type_hash: str) -> Channel:
        """Register a topic with the QoS that its publishers offer; write its schema once per type."""
        if type_name not in self._schemas:
            text = message_types.definition(type_name).encode()
            self._schemas[type_name] = self._mcap.register_schema(type_name, "ros2msg", text)
        qos = [qos_as_dict(profile) for profile in offered]
        metadata = {"offered_qos_profiles": yaml.dump(qos, Dumper=DUMPER), "topic_type_hash": type_hash}
        number = self._mcap.register_channel(topic, "cdr", self._schemas[type_name], metadata)
        self.channels.append(Channel(number, topic, type_name, type_hash, qos))
        return self.channels[-1]

    def write(self, channel: Channel, log_time: int, publish_time: int, sequence: int, data: bytes) -> None:
        """Add one message; times [ns] since the epoch, sequence: number by its publisher."""
        self._mcap.add_message(channel.id, log_time, data, publish_time, sequence & 0xFFFFFFFF)
        channel.count += 1
        if log_time < self._first_time:
            self._first_time = log_time
        if log_time > self._last_time:
            self._last_time = log_time

    def flush(self) -> None:
        """End the current chunk and write it to the file."""
        self._mcap.flush()

    def close(self) -> None:
        """Write index, summary and metadata.yaml."""
        metadata = self._metadata()
        text = yaml.dump(metadata, Dumper=DUMPER, sort_keys=False)
        self._mcap.add_metadata("rosbag2", {"serialized_metadata": text})
        self._mcap.finish()
        self._stream.close()
        text = yaml.dump({"rosbag2_bagfile_information": metadata}, Dumper=DUMPER, sort_keys=False)
        write_text(self.folder / "metadata.yaml", text)

    def abandon(self) -> None:
        """Close the file without summary and metadata."""
        with suppress(OSError):
            self._stream.close()

    def _metadata(self) -> dict[str, Any]:
        count = sum(channel.count for channel in self.channels)
        start = {"nanoseconds_since_epoch": self._first_time if count else 0}
        duration = {"nanoseconds": self._last_time - self._first_time if count else 0}
        name = self.path.name
        one_file = {"path": name, "starting_time": dict(start), "duration": dict(duration), "message_count": count}
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": [_topic_entry(channel) for channel in self.channels],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [name],
            "files": [one_file],
            "custom_data": None,
            "ros_distro": ROS_DISTRO,
        }


def qos_as_dict(profile: QoSProfile) -> dict[str, Any]:
    """Return a QoS profile in the format of rosbag2's metadata version 9."""
    return {
        "history": profile.history.name.lower(),
        "depth": profile.depth,
        "reliability": profile.reliability.name.lower(),
        "durability": profile.durability.name.lower(),
        "deadline": _seconds(profile.deadline),
        "lifespan": _seconds(profile.lifespan),
        "liveliness": profile.liveliness.name.lower(),
        "liveliness_lease_duration": _seconds(profile.liveliness_lease_duration),
        "avoid_ros_namespace_conventions": profile.avoid_ros_namespace_conventions,
    }


def _seconds(duration: Duration) -> dict[str, int]:
    sec, nsec = divmod(duration.nanoseconds, 10**9)
    return {"sec": sec, "nsec": nsec}


def _topic_entry(channel: Channel) -> dict[str, Any]:
    topic = {
        "name": channel.topic,
        "type": channel.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": channel.offered_qos,
        "type_description_hash": channel.type_hash,
    }
    return {"topic_metadata": topic, "message_count": channel.count}
