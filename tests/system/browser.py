# SPDX-License-Identifier: Apache-2.0
"""A headless Chromium without network, controlled by its DevTools protocol."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import pytest
from websockets.sync.client import connect

from fjr_engines import film

LIMIT = 300.0  # s
FLAGS = (
    *film.FLAGS,
    "--hide-scrollbars",
    "--remote-debugging-port=0",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)
DRAWN = 100  # coloured pixels; a line across a plot has more
SOFTWARE = "GL Driver Message (OpenGL, Performance"  # logged because the processor draws
# Count the pixels of each plot that are neither grey nor transparent, i.e. not axes or grid.
COLOURED = """[...document.querySelectorAll(".uplot canvas")].map((canvas) => {
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  let coloured = 0;
  for (let i = 0; i < data.length; i += 4) {
    const [red, green, blue] = [data[i], data[i + 1], data[i + 2]];
    if (data[i + 3] > 64 && Math.max(red, green, blue) - Math.min(red, green, blue) > 40) coloured++;
  }
  return coloured;
})"""


class Browser:
    """A browser with one tab; `said`: console output of the page, `asked`: its requests."""

    def __init__(self) -> None:
        name = next((found for name in film.BROWSERS if (found := shutil.which(name))), None)
        if name is None:
            pytest.skip("no Chromium here: install the package chromium")
        self._profile = tempfile.TemporaryDirectory(prefix="fjr-chromium-", ignore_cleanup_errors=True)
        sandbox = ("--no-sandbox",) if os.geteuid() == 0 else ()
        command = [name, *FLAGS, *sandbox, f"--user-data-dir={self._profile.name}", "about:blank"]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._socket = connect(self._address(), max_size=None, open_timeout=LIMIT)
        self._count = 0
        self.said: list[str] = []
        self.asked: list[str] = []
        for domain in ("Runtime", "Log", "Network", "Page"):
            self.call(f"{domain}.enable")

    def _address(self) -> str:
        """Return the address of the tab, once the browser has written its port."""
        file, end = Path(self._profile.name, "DevToolsActivePort"), time.monotonic() + LIMIT
        while not (file.is_file() and file.read_text().count("\n")):
            assert time.monotonic() < end, "Chromium did not start"
            assert self._process.poll() is None, "Chromium ended at once"
            time.sleep(0.05)
        port = file.read_text().split()[0]
        with urlopen(f"http://127.0.0.1:{port}/json/list", timeout=LIMIT) as answer:
            tabs = json.load(answer)
        return next(tab["webSocketDebuggerUrl"] for tab in tabs if tab["type"] == "page")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and wait for its reply; record events that arrive before it."""
        self._count += 1
        self._socket.send(json.dumps({"id": self._count, "method": method, "params": parameters}))
        while True:
            message = self._receive()
            if message.get("id") == self._count:
                assert "error" not in message, message
                return message["result"]

    def open(self, page: Path | str, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        """Open a file from disk, as a double click does, or an address, and wait until it is drawn."""
        self.said.clear()
        self.asked.clear()
        self.size(width, height)
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.call("Page.navigate", url=page if isinstance(page, str) else page.absolute().as_uri())
        while self._receive().get("method") != "Page.loadEventFired":
            pass
        self.settle()

    def size(self, width: int, height: int) -> None:
        self._width = width
        self.call(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=width < 600
        )

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer
        return answer["result"].get("value")

    def settle(self) -> None:
        """Wait until all pending drawing is done."""
        self.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done))))")

    def mouse(self, kind: str, x: float, y: float, held: bool = False) -> None:
        button = "none" if kind == "mouseMoved" and not held else "left"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=int(held), clickCount=1)

    def coloured(self) -> list[int]:
        """Return the number of coloured pixels of each plot."""
        return list(self.value(COLOURED))

    def overflows(self) -> list[str]:
        """Return the ids of figures that are narrower than their plot."""
        wider = "figure.querySelector('canvas').clientWidth > figure.clientWidth"
        return list(
            self.value(
                f"[...document.querySelectorAll('figure')].filter((figure) => {wider}).map((figure) => figure.id)"
            )
        )

    def figures(self) -> list[str]:
        """Return the ids of the figures."""
        return list(self.value("[...document.querySelectorAll('figure')].map((figure) => figure.id)"))

    def is_sound(self) -> None:
        """Check that a page from disk has no errors, fetches nothing, draws every plot and fits its window."""
        assert self.said == []
        assert [url for url in self.asked if not url.startswith(("file:", "data:"))] == []
        drawn = dict(zip(self.figures(), self.coloured(), strict=True))
        assert min(drawn.values()) > DRAWN, drawn
        assert self.overflows() == []
        assert self.value("document.documentElement.scrollWidth") <= self._width

    def draws(self, page: Path, figures: Sequence[str]) -> None:
        """Check that a page is sound and has these figures, narrow and dark, wide and light, and made narrow again."""
        for width, dark in ((400, True), (1280, False)):
            self.open(page, width=width, dark=dark)
            self.is_sound()
            assert self.figures() == list(figures)
        self.size(390, 800)
        self.settle()
        self.is_sound()

    def close(self) -> None:
        self._socket.close()
        self._process.terminate()
        self._process.wait(timeout=LIMIT)
        self._profile.cleanup()

    def _receive(self) -> dict[str, Any]:
        message = json.loads(self._socket.recv(timeout=LIMIT))
        parameters = message.get("params", {})
        if message.get("method") == "Runtime.exceptionThrown":
            self.said.append(str(parameters["exceptionDetails"]))
        elif message.get("method") == "Runtime.consoleAPICalled":
            self.said.append(" ".join(str(each.get("value")) for each in parameters["args"]))
        elif message.get("method") == "Log.entryAdded" and SOFTWARE not in parameters["entry"]["text"]:
            self.said.append(parameters["entry"]["text"])
        elif message.get("method") == "Network.requestWillBeSent":
            self.asked.append(parameters["request"]["url"])
        return message
