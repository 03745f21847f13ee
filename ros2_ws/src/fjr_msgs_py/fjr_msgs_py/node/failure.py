# SPDX-License-Identifier: Apache-2.0
"""A node that ends, and its process with it, where a callback raises an FjrError."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Protocol

from rclpy.node import Node

from fjr_core import FjrError


class Host(Protocol):
    """The process of a node."""

    def end(self, error: FjrError) -> None:
        """The node has ended: let the process end with the error's sentence."""

    def take_care(self, values: Mapping[str, Any]) -> None:
        """Something large was built from these values: care for the cycles that follow; raises ParameterError."""


class EndingNode(Node):
    """Mixin of a node that ends where one of its callbacks raises an FjrError.

    An FjrError that a callback of a timer, a subscription or a service raises ends the node: no such callback does
    anything from then on, and the process around it ends with the error's sentence.
    """

    values: dict[str, Any]
    host: Host | None = None
    """The process, where the node has one of its own (fjr_msgs_py/node/process.py)."""
    ended: FjrError | None = None
    """Why the node has ended."""

    def end(self, error: FjrError) -> None:
        """Do nothing more; without a process of its own the node says why in the log."""
        self.ended = error
        if self.host is None:
            self.get_logger().error(f"ended: {error}")
        else:
            self.host.end(error)

    def built(self) -> None:
        """Tell the process that what answers messages is built, again if need be; raises ParameterError."""
        if self.host is not None:
            self.host.take_care(self.values)

    def create_timer(self, seconds: float, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """As of rclpy's Node; an FjrError of the callback ends the node."""
        return super().create_timer(seconds, self._ending(callback), *args, **kwargs)

    def create_subscription(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """As of rclpy's Node; an FjrError of the callback ends the node."""
        return super().create_subscription(kind, name, self._ending(callback), *args, **kwargs)

    def create_service(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """As of rclpy's Node; an FjrError of the callback ends the node, and the response is sent as it is then."""
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
