# SPDX-License-Identifier: Apache-2.0
"""`fjr watch` with running nodes: a pseudo-terminal, and the page of a real browser."""

from __future__ import annotations

import os
import pty
import select
import signal
import socket
import struct
import subprocess
import termios
import threading
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from fcntl import ioctl
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pyte
import pytest
from ament_index_python.packages import get_package_prefix

from fjr_core.config.robot import description
from fjr_core.config.scenario import load_scenario
from fjr_monitor.watch.browser import BrowserPage
from system.browser import Browser
from system.executables import SLOW, TIME_LIMIT, Executable, fjr_here, running, scenario
from time_limits import HANG, Limit

pytestmark = pytest.mark.system
COLUMNS, ROWS = 132, 40
FJR = str(Path(get_package_prefix("fjr_bringup")) / "lib" / "fjr_bringup" / "fjr")


class Terminal:
    """`fjr` in a pseudo-terminal, with the content of its screen."""

    def __init__(self, *arguments: str) -> None:
        self._master, slave = pty.openpty()
        ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        kept = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
        ends = dict.fromkeys(("stdin", "stdout", "stderr"), slave)
        env = {**kept, "TERM": "xterm-256color"}
        self.process = subprocess.Popen([FJR, *arguments], **ends, start_new_session=True, env=env)
        os.close(slave)
        self._screen = pyte.Screen(COLUMNS, ROWS)
        self._stream = pyte.ByteStream(self._screen)
        self.raw = b""

    def until(self, seen: Callable[[str], bool]) -> str:
        """Read until the screen satisfies `wanted`; return the screen."""
        limit = Limit(TIME_LIMIT)
        while not seen(self.text):
            assert not limit.passed(), self.text
            self._read(0.2)
        return self.text

    @property
    def text(self) -> str:
        return "\n".join(line.rstrip() for line in self._screen.display)

    def interrupt(self) -> int:
        """Send Ctrl-C; return the exit code."""
        self.process.send_signal(signal.SIGINT)
        limit = Limit(TIME_LIMIT)
        while self.process.poll() is None and not limit.passed():
            self._read(0.1)
        self._read(0.1)
        return self.process.wait(HANG)

    def close(self) -> None:
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)
        self.process.wait()
        os.close(self._master)

    def _read(self, wait: float) -> None:
        if select.select([self._master], [], [], wait)[0]:
            try:
                data = os.read(self._master, 65536)
            except OSError:  # the other end was closed
                return
            self.raw += data
            self._stream.feed(data)


@pytest.fixture(scope="module")
def loop() -> Iterator[dict[str, Executable]]:
    """A plant and a controller in the namespace left, which no delay makes diverge; the last test ends the plant."""
    limits = ("-p", "limits.effort:=[12.0, 6.0]")
    parameters = {node: ("--params-file", scenario("two_link"), *SLOW[node], *limits) for node in SLOW}
    with running(parameters, "-p", "realtime_priority:=0", "-r", "__ns:=/left") as nodes:
        yield nodes


def rows(screen: str) -> dict[str, list[float]]:
    """Return position, velocity, deflection and error of the joints that have all of them."""
    found = {}
    for words in (line.split() for line in screen.splitlines()):
        with suppress(ValueError, IndexError):
            found[words[1]] = [float(words[i]) for i in range(2, 6)]
    return found


@pytest.fixture
def page() -> Iterator[BrowserPage]:
    with BrowserPage(0, "fjr watch <left>") as made:
        yield made


def poses(more: int) -> str:
    """An expression that waits until the arm was posed so many times more, and gives the picture."""
    return f"""(() => {{
      const arm = document.getElementById("arm"), until = Number(arm.dataset.poses ?? 0) + {more};
      return new Promise((done) => new MutationObserver((_, all) => {{
        if (Number(arm.dataset.poses) < until) return;
        all.disconnect();
        done(document.querySelector(".stage canvas").toDataURL());
      }}).observe(arm, {{ attributes: true }}));
    }})()"""


def waited_for(condition: str) -> str:
    """An expression that waits until a condition holds."""
    return f"new Promise((done) => setInterval(() => {condition} && done(true), 20))"


def joint(**values: object) -> dict[str, object]:
    return {"name": "joint1", "position": 0.3, "deflection": 0.1, "error": 0.2, "effort": 1.0, "limit": 4.0} | values


def view(*joints: dict[str, object]) -> dict[str, object]:
    return {"joints": list(joints), "silence": 0.0, "timing": None, "health": []}


def test_missing_nodes_are_reported_until_ctrl_c() -> None:
    with closing(Terminal("watch", "--remap", "joint_states:=/robot/states")) as watch:
        screen = watch.until(lambda text: "waiting for joint states" in text and "no publisher of" in text)
        assert "/robot/states" in screen
        assert watch.interrupt() == 0


