# SPDX-License-Identifier: Apache-2.0
"""Message types: class, definition and hash of each.

Definitions of the standard interfaces come from rosbags' Jazzy type store; definitions of other types are read
from the ``.msg`` files of their sourced package.
"""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fjr_core.errors import FjrError


class SchemaError(FjrError):
    """The class or definition of a message type is not installed."""


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """Return the Jazzy type store, shared by writer and reader; custom types are added on use."""
    return get_typestore(Stores.ROS2_JAZZY)


def deserialize(data: bytes, type_name: str) -> Any:
    """Return a message of a known type; raise SerdeError.

    rclpy's serialize_message, with which nodes in Python write bags, leaves 4 to 12 bytes behind empty sequences.
    """
    try:
        return typestore().deserialize_cdr(data, type_name)
    except SerdeError as error:
        for behind in (4, 8, 12):
            with suppress(SerdeError):
                return typestore().deserialize_cdr(data[:-behind], type_name)
        raise error


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
        types = get_types_from_msg(text, type_name)
    except (PackageNotFoundError, OSError, ValueError, TypesysError) as error:  # another type must not end a recording
        raise SchemaError(f"no definition of message type {type_name} is installed here ({error})") from error
    for nested in _nested_types(types):
        _register(nested)
    store.register(types)


def _nested_types(node: Any) -> set[str]:
    """Return all type names (package/msg/Name) that a parsed definition refers to."""
    if isinstance(node, str):
        return {node} if node.count("/") == 2 else set()
    parts = node.values() if isinstance(node, dict) else node if isinstance(node, (tuple, list)) else ()
    return set().union(*map(_nested_types, parts))
