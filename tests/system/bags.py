# SPDX-License-Identifier: Apache-2.0
"""Derive bags from a recorded one by the rosbags library: other storages, fewer topics, other messages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
JOINT_STATE = "sensor_msgs/msg/JointState"
Change = Callable[[str, Any], Any]
TALKER = """
import sys, time
from pathlib import Path
import rclpy
from std_msgs.msg import String
from fjr_monitor.recording.recorder import Recorder
recorder = Recorder(Path(sys.argv[1])).start()
rclpy.init()
node = rclpy.create_node("talker")
publisher = node.create_publisher(String, "/words", 10)
while not (publisher.get_subscription_count() and recorder.matched("/words")):
    time.sleep(0.005)
"""
"""Beginning of scripts in which a process records its own messages: defines sys, time, recorder and publisher."""


def joint_state(stamp: int, names: Sequence[str] = (), frame: str = "", **fields: Sequence[float]) -> bytes:
    """Return a serialised JointState with a stamp [ns] and some of position, velocity and effort."""
    when = STORE.types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9))
    values = [np.array(fields.get(name, ()), dtype=float) for name in ("position", "velocity", "effort")]
    message = STORE.types[JOINT_STATE](STORE.types["std_msgs/msg/Header"](when, frame), list(names), *values)
    return bytes(STORE.serialize_cdr(message, JOINT_STATE))


def text_message(text: str) -> bytes:
    """Return a serialised String."""
    return bytes(STORE.serialize_cdr(STORE.types["std_msgs/msg/String"](text), "std_msgs/msg/String"))


def rewritten(
    bag: Path,
    target: Path,
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    topics: tuple[str, ...] = (),
    change: Change | None = None,
    prefix: str = "",
    compression: CompressionMode = CompressionMode.NONE,
) -> Path:
    """Copy a bag. topics: to keep, empty for all; change: (topic, message) -> new message, None to drop it."""
    writer = Writer(target, version=9, storage_plugin=storage)
    if compression is not CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with AnyReader([bag], default_typestore=STORE) as reader, writer:
        kept = [each for each in reader.connections if not topics or each.topic in topics]
        made = {
            each.id: writer.add_connection(prefix + each.topic, each.msgtype, typestore=STORE, msgdef=each.msgdef.data)
            for each in kept
        }
        for each, time, raw in reader.messages(kept):
            data = raw
            if change is not None:
                message = change(each.topic, STORE.deserialize_cdr(raw, each.msgtype))
                data = None if message is None else STORE.serialize_cdr(message, each.msgtype)
            if data is not None:
                writer.write(made[each.id], time, data)
    return target
