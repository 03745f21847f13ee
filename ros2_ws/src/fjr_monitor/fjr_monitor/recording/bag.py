# SPDX-License-Identifier: Apache-2.0
"""Read a bag of any size: what it holds, its messages by receive time, joint states as arrays by joint name."""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np
from mcap.records import Message

from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Table
from fjr_monitor.recording import files
from fjr_monitor.recording.files import BagError, Contents, Messages, Times, Topic
from fjr_msgs_py.messages.cdr import FIELDS, joint_state_arrays
from fjr_msgs_py.names import DIAGNOSTICS, JOINT_STATES

STATES = f"/{JOINT_STATES}"
JOINT_STATE, FLOATS = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
AHEAD_MESSAGES, AHEAD_BYTES = 40_000, 2**26
"""What is read ahead, and sorted, at most: the first limit that is reached counts."""
STEP = 10**8  # ns; times that decrease by more are not of messages out of order: they were set back


@dataclass(frozen=True)
class JointTable(Table):
    """A JointState topic as arrays: k messages, n joints in the requested order; absent values are NaN."""

    stamp: Times  # (k,) header stamp [ns]
    publish_time: Times  # (k,) send time [ns]
    position: Array  # (k, n)
    velocity: Array  # (k, n)
    effort: Array  # (k, n)


