# SPDX-License-Identifier: Apache-2.0
"""Read a bag back into numpy arrays: stamps, send times, and one column per joint, mapped by name.

The MCAP file is read front to back, so the bag of a run that was killed (no index, no metadata.yaml, a torn
last record) gives everything up to the last flushed chunk.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import EndOfFile, McapError
from mcap.records import Channel, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader
from numpy.typing import NDArray
from rosbags.typesys import get_types_from_msg

from fjr_bringup.schemas import typestore
from fjr_core.errors import FjrError

Array = NDArray[np.float64]
Times = NDArray[np.int64]


class BagError(FjrError):
    """A folder that is not a bag, or a bag that lacks what is asked of it."""


@dataclass
class Topic:
    """The raw messages of one topic in the order they came."""

    name: str
    type_name: str
    definition: str
    messages: list[Message] = field(default_factory=list)

    @cached_property
    def publish_time(self) -> Times:
        """Middleware's send time of each message [ns], (k,)."""
        return np.array([message.publish_time for message in self.messages], dtype=np.int64)

    @cached_property
    def log_time(self) -> Times:
        """Receive time of each message [ns], (k,)."""
        return np.array([message.log_time for message in self.messages], dtype=np.int64)

    @cached_property
    def sequence(self) -> Times:
        """Publisher's own count of its messages, (k,); zeros where the recorder did not keep it."""
        return np.array([message.sequence for message in self.messages], dtype=np.int64)

    @property
    def lost(self) -> int | None:
        """Messages sent but not recorded, from gaps in the numbering; None with several publishers."""
        steps = np.diff(self.sequence)
        return int((steps - 1).sum()) if (steps >= 1).all() else None

    def decoded(self) -> list[Any]:
        """Every message as an object with the fields of its type."""
        store = typestore()
        if self.type_name not in store.fielddefs:
            store.register(get_types_from_msg(self.definition, self.type_name))
        return [store.deserialize_cdr(message.data, self.type_name) for message in self.messages]


@dataclass(frozen=True)
class JointTable:
    """A JointState topic as arrays: k messages, n joints in the order asked for; absent values are NaN."""

    stamp: Times  # (k,) header stamp [ns]
    publish_time: Times  # (k,) send time [ns]
    position: Array  # (k, n)
    velocity: Array  # (k, n)
    effort: Array  # (k, n)


@dataclass(frozen=True)
class Bag:
    """All topics of a bag. `complete` tells whether the recorder closed it."""

    path: Path
    topics: dict[str, Topic]
    complete: bool

    def topic(self, name: str) -> Topic:
        """One topic; raises BagError, naming what was recorded, when there is none or it is empty."""
        if name not in self.topics or not self.topics[name].messages:
            recorded = ", ".join(sorted(name for name, topic in self.topics.items() if topic.messages)) or "nothing"
            raise BagError(f"{self.path} holds no message of {name}; it holds {recorded}")
        return self.topics[name]

    def joints(self, name: str, joints: Sequence[str]) -> JointTable:
        """A JointState topic with columns in the order of `joints`, whatever order the messages have."""
        topic = self.topic(name)
        messages = topic.decoded()
        stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages], dtype=np.int64)
        columns = (_columns(messages, what, joints) for what in ("position", "velocity", "effort"))
        return JointTable(stamps, topic.publish_time, *columns)

    def lost(self) -> dict[str, int | None]:
        """Messages sent but not recorded, by topic; None where it cannot be known."""
        return {name: topic.lost for name, topic in sorted(self.topics.items()) if topic.messages}

    def counters(self) -> dict[str, dict[str, str]]:
        """The last /diagnostics of each part: name -> key -> value, as published."""
        last: dict[str, dict[str, str]] = {}
        for message in self.topics["/diagnostics"].decoded() if "/diagnostics" in self.topics else []:
            for status in message.status:
                last[status.name] = {pair.key: pair.value for pair in status.values}
        return last


def read_bag(path: str | Path) -> Bag:
    """Read a bag folder or a single .mcap file; raises BagError."""
    path = Path(path)
    files = sorted(path.glob("*.mcap")) if path.is_dir() else [path]
    if not files or not all(file.is_file() for file in files):
        raise BagError(f"{path} is not a bag: expected a folder with an .mcap file, or such a file")
    topics: dict[str, Topic] = {}
    complete = [_read_file(file, topics) for file in files]
    return Bag(path, topics, all(complete))


def _read_file(path: Path, topics: dict[str, Topic]) -> bool:
    """Add the messages of one file to `topics`; true when the file ends as a closed file does."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Topic] = {}
    with open(path, "rb") as stream:
        try:
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message):
                    channels[record.channel_id].messages.append(record)
                elif isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels[record.id] = _topic(record, schemas[record.schema_id], topics)
                elif isinstance(record, DataEnd):
                    return True
        except (EndOfFile, struct.error):
            return False  # torn at the end by a kill: all before it is good
        except McapError as error:
            raise BagError(f"{path} is not a readable MCAP file: {error}") from error
    return False


def _topic(channel: Channel, schema: Schema, topics: dict[str, Topic]) -> Topic:
    return topics.setdefault(channel.topic, Topic(channel.topic, schema.name, schema.data.decode()))


def _columns(messages: Sequence[Any], what: str, joints: Sequence[str]) -> Array:
    """Values `what` of the named joints, (k, n)."""
    table = np.full((len(messages), len(joints)), np.nan)
    places: dict[tuple[str, ...], list[int]] = {}
    for row, message in enumerate(messages):
        names, values = tuple(message.name), getattr(message, what)
        if names not in places:
            places[names] = [names.index(joint) if joint in names else -1 for joint in joints]
        for column, place in enumerate(places[names]):
            if 0 <= place < len(values):
                table[row, column] = values[place]
    return table


def header_stamp(data: bytes) -> int:
    """Stamp [ns] of a serialised message that starts with a std_msgs/Header."""
    sec, nanosec = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(sec) * 10**9 + int(nanosec)
