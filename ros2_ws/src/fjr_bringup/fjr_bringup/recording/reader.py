# SPDX-License-Identifier: Apache-2.0
"""Read a bag back into numpy arrays: stamps, send times, and one column per joint, mapped by name."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.recording.formats import files_of, read_file
from fjr_bringup.recording.topic import BagError, Contents, Messages, Times, Topic
from fjr_msgs_py.messages.cdr.layout import FIELDS
from fjr_msgs_py.messages.cdr.recorded import joint_state_arrays

Array = NDArray[np.float64]
JOINT_STATE, DIAGNOSTICS = "sensor_msgs/msg/JointState", "/diagnostics"


@dataclass(frozen=True)
class JointTable:
    """A JointState topic as arrays: k messages, n joints in the requested order; absent values are NaN."""

    stamp: Times  # (k,) header stamp [ns]
    publish_time: Times  # (k,) send time [ns]
    position: Array  # (k, n)
    velocity: Array  # (k, n)
    effort: Array  # (k, n)


@dataclass(frozen=True)
class Bag:
    """All topics of a bag. complete: closed by the recorder; namespace: of its nodes; notes: one sentence a loss.

    A topic without an exact match is searched for in all namespaces; an ambiguous match is an error.
    """

    path: Path
    topics: dict[str, Topic]
    complete: bool
    namespace: str = ""
    notes: tuple[str, ...] = ()

    def holds(self, name: str) -> bool:
        """Return whether a topic has messages."""
        return self._full_name(name) is not None

    def topic(self, name: str) -> Topic:
        """Return a topic; raise BagError, listing the recorded topics, if it is missing or empty."""
        found = self._full_name(name)
        if found is None:
            recorded = sorted(name for name, topic in self.topics.items() if topic.messages)
            held = ", ".join(recorded) or ("nothing" if self.complete else "nothing, and was not closed")
            raise BagError(f"{self.path} holds no message of {self.namespace}{name}; it holds {held}")
        return self.topics[found]

    def _full_name(self, name: str) -> str | None:
        recorded = [topic for topic, found in self.topics.items() if found.messages]
        if self.namespace + name in recorded:
            return self.namespace + name
        others = [] if self.namespace else [topic for topic in recorded if topic.endswith(name)]
        if len(others) > 1:
            raise BagError(f"{self.path} holds {' and '.join(sorted(others))}: name one of them by its --namespace")
        return others[0] if others else None

    def joints(self, name: str, joints: Sequence[str]) -> JointTable:
        """Return a JointState topic as arrays with columns in the order of `joints`; raise BagError."""
        topic = self.topic(name)
        if topic.type_name != JOINT_STATE:
            raise BagError(f"{topic.name} of {self.path} is a {topic.type_name}; expected {JOINT_STATE}")
        (first,) = topic.first(1)
        arrays = joint_state_arrays([message.data for message in topic.messages], first)
        if arrays is None:
            return _one_by_one(topic, joints)
        stamp, values = arrays
        return JointTable(stamp, topic.publish_time, *(_named(values[what], first.name, joints) for what in FIELDS))

    def lost(self) -> dict[str, int | None]:
        """Return the number of lost messages by topic; None if unknown."""
        return {name: topic.lost for name, topic in sorted(self.topics.items()) if topic.messages}

    def counters(self) -> dict[str, dict[str, str]]:
        """Return the last /diagnostics status of each name: name -> key -> value, as published."""
        last: dict[str, dict[str, str]] = {}
        for message in self.topic(DIAGNOSTICS).decoded if self.holds(DIAGNOSTICS) else []:
            for status in message.status:
                last[status.name] = {pair.key: pair.value for pair in status.values}
        return last


def read_bag(path: str | Path, namespace: str = "") -> Bag:
    """Read a bag, given its folder, one of its files or the folder of a run; raise BagError.

    namespace: of the topics, empty or with a leading slash.
    """
    path = bag_folder(Path(path))
    contents = Contents()
    complete = [_keep(read_file(file, contents)) for file in files_of(path)]
    for topic in contents.topics.values():
        topic.messages.sort(key=lambda message: message.log_time)
    return Bag(path, contents.topics, all(complete), namespace, tuple(contents.notes))


def _keep(messages: Messages) -> bool:
    """Add the messages of a file to their topics; return whether the file was closed."""
    while True:
        try:
            topic, message = next(messages)
        except StopIteration as end:
            return bool(end.value)
        topic.messages.append(message)


def bag_folder(path: Path) -> Path:
    """Return the folder of the bag of a run; any other path as it is."""
    return path / "bag" if (path / "bag").is_dir() else path


def _named(values: Array, names: Sequence[str], joints: Sequence[str]) -> Array:
    """Return the columns of the named joints, (k, n), of values (k, at most the number of names)."""
    table = np.full((len(values), len(joints)), np.nan)
    for column, joint in enumerate(joints):
        place = names.index(joint) if joint in names else -1
        if 0 <= place < values.shape[1]:
            table[:, column] = values[:, place]
    return table


def _one_by_one(topic: Topic, joints: Sequence[str]) -> JointTable:
    """Return a topic whose messages differ in names or lengths."""
    messages = topic.decoded
    stamps = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in messages], dtype=np.int64)
    return JointTable(stamps, topic.publish_time, *(_columns(messages, what, joints) for what in FIELDS))


def _columns(messages: Sequence[Any], what: str, joints: Sequence[str]) -> Array:
    """Return the field `what` of the named joints, (k, n)."""
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
    """Return the stamp [ns] of a serialised message that starts with a std_msgs/Header."""
    sec, nanosec = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(sec) * 10**9 + int(nanosec)
