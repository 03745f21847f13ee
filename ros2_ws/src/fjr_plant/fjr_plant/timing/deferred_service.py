# SPDX-License-Identifier: Apache-2.0
"""A service that answers when what was asked for is done, not when its callback returns."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger


class Answer:
    """The answer that somebody waits for; given once, at any time."""

    def __init__(self, response: Trigger.Response, send: Callable[[Trigger.Response, Any], None]) -> None:
        self._response = response
        self._send = send
        self._given = False
        self._header: Any = None

    def give(self, success: bool, message: str) -> None:
        """Send the answer to the client."""
        self._response.success, self._response.message = success, message
        self._given = True
        self._send_when_whole()

    def address(self, header: Any) -> None:
        """Tell whom it is for."""
        self._header = header
        self._send_when_whole()

    def _send_when_whole(self) -> None:
        if self._given and self._header is not None:
            self._send(self._response, self._header)


class DeferredTrigger:
    """A Trigger service whose callback takes an Answer, to be given now or later.

    Works with every executor of rclpy: the events executor of 7.1 takes no coroutines as service callbacks, so
    what the executor would send when the callback returns is kept, with the address, until it is complete.
    """

    def __init__(self, node: Node, name: str, callback: Callable[[Answer], None]) -> None:
        self._callback = callback
        self._service = node.create_service(Trigger, name, self._on_request)
        self._send = self._service.send_response
        self._service.send_response = self._keep
        self._answer: Answer

    def _on_request(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._answer = Answer(response, self._send)
        self._callback(self._answer)
        return response

    def _keep(self, _: Trigger.Response, header: Any) -> None:
        self._answer.address(header)
