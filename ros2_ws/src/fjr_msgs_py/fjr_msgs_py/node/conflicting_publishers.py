# SPDX-License-Identifier: Apache-2.0
"""Detect publishers of other processes on topics that need a single owner: effort commands, /clock."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any
from uuid import uuid4

from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo

from ..native.loop import NativeSubscription
from ..native.program import Program

LISTENING = 0.25  # s
MATCHING = 1.0  # s
_POLL = 0.005  # s
_PARTICIPANT = 12  # leading bytes of an endpoint's GID, equal for all endpoints of a participant
_ANY = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # matches reliable publishers, too
_QUEUE = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)


@dataclass(frozen=True)
class Other:
    """A publisher of another process: its topic, and its node or "" if unknown."""

    topic: str
    node: str


class ConflictingPublishers:
    """Own publishers on some topics, and the publishers of other processes there, identified by their GIDs.

    Publishers of this process's own context do not count as conflicts.
    """

    def __init__(self, node: Node, kinds: Mapping[str, type], qos: QoSProfile) -> None:
        """Create a publisher and, until `trust`, a subscription on each topic; kinds: message types by topic name."""
        self._node = node
        self._kinds = {node.resolve_topic_name(topic): kind for topic, kind in kinds.items()}
        self._family = _own_participant(node, next(iter(self._kinds.values())))
        self._others: dict[bytes, Other] = {}
        self.publishers = [node.create_publisher(kind, topic, qos) for topic, kind in self._kinds.items()]
        self._listening = {  # read here only, on any thread
            topic: NativeSubscription(node, kind, topic, _ANY) for topic, kind in self._kinds.items()
        }

    def appeared(self) -> list[str]:
        """Return the topics with a publisher that did not exist at the last call."""
        before, self._others = self._others, self._found()
        return sorted({other.topic for gid, other in self._others.items() if gid not in before})

    def others_appeared(self) -> bool:
        """Return whether a publisher exists that did not at the last call of `appeared`."""
        return not self._found().keys() <= self._others.keys()

    def known(self, program: Program) -> Any:
        """Return what is known of the publishers as struct fjr_known* (graph.h), valid until the next call."""
        ffi, topics = program.ffi, [program.ffi.new("char[]", topic.encode()) for topic in self._kinds]
        own = next(iter(self._family), bytes(_PARTICIPANT))  # zeros: ours are not known
        gids = b"".join([own, *self._others])
        self._kept = ffi.new("char*[]", topics), ffi.from_buffer(gids), topics
        node = ffi.cast("void*", self._node.handle.pointer)
        self._known = ffi.new("struct fjr_known*", (node, self._kept[0], len(topics), self._kept[1], len(self._others)))
        return self._known

    @property
    def others(self) -> bool:
        """True if other processes had publishers at the last call of `appeared`."""
        return bool(self._others)

    def named(self, *topics: str) -> str:
        """Return the nodes of the other publishers on these topics, as text for a message."""
        others = self._found() or self._others
        nodes = sorted({other.node for other in others.values() if other.topic in topics} - {""})
        return f"{'node' if len(nodes) == 1 else 'one of the nodes'} {', '.join(nodes)}" if nodes else "an unknown node"

    def heard(self) -> tuple[str, Any] | None:
        """Return topic and content of the first message within LISTENING seconds, None for none; the call blocks.

        If two processes listen to each other, the one with the higher GID listens twice as long and detects the other.
        Messages from before the call are discarded, because their sender may have ended. The subscriptions exist since
        construction, so that senders are already matched.
        """
        yields = max(self._family, default=b"") > min(self._others, default=b"\xff")
        for subscription in self._listening.values():
            while subscription.take():
                pass
        return _first_heard(self._node, self._listening, 2 * LISTENING if yields else LISTENING)

    def trust(self) -> None:
        """Destroy the subscriptions; `appeared` still detects publishers by discovery."""
        for subscription in self._listening.values():
            subscription.close()
        self._listening = {}

    def close(self) -> None:
        """Destroy publishers and subscriptions."""
        self.trust()
        for publisher in self.publishers:
            self._node.destroy_publisher(publisher)

    def _found(self) -> dict[bytes, Other]:
        """Return the publishers of other processes by GID."""
        infos = [(topic, info) for topic in self._kinds for info in _others_on(self._node, topic, self._family)]
        return {bytes(info.endpoint_gid): Other(topic, node_of(info)) for topic, info in infos}


class Namesake:
    """Detect a second node of this name that publishes on a topic of this node.

    A publisher that has ended without notice stays in the graph for its lease, so one that is listed must be heard. The
    messages of one publisher arrive in the order of their sequence numbers; numbers that do not increase are of two.
    """

    def __init__(self, node: Node, name: str, kind: type) -> None:
        self._node, self._kind, self._topic = node, kind, node.resolve_topic_name(name)
        self._subscription: NativeSubscription | None = None
        self._latest = 0

    def listed(self) -> bool:
        """Return whether the graph lists a second publisher of this node's name; listen from then on."""
        found = [node_of(info) for info in self._node.get_publishers_info_by_topic(self._topic)]
        listed = found.count(self._node.get_fully_qualified_name()) > 1
        if listed and not self._subscription:
            self._subscription = NativeSubscription(self._node, self._kind, self._topic, _QUEUE)
        return listed

    def heard(self) -> bool:
        """Return whether messages of two publishers have arrived since the last call."""
        two = False
        while self._subscription and (taken := self._subscription.take()):
            number = taken[1]["publication_sequence_number"] or 0  # 0: not supported
            two, self._latest = two or number <= self._latest, number
        return two

    def close(self) -> None:
        """Stop listening."""
        if self._subscription:
            self._subscription.close()