def test_link_reference_and_motor_are_posed_by_the_view(page: BrowserPage, browser: Browser) -> None:
    urdf = description(load_scenario(scenario("paper_k31")).controller_values)
    browser.open(page.url, width=640, height=480)
    pictures = []
    for given in (joint(), joint(error=0.1), joint(deflection=0.0), joint(error=None, deflection=None), joint()):
        page.show(view(given), urdf)
        pictures.append(browser.value(poses(1)))
    assert len(set(pictures[:4])) == 4
    assert pictures[4] == pictures[0]
    cells = browser.value("[...document.querySelectorAll('#joints td')].map((cell) => cell.textContent)")
    assert cells == ["0.3000 rad", "100 mrad", "200 mrad", "1.00 N m", "25 %"]
    assert browser.said == []


def test_a_description_that_is_no_urdf_is_one_sentence(page: BrowserPage, browser: Browser) -> None:
    page.show(view(joint()), "<robot><link name='</script>'/><oops></robot>")
    browser.open(page.url)
    sentence = "document.querySelector('.stage').textContent"
    assert browser.value(waited_for(f"{sentence}.startsWith('no arm')"))
    assert browser.said == []


def test_only_this_computer_is_answered_on_a_free_port(page: BrowserPage) -> None:
    for host, code in (("127.0.0.1", 200), ("localhost:99", 200), ("elsewhere.example", 403)):
        connection = HTTPConnection(urlsplit(page.url).netloc, timeout=HANG)
        connection.request("GET", "/", headers={"Host": host})
        answer = connection.getresponse()
        assert answer.status == code
        assert b"<left>" not in answer.read()
        connection.request("GET", "/other")
        assert connection.getresponse().status == 404
    assert "cannot be used" in fjr_here("watch", "--browser", "--port", str(urlsplit(page.url).port), code=1)


def test_browsers_that_disconnect_early_print_nothing(page: BrowserPage, capfd: pytest.CaptureFixture[str]) -> None:
    at = (urlsplit(page.url).hostname, urlsplit(page.url).port)
    whole = [f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode() for path in ("/", "/events")]
    for request in (b"", b"GET", *whole):
        for _ in range(2):
            with socket.create_connection(at) as early:
                early.sendall(request)
                early.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset, as by a crash
    limit = Limit(HANG)
    while any("process_request_thread" in thread.name for thread in threading.enumerate()):
        page.show(view(joint()), "")
        assert not limit.passed(), "a thread still serves a browser that has gone"
    assert capfd.readouterr().err == ""


@pytest.mark.usefixtures("loop")
def test_the_arm_of_a_running_loop_moves_in_the_browser(browser: Browser) -> None:
    watch = subprocess.Popen([FJR, "watch", "--browser", "--namespace", "left"], stdout=subprocess.PIPE, text=True)
    try:
        assert watch.stdout is not None
        address = next(word for word in watch.stdout.readline().split() if word.startswith("http://127.0.0.1:"))
        browser.open(address, width=400, height=300)  # the processor draws the arm
        first = browser.value(poses(1))
        limit = Limit(HANG)
        while browser.value(poses(2)) == first:  # the controller may still load
            assert not limit.passed(), "the arm does not move"
        rows = browser.value("[...document.querySelectorAll('#joints th')].map((cell) => cell.textContent)")
        assert rows == ["shoulder", "elbow"]
        assert set(browser.asked) == {address, f"{address}events"}
        assert browser.said == []
        watch.send_signal(signal.SIGINT)
        assert watch.wait(HANG) == 0
        assert browser.value(waited_for("document.getElementById('timing').textContent === 'fjr watch has ended'"))
    finally:
        watch.kill()
        watch.communicate()


def test_a_running_loop_is_on_the_screen_until_the_plant_ends(loop: dict[str, Executable]) -> None:
    words = ("state to command", "left/fjr_controller", "left/fjr_plant")
    with closing(Terminal("watch", "two_link", "--namespace", "left")) as watch:
        before = watch.until(
            lambda text: all(word in text for word in words) and set(rows(text)) == {"shoulder", "elbow"}
        )
        assert np.all(np.abs(rows(before)["elbow"]) < [10, 100, 1e3, 1e4])  # rad, rad/s, mrad
        assert "fjr watch left" in before
        watch.until(lambda text: text != before and "elbow" in text)
        loop["plant"].kill()
        watch.until(lambda text: "no state for" in text)
        assert watch.interrupt() == 0
    assert b"\x1b[?1049l" in watch.raw, "the terminal must be restored"
    assert b"Traceback" not in watch.raw
