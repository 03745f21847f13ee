# SPDX-License-Identifier: Apache-2.0
"""`fjr echo`: print the messages of a topic as YAML, without ros2cli."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import yaml
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.validate_full_topic_name import validate_full_topic_name

from fjr_core.errors import FjrError, ParameterError
from fjr_monitor.recording.message_types import interface_class
from fjr_monitor.recording.recorder import adapted_qos
from fjr_msgs_py.console.output import json_text
from fjr_msgs_py.messages.plain import plain
from fjr_msgs_py.node.loading import domain
from fjr_msgs_py.node.participant import own_node

POLL = 0.02  # s between looks at the graph or the queue
PATIENCE = 2.0  # s without a message before a notice is printed


class TopicError(FjrError):
    """No message arrived."""


def echo(topic: str, count: int | None, timeout: float, stop: threading.Event, as_json: bool = False) -> int:
    """Print messages until `count` have arrived or `stop` is set; return their number.

    as_json: one JSON document a line instead of YAML.
    Raise TopicError after `timeout` [s] without a message, SchemaError if the type is not installed.
    """
    topic = absolute(topic)
    shown = 0
    with own_node("fjr_echo") as node:
        for message in _messages(node, topic, timeout, stop):
            print(json_text(plain(message)) if as_json else text(message), flush=True)
            shown += 1
            if shown == count:
                break
    return shown


def absolute(given: str, kind: str = "topic", example: str = "/joint_states") -> str:
    """Return the absolute name of a topic, service or node (kind); raise ParameterError if the name is invalid."""
    name = given if given.startswith("/") else f"/{given}"
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException:
        raise ParameterError(
            f"'{given}' is not a {kind} name; expected letters, digits, _ and single /, e.g. {example}"
        ) from None
    return name


def text(message: Any) -> str:
    """Format a message as a YAML document."""
    return yaml.safe_dump(plain(message), sort_keys=False, default_flow_style=None, width=math.inf) + "---"


def _messages(node: Node, topic: str, timeout: float, stop: threading.Event) -> Iterator[Any]:
    """Yield messages as they arrive, once there is a publisher."""
    subscription = None
    received = time.monotonic()
    notified = False
    while not stop.wait(POLL):
        publishers = node.get_publishers_info_by_topic(topic)
        if subscription is None and publishers:
            kind = interface_class(publishers[0].topic_type)
            subscription = node.create_subscription(kind, topic, lambda _: None, adapted_qos(publishers))
        while subscription is not None and (taken := subscription.handle.take_message(kind, False)) is not None:
            received = time.monotonic()
            yield taken[0]
        silent = time.monotonic() - received
        if silent > timeout:
            raise TopicError(
                f"no message of {topic} for {timeout:g} s; {_published(node)}; {nodes_seen(node)}; {ELSEWHERE}"
            )
        if silent > PATIENCE and not notified:
            notified = True
            print(f"fjr: waiting for {topic} in ROS domain {domain()}; {_published(node)}", file=sys.stderr, flush=True)


def nodes_seen(node: Node) -> str:
    """Return the other nodes in the ROS domain of a node, for a message."""
    names = node.get_node_names_and_namespaces()
    nodes = sorted(f"{space.rstrip('/')}/{name}" for name, space in names if name != node.get_name())
    return f"nodes in ROS domain {domain()}: {', '.join(nodes) or 'none'}"


ELSEWHERE = "start the nodes, or set the ROS_DOMAIN_ID in which they run"


def _published(node: Node) -> str:
    topics = [name for name, _ in node.get_topic_names_and_types()]
    published = sorted(name for name in topics if node.count_publishers(name))
    with suppress(ValueError):
        published.remove("/parameter_events")
    return f"published are {', '.join(published) or 'none'}"
