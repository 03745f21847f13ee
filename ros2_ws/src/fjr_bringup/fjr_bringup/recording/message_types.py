# SPDX-License-Identifier: Apache-2.0
"""Message classes and full message definitions by type name, for recording and reading bags.

Definitions of the standard interfaces come from rosbags' Jazzy type store. Any other type is read from the
``.msg`` files its package installs, so custom messages are recorded too where their package is sourced.
"""

from __future__ import annotations

from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from fjr_core.errors import FjrError


class SchemaError(FjrError):
    """A message type whose class or definition is not installed."""


@lru_cache(maxsize=1)
def typestore() -> Typestore:
    """The Jazzy type store, shared by writer and reader; grows by the custom types it meets."""
    return get_typestore(Stores.ROS2_JAZZY)


def message_class(type_name: str) -> Any:
    """Class of ``sensor_msgs/msg/JointState`` and the like, as rclpy's subscriptions want it."""
    package, _, name = type_name.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise SchemaError(f"message type {type_name} is not installed here ({error})") from error


def definition(type_name: str) -> str:
    """Full text of a definition with all nested types, as an MCAP schema of encoding ``ros2msg`` holds it."""
    _learn(type_name)
    return typestore().generate_msgdef(type_name, ros_version=2)[0]


def type_hash(type_name: str) -> str:
    """REP-2016 hash of a type, ``RIHS01_...``."""
    _learn(type_name)
    return typestore().hash_rihs01(type_name)


def _learn(type_name: str) -> None:
    """Register a type that the store lacks from its installed ``.msg`` file, nested types included."""
    store = typestore()
    if type_name in store.fielddefs:
        return
    types = get_types_from_msg(_installed_definition(type_name), type_name)
    store.register(types)
    for nested in _nested_types(types):
        _learn(nested)


def _installed_definition(type_name: str) -> str:
    package, _, name = type_name.partition("/msg/")
    try:
        return Path(get_package_share_directory(package), "msg", f"{name}.msg").read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError) as error:
        raise SchemaError(f"no definition of message type {type_name} is installed here ({error})") from error


def _nested_types(node: Any) -> set[str]:
    """All type names a parsed definition refers to (strings of the form package/msg/Name)."""
    if isinstance(node, str):
        return {node} if node.count("/") == 2 else set()
    if isinstance(node, dict):
        return set().union(*(_nested_types(value) for value in node.values()))
    if isinstance(node, (tuple, list)):
        return set().union(*(_nested_types(value) for value in node))
    return set()
