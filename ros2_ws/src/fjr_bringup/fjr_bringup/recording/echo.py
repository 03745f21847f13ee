# SPDX-License-Identifier: Apache-2.0
"""`fjr echo`: print the messages of a topic as YAML, without ros2cli."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import rclpy
import yaml
from rclpy.exceptions import InvalidTopicNameException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.validate_full_topic_name import validate_full_topic_name

from fjr_bringup.recording.message_types import interface_class
from fjr_bringup.recording.recorder import adapted_qos
from fjr_bringup.result import json_text
from fjr_core.errors import FjrError
from fjr_msgs_py.messages.plain import plain

POLL = 0.02  # s between looks at the graph or the queue
PATIENCE = 2.0  # s without a message before a notice is printed


class TopicError(FjrError):
    """An invalid topic name, or no message arrived on the topic."""


def echo(topic: str, count: int | None, timeout: float, stop: threading.Event, as_json: bool = False) -> int:
    """Print messages until `count` have arrived or `stop` is set; return their number.

    as_json: one JSON document a line instead of YAML.
    Raise TopicError after `timeout` [s] without a message, SchemaError if the type is not installed.
    """
    topic = absolute(topic)
    shown = 0
    with listening() as node:
        for message in _messages(node, topic, timeout, stop):
            print(json_text(plain(message)) if as_json else text(message), flush=True)
            shown += 1
            if shown == count:
                break
    return shown


def absolute(given: str, kind: str = "topic", example: str = "/joint_states") -> str:
    """Return the absolute name of a topic, service or node (kind); raise TopicError if the name is invalid."""
    name = given if given.startswith("/") else f"/{given}"
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException:
        raise TopicError(
            f"'{given}' is not a {kind} name; expected letters, digits, _ and single /, e.g. {example}"
        ) from None
    return name


def text(message: Any) -> str:
    """Format a message as a YAML document."""
    return yaml.safe_dump(plain(message), sort_keys=False, default_flow_style=None, width=math.inf) + "---"


@contextmanager
def listening(name: str = "fjr_echo", arguments: list[str] | None = None) -> Iterator[Node]:
    """Create a node in its own context, without signal handlers; arguments: as after --ros-args."""
    context = rclpy.Context()
    ros = ["--ros-args", *arguments] if arguments else None
    rclpy.init(args=ros, context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node(name, context=context, enable_rosout=False, start_parameter_services=False)
        yield node
        node.destroy_node()
    finally:
        context.try_shutdown()


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
            raise TopicError(f"no message of {topic} for {timeout:g} s; {_published(node)}")
        if silent > PATIENCE and not notified:
            notified = True
            print(f"fjr: waiting for {topic}; {_published(node)}", file=sys.stderr, flush=True)


def _published(node: Node) -> str:
    topics = [name for name, _ in node.get_topic_names_and_types()]
    published = sorted(name for name in topics if node.count_publishers(name))
    with suppress(ValueError):
        published.remove("/parameter_events")
    return f"published are {', '.join(published) or 'none'}"
