# SPDX-License-Identifier: Apache-2.0
"""Shut a node and its process down if a callback raises an FjrError."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Protocol

from rclpy.node import Node

from fjr_core import FjrError


class Host(Protocol):
    """The process of a node."""

    def end(self, error: FjrError) -> None:
        """Let the process exit with the message of the error; the node has ended."""

    def apply_process_settings(self, values: Mapping[str, Any]) -> None:
        """Apply the process settings of the values after large objects were built; raises ParameterError."""


class EndingNode(Node):
    """Mixin of a node that ends if a callback of a timer, subscription or service raises an FjrError.

    Later callbacks then do nothing, and the process exits with the message of the error.
    """

    values: dict[str, Any]
    host: Host | None = None
    """The process, if the node has its own (fjr_msgs_py/node/process.py)."""
    ended: FjrError | None = None
    """The error that ended the node."""

    def end(self, error: FjrError) -> None:
        """End the node: its process exits with the error, or the error is logged if the node has no process."""
        self.ended = error
        if self.host is None:
            self.get_logger().error(f"ended: {error}")
        else:
            self.host.end(error)

    def built(self) -> None:
        """Report to the process that the objects of the callbacks are built; raises ParameterError."""
        if self.host is not None:
            self.host.apply_process_settings(self.values)

    def create_timer(self, seconds: float, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a timer as rclpy's Node does; an FjrError of the callback ends the node."""
        return super().create_timer(seconds, self._ending(callback), *args, **kwargs)

    def create_subscription(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a subscription as rclpy's Node does; an FjrError of the callback ends the node."""
        return super().create_subscription(kind, name, self._ending(callback), *args, **kwargs)

    def create_service(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a service as rclpy's Node does; an FjrError of the callback ends the node after the response."""
        return super().create_service(kind, name, self._ending(callback), *args, **kwargs)

    def _ending(self, callback: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(callback)
        def call(*arguments: Any) -> Any:
            if self.ended is None:
                try:
                    return callback(*arguments)
                except FjrError as error:
                    self.end(error)
            return arguments[-1] if arguments else None

        return call
