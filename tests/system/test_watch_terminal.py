# SPDX-License-Identifier: Apache-2.0
"""`fjr watch` in a pseudo-terminal with running nodes: the content of the screen."""

from __future__ import annotations

import os
import pty
import select
import signal
import struct
import subprocess
import termios
from collections.abc import Callable, Iterator
from contextlib import suppress
from fcntl import ioctl
from pathlib import Path

import pyte
import pytest
from ament_index_python.packages import get_package_prefix

from system.executables import TIME_LIMIT, Executable, fjr, fjr_here, lockstep_loop
from time_limits import Limit

pytestmark = pytest.mark.system
COLUMNS, ROWS = 132, 40


class Terminal:
    """`fjr` in a pseudo-terminal, with the content of its screen."""

    def __init__(self, *arguments: str) -> None:
        self._master, slave = pty.openpty()
        ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))
        command = [str(Path(get_package_prefix("fjr_bringup")) / "lib" / "fjr_bringup" / "fjr"), *arguments]
        kept = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
        self.process = subprocess.Popen(
            command,
            stdin=slave,
            stdout=slave,
            stderr=slave,
            start_new_session=True,
            env={**kept, "TERM": "xterm-256color"},
        )
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
        return self.process.wait(TIME_LIMIT)

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


@pytest.fixture
def terminal() -> Iterator[Callable[..., Terminal]]:
    opened: list[Terminal] = []

    def open_one(*arguments: str) -> Terminal:
        opened.append(Terminal(*arguments))
        return opened[-1]

    yield open_one
    for one in opened:
        one.close()


@pytest.fixture
def loop() -> Iterator[dict[str, Executable]]:
    with lockstep_loop("two_link", "left") as nodes:
        yield nodes


def rows(screen: str) -> dict[str, list[float]]:
    """Return position, velocity, deflection and error of the joints that have all of them."""
    found = {}
    for words in (line.split() for line in screen.splitlines()):
        with suppress(ValueError, IndexError):
            found[words[1]] = [float(words[i]) for i in range(2, 6)]
    return found


def test_a_running_loop_is_on_the_screen(loop: dict[str, Executable], terminal: Callable[..., Terminal]) -> None:
    watch = terminal("watch", "two_link", "--namespace", "left")
    words = ("state to command", "ok    left/fjr_controller", "left/fjr_plant")
    screen = watch.until(lambda text: all(word in text for word in words) and set(rows(text)) == {"shoulder", "elbow"})
    q_l, dq_l, deflection, error = rows(screen)["elbow"]
    assert abs(q_l) < 2
    assert abs(dq_l) < 20
    assert abs(deflection) < 1
    assert 0 <= error < 2
    assert "fjr watch left" in screen
    before = screen
    watch.until(lambda text: text != before and "elbow" in text)
    loop["plant"].kill()
    watch.until(lambda text: "no state for" in text)
    assert watch.interrupt() == 0
    assert b"\x1b[?1049l" in watch.raw, "the terminal must be restored"
    assert b"Traceback" not in watch.raw


def test_missing_nodes_are_reported_until_ctrl_c(terminal: Callable[..., Terminal]) -> None:
    watch = terminal("watch", "--remap", "joint_states:=/robot/states")
    screen = watch.until(lambda text: "waiting for joint states" in text and "no publisher of" in text)
    assert "/robot/states" in screen
    assert watch.interrupt() == 0


def test_single_view_is_plain_text(loop: dict[str, Executable]) -> None:
    fjr("echo", "left/joint_states", "--once", "--timeout", "600")
    said = fjr("watch", "--namespace", "/left", "--once")
    assert "shoulder" in said
    assert "\x1b" not in said


def test_invalid_remap_is_refused() -> None:
    assert "expected FROM:=TO" in fjr_here("watch", "--remap", "joint_states", code=2)
