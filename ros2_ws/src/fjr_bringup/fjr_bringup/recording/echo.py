# SPDX-License-Identifier: Apache-2.0
"""`fjr echo`: the messages of a topic as YAML, for machines without ros2cli."""

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

from fjr_bringup.recording.message_types import message_class
from fjr_bringup.recording.recorder import adapted_qos
from fjr_core.errors import FjrError
from fjr_msgs_py.messages.plain import plain

POLL = 0.02  # s between looks at the graph or the queue
PATIENCE = 2.0  # s of silence before it is said


class EchoError(FjrError):
    """A topic without messages."""


class TopicError(FjrError):
    """A name that no topic can have."""


def echo(topic: str, count: int | None, timeout: float, stop: threading.Event) -> int:
    """Print messages until `count` of them have come or `stop` is set; returns their number.

    Raises EchoError when none comes for `timeout` [s], SchemaError for a type that is not installed.
    """
    topic = absolute(topic)
    shown = 0
    with listening() as node:
        for message in _messages(node, topic, timeout, stop):
            print(text(message), flush=True)
            shown += 1
            if shown == count:
                break
    return shown


def absolute(topic: str) -> str:
    """A topic's name from the root; raises TopicError where that is none."""
    name = topic if topic.startswith("/") else f"/{topic}"
    try:
        validate_full_topic_name(name)
    except InvalidTopicNameException:
        raise TopicError(
            f"'{topic}' is no topic's name; expected letters, digits, _ and single /, e.g. /joint_states"
        ) from None
    return name


def text(message: Any) -> str:
    """A message as a YAML document."""
    return yaml.safe_dump(plain(message), sort_keys=False, default_flow_style=None, width=math.inf) + "---"


@contextmanager
def listening(name: str = "fjr_echo", arguments: list[str] | None = None) -> Iterator[Node]:
    """A node of its own that no signal ends; arguments: as after --ros-args."""
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
    """Messages as they come, from the first publisher on."""
    subscription = None
    heard = time.monotonic()
    said = False
    while not stop.wait(POLL):
        publishers = node.get_publishers_info_by_topic(topic)
        if subscription is None and publishers:
            kind = message_class(publishers[0].topic_type)
            subscription = node.create_subscription(kind, topic, lambda _: None, adapted_qos(publishers))
        while subscription is not None and (taken := subscription.handle.take_message(kind, False)) is not None:
            heard = time.monotonic()
            yield taken[0]
        silent = time.monotonic() - heard
        if silent > timeout:
            raise EchoError(f"no message of {topic} for {timeout:g} s; {_there(node)}")
        if silent > PATIENCE and not said:
            said = True
            print(f"fjr: waiting for {topic}; {_there(node)}", file=sys.stderr, flush=True)


def _there(node: Node) -> str:
    topics = [name for name, _ in node.get_topic_names_and_types()]
    published = sorted(name for name in topics if node.count_publishers(name))
    with suppress(ValueError):
        published.remove("/parameter_events")
    return f"published are {', '.join(published) or 'none'}"
