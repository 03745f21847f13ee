# SPDX-License-Identifier: Apache-2.0
"""Derive bags from a recorded one by the rosbags library: other storages, fewer topics, other messages."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
Change = Callable[[str, Any], Any]


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
    with AnyReader([bag], default_typestore=STORE) as reader, _writer(target, storage, compression) as writer:
        kept = [each for each in reader.connections if not topics or each.topic in topics]
        made = {
            each.id: writer.add_connection(prefix + each.topic, each.msgtype, typestore=STORE, msgdef=each.msgdef.data)
            for each in kept
        }
        for each, time, raw in reader.messages(kept):
            data = raw if change is None else _changed(each, raw, change)
            if data is not None:
                writer.write(made[each.id], time, data)
    return target


def _changed(connection: Any, raw: bytes, change: Change) -> bytes | None:
    message = change(connection.topic, STORE.deserialize_cdr(raw, connection.msgtype))
    return None if message is None else bytes(STORE.serialize_cdr(message, connection.msgtype))


def _writer(target: Path, storage: StoragePlugin, compression: CompressionMode) -> Writer:
    writer = Writer(target, version=9, storage_plugin=storage)
    if compression is not CompressionMode.NONE:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    return writer
