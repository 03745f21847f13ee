# SPDX-License-Identifier: Apache-2.0
"""Service that replies when the requested work is done, not when its callback returns."""

from __future__ import annotations

from collections.abc import Callable
from threading import Lock
from typing import Any

from rclpy.node import Node
from std_srvs.srv import Trigger


class DeferredReply:
    """Reply to a waiting client; given once, at any time."""

    def __init__(self, response: Trigger.Response, send: Callable[[Trigger.Response, Any], None]) -> None:
        self._response = response
        self._send = send
        self._given = self._sent = False
        self._complete = Lock()  # the reply may be given by another thread than that of the service
        self._header: Any = None

    def give(self, success: bool, message: str) -> None:
        """Send the reply to the client."""
        self._response.success, self._response.message = success, message
        self._given = True
        self._send_when_complete()

    def address(self, header: Any) -> None:
        """Set the address of the client."""
        self._header = header
        self._send_when_complete()

    def _send_when_complete(self) -> None:
        with self._complete:
            if self._given and self._header is not None and not self._sent:
                self._sent = True
                self._send(self._response, self._header)


class DeferredTrigger:
    """Trigger service whose callback receives a DeferredReply, to be given now or later.

    It works with every executor of rclpy. The events executor of 7.1 does not accept coroutines as service callbacks;
    therefore the response that the executor sends when the callback returns is held back until it is complete.
    """

    def __init__(self, node: Node, name: str, callback: Callable[[DeferredReply], None]) -> None:
        self._callback = callback
        self._service = node.create_service(Trigger, name, self._on_request)
        self._send = self._service.send_response
        self._service.send_response = self._keep
        self._reply: DeferredReply

    def _on_request(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._reply = DeferredReply(response, self._send)
        self._callback(self._reply)
        return response

    def _keep(self, _: Trigger.Response, header: Any) -> None:
        self._reply.address(header)
