# SPDX-License-Identifier: Apache-2.0
"""Events of a node on ~/events."""

from __future__ import annotations

from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import QoSProfile

from ..names import EVENTS

STAMP = "stamp_ns"
"""Key of the stamp of the sample that an event belongs to."""
LEVELS = {"info": DiagnosticStatus.OK, "warn": DiagnosticStatus.WARN, "error": DiagnosticStatus.ERROR}


class EventWriter:
    """Publisher of events: DiagnosticStatus with level, kind as name, one sentence as message, and values."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticStatus, EVENTS, QoSProfile(depth=100))

    def publish(self, level: str, kind: str, sentence: str, values: Mapping[str, float | str] | None = None) -> None:
        """Publish an event of level info, warn or error."""
        pairs = [KeyValue(key=key, value=str(value)) for key, value in (values or {}).items()]
        self._publisher.publish(DiagnosticStatus(level=LEVELS[level], name=kind, message=sentence, values=pairs))

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)
