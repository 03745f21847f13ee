# SPDX-License-Identifier: Apache-2.0
"""A topic: its message type with class, definition and hash, and what a bag holds of it.

Definitions of the standard interfaces come from rosbags' Jazzy type store; definitions of other types are read
from the ``.msg`` files of their sourced package.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Generator, Iterable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from mcap.records import Message
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fjr_core.errors import FjrError

Times = NDArray[np.int64]
TYPE_NAME = re.compile(r"[A-Za-z]\w*/(msg|srv|action)/[A-Za-z]\w*", re.ASCII)
LONGEST_DEFINITION = 2**20  # characters
LATEST = 2**63  # ns


class SchemaError(FjrError):
    """The class or definition of a message type is not installed."""


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Return the Jazzy type store, shared by writer and reader; custom types are added on use."""
    return get_typestore(Stores.ROS2_JAZZY)


def interface_class(type_name: str) -> Any:
    """Return the rclpy class of a type name such as ``sensor_msgs/msg/JointState`` or ``std_srvs/srv/Trigger``.

    Raise SchemaError if it is not installed.
    """
    package, _, name = type_name.rpartition("/")
    try:
        return getattr(import_module(package.replace("/", ".")), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise SchemaError(f"type {type_name} is not installed here ({error})") from error


def definition(type_name: str) -> str:
    """Return the definition with all nested types, as in an MCAP schema of encoding ``ros2msg``; raise SchemaError."""
    _register(type_name)
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """Return the REP-2016 hash of a type, ``RIHS01_...``."""
    _register(type_name)
    return typestore().hash_rihs01(type_name)


def _register(type_name: str) -> None:
    """Register a missing type and its nested types from their installed ``.msg`` files."""
    store = typestore()
    if type_name in store.fielddefs:
        return
    package, _, name = type_name.partition("/msg/")
    try:
        text = Path(get_package_share_directory(package), "msg", f"{name}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError) as error:
        raise SchemaError(f"no definition of message type {type_name} is installed here ({error})") from error
    types = get_types_from_msg(text, type_name)
    store.register(types)
    for nested in _nested_types(types):
        _register(nested)


def _nested_types(node: Any) -> set[str]:
    """Return all type names (package/msg/Name) that a parsed definition refers to."""
    if isinstance(node, str):
        return {node} if node.count("/") == 2 else set()
    if isinstance(node, dict):
        return set().union(*(_nested_types(value) for value in node.values()))
    if isinstance(node, (tuple, list)):
        return set().union(*(_nested_types(value) for value in node))
    return set()


class BagError(FjrError):
    """A bag that is missing, unreadable or without the requested topic."""


@dataclass
class Topic:
    """A topic and what a bag holds of it: the number of messages, first and last receive time [ns], lost messages.

    lost: by gaps in the sequence numbers; None with several publishers. messages: in the order they were received,
    where they were read (Bag.topic).
    """

    name: str
    type_name: str
    definition: str
    messages: list[Message] = field(default_factory=list)
    count: int = 0
    first: int = 2**63
    last: int = 0
    lost: int | None = 0
    sequence: int = 0

    def note(self, message: Message) -> None:
        """Count a message."""
        if self.count and self.lost is not None:
            step = message.sequence - self.sequence  # 0: not recorded
            self.lost = self.lost + step - 1 if step >= 1 else None
        self.sequence = message.sequence
        self.count += 1
        self.first, self.last = min(self.first, message.log_time), max(self.last, message.log_time)

    @cached_property
    def publish_time(self) -> Times:
        """Send time of each message by the middleware [ns], (k,); receive time if the bag holds no send times."""
        return np.array([message.publish_time for message in self.messages], dtype=np.int64)

    @cached_property
    def decoded(self) -> list[Any]:
        """All messages, deserialised; raise BagError for an invalid type, definition or message."""
        return self.decode(self.messages)

    def decode(self, messages: Iterable[Message]) -> list[Any]:
        """Return messages of this topic, deserialised; raise BagError as `decoded` does."""
        if not TYPE_NAME.fullmatch(self.type_name):
            raise BagError(f"{self.name} has the type {self.type_name!r}; expected one like sensor_msgs/msg/JointState")
        if len(self.definition) > LONGEST_DEFINITION:
            raise BagError(f"{self.name} has a definition of {len(self.definition)} characters; expected a message's")
        try:
            store = typestore()
            if self.type_name not in store.fielddefs:
                store.register(get_types_from_msg(self.definition, self.type_name))
            return [store.deserialize_cdr(message.data, self.type_name) for message in messages]
        except Exception as error:  # any error of the decoder
            raise BagError(f"{self.name} holds bytes that are not a {self.type_name} ({error})") from error


@dataclass
class Contents:
    """What the files of a bag hold so far: topics by name, number of messages, and one sentence for each loss.

    wanted: topics whose messages are needed; None: all. A reader may leave out the others.
    """

    topics: dict[str, Topic] = field(default_factory=dict)
    count: int = 0
    notes: list[str] = field(default_factory=list)
    wanted: Collection[str] | None = None

    def topic(self, name: str, type_name: str, definition: str) -> Topic:
        """Return the topic of this name; add it if it is new."""
        return self.topics.setdefault(name, Topic(name, type_name, definition))


Messages = Generator[tuple[Topic, Message], None, bool]
"""The messages of a file, each with its topic; the value at the end is whether the file was closed."""