def publisher_elsewhere(node: Node, name: str, kind: type, concerns: Callable[[Any], object]) -> str:
    """Return who else publishes a message that `concerns` this process on a topic, as text for a sentence; "": nobody.

    If other publishers exist, the call blocks until a message comes, at most for LISTENING once they are connected. It
    creates no publisher on the topic, because whoever watches over it would see a second owner, and this node must have
    none there, because its own messages would count.
    """
    topic = node.resolve_topic_name(name)
    if not node.count_publishers(topic):
        return ""
    family = _own_participant(node, kind)
    if not _others_on(node, topic, family):
        return ""
    with closing(NativeSubscription(node, kind, topic, _QUEUE)) as subscription:
        heard = _first_heard(node, {topic: subscription}, LISTENING, concerns)
    nodes = {node_of(info) for info in _others_on(node, topic, family)} - {""}
    return (", ".join(sorted(nodes)) or "an unknown node") if heard else ""


def _first_heard(
    node: Node,
    subscriptions: Mapping[str, NativeSubscription],
    seconds: float,
    concerns: Callable[[Any], object] = lambda _: True,
) -> tuple[str, Any] | None:
    """Return topic and content of the first message within `seconds` for which `concerns` is true, None for none.

    The time starts when all publishers are connected, at most MATCHING seconds after the call. It is counted in polls,
    so that it extends on busy cores, where another publisher is late as well.
    """
    latest, looks = time.monotonic() + MATCHING, round(seconds / _POLL)
    while looks:
        connected = all(each.publishers >= node.count_publishers(topic) for topic, each in subscriptions.items())
        if connected or time.monotonic() > latest:
            looks, latest = looks - 1, -math.inf
        for topic, subscription in subscriptions.items():
            while taken := subscription.take():
                if concerns(taken[0]):
                    return topic, taken[0]
        time.sleep(_POLL)
    return None


def _others_on(node: Node, topic: str, family: Collection[bytes]) -> list[TopicEndpointInfo]:
    """Return the publishers on a topic that are not of a participant of this family."""
    infos = node.get_publishers_info_by_topic(topic)
    return [info for info in infos if bytes(info.endpoint_gid)[:_PARTICIPANT] not in family]


def _own_participant(node: Node, kind: type) -> set[bytes]:
    """Return the participant of this process, found by a publisher on a unique topic."""
    topic = node.resolve_topic_name(f"_alone_{uuid4().hex}")
    publisher = node.create_publisher(kind, topic, _ANY)
    latest = time.monotonic() + MATCHING
    while not (found := node.get_publishers_info_by_topic(topic)) and time.monotonic() < latest:
        time.sleep(_POLL)
    node.destroy_publisher(publisher)
    return {bytes(info.endpoint_gid)[:_PARTICIPANT] for info in found}


def node_of(info: TopicEndpointInfo) -> str:
    """Return the node of an endpoint with its namespace, "" if it is not known yet."""
    return "" if "UNKNOWN" in info.node_name else f"{info.node_namespace.rstrip('/')}/{info.node_name}"
