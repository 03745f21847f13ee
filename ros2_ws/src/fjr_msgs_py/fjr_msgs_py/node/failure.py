# SPDX-License-Identifier: Apache-2.0
"""End a node if a callback raises an FjrError; refuse a request or message that raises anything else."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ClassVar

from rcl_interfaces.msg import SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
from rclpy.node import Node
from rclpy.task import Future

from fjr_core import FjrError

LONGEST = 500  # characters of a sentence about a request


class EndingNode(Node):
    """Mixin of a node that ends if a callback of a timer, subscription or service raises an FjrError.

    Later callbacks then do nothing, and the process exits with the message of the error. No message and no request ends
    the node with another exception: it is refused with one sentence in the log. rclpy's own services and its
    subscription to /clock raise such exceptions, for example for a parameter of an unknown type.
    """

    values: dict[str, Any]
    in_process: ClassVar[bool] = False
    """Whether process.run runs the node; it then looks at `ended` itself."""
    host: Any = None
    """The NodeProcess of the node, if it has one."""
    ended: FjrError | None = None
    """The error that ended the node."""
    over: Future
    """Done once the process of the node is to end."""
    unexpected: Exception | None = None
    """The latest exception that is no FjrError, of a message or a request."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        self.over = Future()
        super().__init__(*arguments, **keywords)

    def end(self, error: FjrError) -> None:
        """End the node: its process exits with the error, or the error is logged if the node has no process."""
        self.ended = error
        self.over.set_result(None)
        if not self.in_process:
            self.get_logger().error(f"ended: {error}")

    def stop(self) -> None:
        """Send the last messages before the process ends."""

    def built(self) -> None:
        """Report to the process that the objects of the callbacks are built; raises ParameterError."""
        if self.host is not None:
            self.host.apply_process_settings(self.values)

    def create_timer(self, seconds: float, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a timer as rclpy's Node does; an FjrError of the callback ends the node."""
        return super().create_timer(seconds, self._ending(callback), *args, **kwargs)

    def create_subscription(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a subscription as rclpy's Node does; an FjrError of the callback ends the node."""
        return super().create_subscription(kind, name, self._ending(callback, f"a message on {name}"), *args, **kwargs)

    def create_service(self, kind: Any, name: str, callback: Callable[..., Any], *args: Any, **kwargs: Any) -> Any:
        """Create a service as rclpy's Node does; an FjrError of the callback ends the node after the response."""
        return super().create_service(kind, name, self._ending(callback, f"a request to {name}"), *args, **kwargs)

    def guard_services(self) -> None:
        """Guard the services that rclpy creates by itself, lifecycle and type description; they outlive the end."""
        for service in self.services:
            service.callback = self._ending(service.callback, f"a request to {service.srv_name}", outlives=True)

    def _ending(self, callback: Callable[..., Any], what: str = "", outlives: bool = False) -> Callable[..., Any]:
        """Return a callback that ends the node by an FjrError; what: refuses, under this name, what raises another.

        outlives: call it after the end, too.
        """

        @wraps(callback)
        def call(*arguments: Any) -> Any:
            if outlives or self.ended is None:
                try:
                    return callback(*arguments)
                except FjrError as error:
                    self.end(error)
                except Exception as error:
                    if not what:
                        raise
                    self.unexpected = error
                    sentence = f"{what} was refused: {type(error).__name__}: {error}"[:LONGEST]
                    self.get_logger().error(sentence, throttle_duration_sec=1.0)
                    fill_refusal(*arguments, sentence=sentence)
            return arguments[-1] if arguments else None

        return call


def fill_refusal(request: Any, response: Any = None, *, sentence: str) -> None:
    """Fill the response of a service: not successful, with the reason; an entry for each parameter without result."""
    for field, value in (("success", False), ("message", sentence)):
        if hasattr(response, field):
            setattr(response, field, value)
    refused = SetParametersResult(successful=False, reason=sentence)
    if isinstance(response, SetParametersAtomically.Response):
        response.result = refused
    elif isinstance(response, SetParameters.Response):
        response.results += [refused] * (len(request.parameters) - len(response.results))
