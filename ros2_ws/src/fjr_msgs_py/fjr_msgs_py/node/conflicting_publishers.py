# SPDX-License-Identifier: Apache-2.0
"""Other processes that publish on a topic which is to have one owner: efforts to a robot, the time."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

LISTENING = 0.25  # s
MATCHING = 1.0  # s
_POLL = 0.005  # s
_PARTICIPANT = 12  # bytes of an endpoint's GID that all endpoints of one participant share
_ANY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # hears reliable publishers, too


@dataclass(frozen=True)
class Other:
    """A publisher in another process: its topic and its node, "" where that is not known."""

    topic: str
    node: str


class Rivals:
    """Watches the topics of publishers of ours for publishers in other processes, each known by its GID.

    Those of this process's own context are no rivals: what runs in it was put together on purpose.
    """

    def __init__(self, node: Node, kinds: Mapping[str, type], qos: QoSProfile) -> None:
        """Create a publisher and, until `trust`, a subscription on each topic; kinds: messages by name of the topic."""
        self._node = node
        self._kinds = {node.resolve_topic_name(topic): kind for topic, kind in kinds.items()}
        self._family = self._own_participant()
        self._others: dict[bytes, Other] = {}
        self.publishers = [node.create_publisher(kind, topic, qos) for topic, kind in self._kinds.items()]
        self._listening = [(topic, kind, self._listen(topic, kind)) for topic, kind in self._kinds.items()]

    def appeared(self) -> list[str]:
        """The topics on which a publisher is there that was not at the last call."""
        before, self._others = self._others, self._found()
        return sorted({other.topic for gid, other in self._others.items() if gid not in before})

    @property
    def others(self) -> bool:
        """Whether publishers in other processes were there at the last call of `appeared`."""
        return bool(self._others)

    def named(self, *topics: str) -> str:
        """The nodes of all that are there on these topics, in words."""
        others = self._found() or self._others
        nodes = sorted({other.node for other in others.values() if other.topic in topics} - {""})
        return f"{'node' if len(nodes) == 1 else 'one of the nodes'} {', '.join(nodes)}" if nodes else "an unknown node"

    def heard(self) -> str:
        """The topic on which anybody publishes within LISTENING seconds, "" for none; everything else waits.

        They count from the moment on that all publishers are connected, MATCHING seconds later at most, and only while
        this process gets to look every _POLL: where the cores are busy, another publisher is late as well. Of two that
        listen to each other the one with the higher GID waits twice as long, and hears the other. Messages from before
        the call do not count: their sender may have ended. The subscriptions are older than the call, so that senders
        have found them and their next messages arrive.
        """
        yields = max(self._family, default=b"") > min(self._others, default=b"\xff")
        latest = time.monotonic() + MATCHING
        looks = round(LISTENING * (2 if yields else 1) / _POLL)
        self._taken()
        while looks:
            if time.monotonic() > latest or self._connected():
                looks, latest = looks - 1, -math.inf
            if topic := self._taken():
                return topic
            time.sleep(_POLL)
        return ""

    def trust(self) -> None:
        """Listen no more: from now on others are seen, not heard."""
        for *_, subscription in self._listening:
            self._node.destroy_subscription(subscription)
        self._listening = []

    def close(self) -> None:
        """End the publishers and subscriptions."""
        self.trust()
        for publisher in self.publishers:
            self._node.destroy_publisher(publisher)

    def _own_participant(self) -> set[bytes]:
        """The participant of this process, known by a publisher on a topic that nobody else can have."""
        topic = self._node.resolve_topic_name(f"_alone_{uuid4().hex}")
        publisher = self._node.create_publisher(next(iter(self._kinds.values())), topic, _ANY)
        latest = time.monotonic() + MATCHING
        while not (found := self._on(topic)) and time.monotonic() < latest:
            time.sleep(_POLL)
        self._node.destroy_publisher(publisher)
        return {gid[:_PARTICIPANT] for gid in found}

    def _found(self) -> dict[bytes, Other]:
        """The publishers in other processes by their GIDs."""
        publishers = {gid: other for topic in self._kinds for gid, other in self._on(topic).items()}
        return {gid: other for gid, other in publishers.items() if gid[:_PARTICIPANT] not in self._family}

    def _on(self, topic: str) -> dict[bytes, Other]:
        """All publishers on a topic by their GIDs."""
        infos = self._node.get_publishers_info_by_topic(topic)
        return {bytes(info.endpoint_gid): Other(topic, _name(info.node_namespace, info.node_name)) for info in infos}

    def _connected(self) -> bool:
        counts = ((heard.get_publisher_count(), topic) for topic, _, heard in self._listening)
        return all(count >= self._node.count_publishers(topic) for count, topic in counts)

    def _taken(self) -> str:
        """A topic on which a message waited, "" where none did; takes one of each topic, all that their queues hold."""
        found = ""
        for topic, kind, subscription in self._listening:
            with subscription.handle:
                if subscription.handle.take_message(kind, True) is not None:
                    found = topic
        return found

    def _listen(self, topic: str, kind: type) -> Any:
        return self._node.create_subscription(kind, topic, lambda _: None, _ANY)


def _name(namespace: str, node: str) -> str:
    return "" if "UNKNOWN" in node else f"{namespace.rstrip('/')}/{node}"
