# SPDX-License-Identifier: Apache-2.0
"""Receive large messages in a DDS participant of their own, so that they delay no other message of the node."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event, Thread

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from .participant import leave
from .scheduling import step_back


class SeparateSubscription:
    """A subscription on a thread and in a participant of its own; both yield to loops.

    Fast DDS receives all messages of a participant on one thread per transport. This thread allocates a message, and
    waits while another thread copies it: 20 MB keep the states of the same participant waiting twice for 8 ms.
    """

    def __init__(self, node: Node, kind: type, topic: str, on_message: Callable[[bytes], object]) -> None:
        """on_message: called with each serialised message on the thread that spins `node`."""
        self._node, self._on_message, self._created = node, on_message, Event()
        self._context = Context()
        rclpy.init(
            args=[],
            context=self._context,
            domain_id=node.context.get_domain_id(),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._thread = Thread(target=self._receive, args=(kind, node.resolve_topic_name(topic)), daemon=True)
        self._thread.start()
        self._created.wait()

    def close(self) -> None:
        """End the thread and leave the domain."""
        self._context.try_shutdown()
        self._thread.join()

    def _receive(self, kind: type, topic: str) -> None:
        """Create the participant, whose threads inherit the scheduling of this one, and spin until `close`."""
        step_back(0)  # its threads also take locks for which loops wait
        inbox = Node(
            f"_{self._node.get_name()}_inbox",
            namespace=self._node.get_namespace(),
            context=self._context,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._subscription = inbox.create_subscription(kind, topic, self._forward, 10, raw=True)
        executor = SingleThreadedExecutor(context=self._context)
        executor.add_node(inbox)
        self._created.set()
        try:
            executor.spin()
        except ExternalShutdownException:
            pass
        finally:
            executor.shutdown()
            leave(inbox)

    def _forward(self, data: bytes) -> None:
        if self._node.executor is not None:
            self._node.executor.create_task(self._on_message, data)