@dataclass(frozen=True)
class Bag:
    """What a bag holds; its messages are read when they are asked for, so that its size does not matter.

    topics: those with messages. complete: closed by the recorder; namespace: of its nodes; notes: one sentence a loss.
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

    def held(self, name: str) -> Topic:
        """Return a topic without its messages; raise BagError, listing the recorded topics, if it has none."""
        found = self._full_name(name)
        if found is None:
            held = ", ".join(sorted(self.topics)) or ("nothing" if self.complete else "nothing, and was not closed")
            raise BagError(f"{self.path} holds no message of {self.namespace}{name}; it holds {held}")
        return self.topics[found]

    def topic(self, name: str) -> Topic:
        """Return a topic with all its messages in memory; raise BagError as `held` does."""
        found = self.held(name)
        return replace(found, messages=[message for _, message in in_order(self.path, (found.name,))])

    def _full_name(self, name: str) -> str | None:
        for own in (self.namespace + name, *(name,) * (name == DIAGNOSTICS)):  # which all robots share
            if own in self.topics:
                return own
        spaces = [] if self.namespace else [each.removesuffix(name) for each in self.topics if each.endswith(name)]
        if STATES in self.topics:  # a namespace with states of its own is that of another robot
            spaces = [space for space in spaces if space + STATES not in self.topics]
        if len(spaces) > 1:
            held = " and ".join(sorted(space + name for space in spaces))
            raise BagError(f"{self.path} holds {held}; expected one, or its namespace")
        return spaces[0] + name if spaces else None

    def table(self, topic: Topic, joints: Sequence[str]) -> JointTable:
        """Return the messages of a topic of JointStates, or of efforts in the order of `joints`, as arrays."""
        if topic.type_name == FLOATS:
            return _efforts(topic, len(joints))
        if topic.type_name != JOINT_STATE:
            raise BagError(f"{topic.name} of {self.path} is a {topic.type_name}; expected {JOINT_STATE}")
        if not topic.messages:
            times, values = np.zeros(0, dtype=np.int64), np.zeros((0, len(joints)))
            return JointTable(times, times, values, values, values)
        (first,) = topic.decode(topic.messages[:1])
        arrays = joint_state_arrays([message.data for message in topic.messages], first)
        if arrays is not None:
            stamp, columns = arrays
            named = [_named(columns[what], first.name, joints) for what in FIELDS]
            return JointTable(stamp, topic.publish_time, *named)
        found = topic.decoded  # messages differ in names or lengths
        stamp = np.array([m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in found], dtype=np.int64)
        rows = [[_named(np.atleast_2d(getattr(m, what)), m.name, joints) for m in found] for what in FIELDS]
        return JointTable(stamp, topic.publish_time, *map(np.concatenate, rows))

    def batches(self, names: Collection[str], leading: str, size: int) -> Iterator[dict[str, Topic]]:
        """Yield the messages of topics, as they were sent, in batches of `size` messages of the leading topic.

        A message that was received late, beside busy programs for example, has its place among the others.
        """
        full = {self.held(name).name: name for name in names}
        batch = {name: replace(self.topics[each], messages=[]) for each, name in full.items()}
        for each, message in in_order(self.path, full, sent=True):
            messages = batch[full[each]].messages
            messages.append(message)
            if full[each] == leading and len(messages) == size:
                yield batch
                batch = {name: replace(topic, messages=[]) for name, topic in batch.items()}
        yield batch


def read_bag(path: str | Path, namespace: str = "") -> Bag:
    """Return what a bag holds, given its folder, one of its files or the folder of a run; raise BagError.

    namespace: of the topics, empty or with a leading slash.
    """
    path, contents = bag_folder(Path(path)), Contents()
    for topic, message in read_files(path, contents):
        topic.note(message)
    topics = {name: topic for name, topic in contents.topics.items() if topic.count}
    return Bag(path, topics, contents.complete, namespace, tuple(contents.notes))


def read_files(path: Path, contents: Contents) -> Messages:
    """Yield the messages of a bag's files; topics, losses and the number of messages are added to `contents`.

    Within a file receive and send times of a topic decrease together only where the clock stepped back. Times go on
    there, by the step of the first topic that shows it. Receive times alone decrease if a message is sent again.
    """
    latest = 0  # what is added to times behind the last step
    for file in files.files_of(path):
        if file.is_file() and file.stat().st_size == 0:
            contents.complete = False
            continue
        clocks: dict[str, tuple[int, int, int]] = {}  # by topic: newest receive and send time, what is added to both
        for topic, message in files.READERS.get(file.suffix, files.read_compressed)(file, contents):
            received, sent, added = clocks.get(topic.name, (0, 0, latest))
            if message.log_time + added < received - STEP and message.publish_time + added < sent - STEP:
                if message.log_time + latest < received - STEP:
                    before, latest = latest, max(clocks.values())[0] + 1 - message.log_time
                    back = (latest - before) * 1e-9
                    contents.notes.append(f"the clock stepped back by {back:.2f} s: send times go on from there")
                added = latest
            if added:
                message.log_time = min(message.log_time + added, files.LATEST - 1)
                message.publish_time = min(message.publish_time + added, files.LATEST - 1)
            message.log_time = max(message.log_time, received - STEP)  # it was under way while the clock stepped
            clocks[topic.name] = max(received, message.log_time), max(sent, message.publish_time), added
            yield topic, message


def in_order(path: Path, names: Collection[str], sent: bool = False) -> Iterator[tuple[str, Message]]:
    """Yield topic and message of the named topics by receive time, or by the time they were sent; raise BagError.

    Messages are sorted as far as AHEAD_MESSAGES and AHEAD_BYTES reach; recorders write them almost sorted.
    """
    ahead: list[tuple[int, str, Message]] = []
    size, wanted = 0, frozenset(names)
    for topic, message in read_files(bag_folder(path), Contents(wanted=wanted)):
        if topic.name not in wanted:
            continue
        ahead.append((message.publish_time if sent else message.log_time, topic.name, message))
        size += len(message.data)
        if len(ahead) > AHEAD_MESSAGES or size > AHEAD_BYTES:
            ahead.sort(key=itemgetter(0))
            half = max(1, len(ahead) // 2)
            yield from (each[1:] for each in ahead[:half])
            del ahead[:half]
            size = sum(len(each.data) for _, _, each in ahead)
    yield from (each[1:] for each in sorted(ahead, key=itemgetter(0)))


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


def _efforts(topic: Topic, n: int) -> JointTable:
    """Return the efforts of n joints in arrays of numbers, which carry no stamp; other lengths are left out."""
    valid = [len(each.data) == n for each in topic.decoded]
    times, data = topic.publish_time[valid], [each.data for each in topic.decoded if len(each.data) == n]
    nothing = np.full((len(times), n), np.nan)
    return JointTable(times, times, nothing, nothing, np.array(data).reshape(-1, n))


def header_stamp(data: bytes) -> int:
    """Return the stamp [ns] of a serialised message that starts with a std_msgs/Header."""
    sec, nanosec = struct.unpack_from("<iI" if data[1] & 1 else ">iI", data, 4)
    return int(sec) * 10**9 + int(nanosec)
