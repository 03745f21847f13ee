# SPDX-License-Identifier: Apache-2.0
"""Serve the arm of `fjr watch --browser` to browsers on this computer: a page, and events with its scene and states."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any

from fjr_core.errors import FjrError
from fjr_monitor.report.html import environment
from fjr_monitor.scene import scene
from fjr_msgs_py.console.output import json_text

HOST = "127.0.0.1"
LAST = 1.0  # s; longest wait for the open pages to take the last event
POLL = 1.0  # s; longest wait for a view until it is checked whether the server ends
SAFE = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; img-src data:"


class PortError(FjrError):
    """The page cannot be served at a port."""


class BrowserPage:
    """A page at `url` that shows the arm in 3D; `show` updates it. Closed at the end of a with block."""

    def __init__(self, port: int, title: str, locked: Mapping[str, float] | None = None) -> None:
        """port: 0 for any free one. locked: positions [rad, m] of joints that do not move. Raises PortError."""
        self._locked = dict(locked or {})
        self._urdf, self._events = "", {"scene": "", "view": ""}
        self._count, self._open, self._ended = 0, 0, False
        self._changed = threading.Condition()
        try:
            self._server = _Server((HOST, port), self, page(title))
        except OSError as error:
            raise PortError(f"port {port} cannot be used ({error.strerror}); expected a free one, or 0") from None
        self.url = f"http://{HOST}:{self._server.server_port}/"
        threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True).start()

    def show(self, view: Mapping[str, Any], urdf: str) -> None:
        """Send a view (View as a dictionary) to the open pages, and the scene of the URDF if it has changed."""
        events = {"view": json_text(view)}
        if urdf and urdf != self._urdf:
            self._urdf = urdf
            try:
                events["scene"] = json_text(scene(urdf, self._locked))
            except FjrError as error:
                events["scene"] = json_text({"error": str(error)})
        with self._changed:
            self._events |= events
            self._count += 1
            self._changed.notify_all()

    @contextmanager
    def stream(self) -> Iterator[Iterator[str]]:
        """Give the server-sent events for one page: the scene, and the latest view as often as the page takes one."""
        with self._changed:
            self._open += 1
        try:
            yield self._events_of_a_page()
        finally:
            with self._changed:
                self._open -= 1
                self._changed.notify_all()

    def _events_of_a_page(self) -> Iterator[str]:
        shown, sent = 0, ""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._count > shown or self._ended, POLL)  # noqa: B023
                shown, events, ended = self._count, dict(self._events), self._ended
            if ended:
                yield "event: end\ndata:\n\n"
                return
            if events["scene"] != sent:
                sent = events["scene"]
                yield f"event: scene\ndata: {sent}\n\n"
            if events["view"]:
                yield f"event: view\ndata: {events['view']}\n\n"

    def __enter__(self) -> BrowserPage:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify_all()
            self._changed.wait_for(lambda: not self._open, LAST)
        self._server.shutdown()
        self._server.server_close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # browsers open connections in advance

    def __init__(self, address: tuple[str, int], source: BrowserPage, content: str) -> None:
        super().__init__(address, _Answer)
        self.source, self.content = source, content.encode()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing for a browser that has closed its connection, at whatever moment."""
        if not isinstance(sys.exc_info()[1], OSError):
            super().handle_error(request, client_address)


class _Answer(BaseHTTPRequestHandler):
    server: _Server
    timeout = 5.0  # s; a page that takes nothing for so long is given up

    def do_GET(self) -> None:
        if self.headers.get("Host", "").partition(":")[0] not in (HOST, "localhost"):
            self.send_error(403)  # a page of another site whose name leads to this computer
        elif self.path == "/":
            self._begin("text/html; charset=utf-8")
            self.wfile.write(self.server.content)
        elif self.path == "/events":
            self._begin("text/event-stream")
            with suppress(OSError), self.server.source.stream() as events:  # OSError: the page was closed
                for event in events:
                    self.wfile.write(event.encode())
        else:
            self.send_error(404)

    def _begin(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", SAFE)
        self.end_headers()

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing: the terminal shows the address only."""


def page(title: str) -> str:
    """Return the page; raises AssetError."""
    nothing: dict[str, Any] = {"arrays": [], "plots": [], "arm": None}
    footer = "Drag turns the arm; a click and then the wheel zooms; a double-click goes back."
    return environment().get_template("live.html").render(title=title, plots=nothing, footer=footer)
