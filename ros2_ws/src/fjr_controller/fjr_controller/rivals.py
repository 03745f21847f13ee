# SPDX-License-Identifier: Apache-2.0
"""Other processes that publish efforts to the same robot."""

from __future__ import annotations

import time
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy

LISTENING = 0.25  # s
_POLL = 0.005  # s
_PARTICIPANT = 12  # bytes of an endpoint's GID that all endpoints of one participant share
_ANY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # hears reliable publishers, too


class Rivals:
    """Watches the topic of a publisher of ours for publishers in other processes.

    Those of this process's own context are no rivals: what runs in it was put together on purpose.
    """

    def __init__(self, node: Node, kind: type, topic: str, **qos: Any) -> None:
        """Create the publisher of messages `kind` on `topic`; what is said on it is also listened to here."""
        self._node, self._kind = node, kind
        before = self._gids(node.resolve_topic_name(topic))
        self.publisher: Publisher = node.create_publisher(kind, topic, **qos)
        self.topic = self.publisher.topic_name
        self._family = {gid[:_PARTICIPANT] for gid in self._gids(self.topic) - before}
        self._count = 1
        self._others: dict[bytes, str] = {}

    def appeared(self) -> bool:
        """Whether a publisher is there that was not at the last call; cheap where their number is the same."""
        count = self._node.count_publishers(self.topic)
        if count == self._count:
            return False
        self._count = count
        before, self._others = self._others, self._found()
        return not set(self._others) <= set(before)

    def named(self) -> str:
        """The nodes of all that are there, in words."""
        others = self._found() or self._others
        nodes = sorted(set(others.values()) - {""})
        return f"{'node' if len(nodes) == 1 else 'one of the nodes'} {', '.join(nodes)}" if nodes else "an unknown node"

    def _found(self) -> dict[bytes, str]:
        """GIDs of the publishers in other processes, with the names of their nodes where these are known."""
        infos = self._node.get_publishers_info_by_topic(self.topic)
        return {
            gid: "" if "UNKNOWN" in info.node_name else f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for info in infos
            if (gid := bytes(info.endpoint_gid))[:_PARTICIPANT] not in self._family
        }

    def is_heard(self) -> bool:
        """Whether anybody publishes on the topic within LISTENING seconds, in which everything else waits.

        Of two that listen to each other the one with the higher GID waits twice as long, and hears the other.
        """
        subscription = self._node.create_subscription(self._kind, self.topic, lambda _: None, _ANY)
        try:
            yields = max(self._family, default=b"") > min(self._others, default=b"\xff")
            end = time.monotonic() + LISTENING * (2 if yields else 1)
            while time.monotonic() < end:
                with subscription.handle:
                    if subscription.handle.take_message(self._kind, True) is not None:
                        return True
                time.sleep(_POLL)
            return False
        finally:
            self._node.destroy_subscription(subscription)

    def close(self) -> None:
        """End the publisher."""
        self._node.destroy_publisher(self.publisher)

    def _gids(self, topic: str) -> set[bytes]:
        return {bytes(info.endpoint_gid) for info in self._node.get_publishers_info_by_topic(topic)}
