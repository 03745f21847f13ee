# SPDX-License-Identifier: Apache-2.0
"""`fjr watch --browser`: the arm of running nodes on a page of this computer, in a real browser."""

from __future__ import annotations

import signal
import socket
import struct
import subprocess
import threading
from collections.abc import Iterator
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from ament_index_python.packages import get_package_prefix

from fjr_core.config.robot import description
from fjr_core.config.scenario import load_scenario
from fjr_monitor.watch.browser import BrowserPage
from system.browser import Browser
from system.executables import Executable, fjr_here, lockstep_loop, scenario
from time_limits import HANG, Limit

pytestmark = pytest.mark.system


@pytest.fixture
def loop() -> Iterator[dict[str, Executable]]:
    with lockstep_loop("two_link", "left") as nodes:
        yield nodes


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


@pytest.mark.usefixtures("loop")
def test_the_arm_of_a_running_loop_moves_in_the_browser(browser: Browser) -> None:
    command = [Path(get_package_prefix("fjr_bringup")) / "lib" / "fjr_bringup" / "fjr", "watch", "--browser"]
    watch = subprocess.Popen([*command, "--namespace", "left"], stdout=subprocess.PIPE, text=True)
    try:
        assert watch.stdout is not None
        address = next(word for word in watch.stdout.readline().split() if word.startswith("http://127.0.0.1:"))
        browser.open(address)
        first = browser.value(poses(1))
        limit = Limit(HANG)
        while browser.value(poses(20)) == first:  # the controller may still load
            assert not limit.passed(), "the arm does not move"
        rows = browser.value("[...document.querySelectorAll('#joints th')].map((cell) => cell.textContent)")
        assert rows == ["shoulder", "elbow"]
        assert set(browser.asked) == {address, f"{address}events"}
        assert browser.said == []
        watch.send_signal(signal.SIGINT)
        assert watch.wait(HANG) == 0
        ended = "document.getElementById('timing').textContent === 'fjr watch has ended'"
        assert browser.value(f"new Promise((done) => setInterval(() => {ended} && done(true), 20))")
    finally:
        watch.kill()
        watch.communicate()


def joint(**values: object) -> dict[str, object]:
    return {"name": "joint1", "position": 0.3, "deflection": 0.1, "error": 0.2, "effort": 1.0, "limit": 4.0} | values


def view(*joints: dict[str, object]) -> dict[str, object]:
    return {"joints": list(joints), "silence": 0.0, "timing": None, "health": []}


def test_link_reference_and_motor_are_posed_by_the_view(page: BrowserPage, browser: Browser) -> None:
    urdf = description(load_scenario(scenario("paper_k31")).controller_values)
    browser.open(page.url)
    pictures = []
    for given in (joint(), joint(error=0.1), joint(deflection=0.0), joint(error=None, deflection=None), joint()):
        page.show(view(given), urdf)
        pictures.append(browser.value(poses(1)))
    assert len(set(pictures[:4])) == 4
    assert pictures[4] == pictures[0]
    cells = browser.value("[...document.querySelectorAll('#joints td')].map((cell) => cell.textContent)")
    assert cells == ["0.3000 rad", "0.1000 rad", "2.0e-1 rad", "1.00 N m", "25 %"]
    assert browser.said == []


def test_a_description_that_is_no_urdf_is_one_sentence(page: BrowserPage, browser: Browser) -> None:
    page.show(view(joint()), "<robot><link name='</script>'/><oops></robot>")
    browser.open(page.url)
    sentence = "document.querySelector('.stage').textContent"
    assert browser.value(
        f"new Promise((done) => setInterval(() => {sentence}.startsWith('no arm') && done({sentence}), 20))"
    )
    assert browser.said == []


@pytest.mark.parametrize(("host", "code"), [("127.0.0.1", 200), ("localhost:99", 200), ("elsewhere.example", 403)])
def test_only_this_computer_is_answered(page: BrowserPage, host: str, code: int) -> None:
    connection = HTTPConnection(urlsplit(page.url).netloc, timeout=HANG)
    connection.request("GET", "/", headers={"Host": host})
    answer = connection.getresponse()
    assert answer.status == code
    assert b"<left>" not in answer.read()
    connection.request("GET", "/other")
    assert connection.getresponse().status == 404


def test_browsers_that_disconnect_early_print_nothing(page: BrowserPage, capfd: pytest.CaptureFixture[str]) -> None:
    at = (urlsplit(page.url).hostname, urlsplit(page.url).port)
    for request in (
        b"",
        b"GET",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n",
    ):
        for _ in range(8):
            with socket.create_connection(at) as early:
                early.sendall(request)
                early.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))  # reset, as by a crash
    limit = Limit(HANG)
    while any("process_request_thread" in thread.name for thread in threading.enumerate()):
        page.show(view(joint()), "")
        assert not limit.passed(), "a thread still serves a browser that has gone"
    assert capfd.readouterr().err == ""


def test_a_used_port_is_refused_in_one_sentence(page: BrowserPage) -> None:
    said = fjr_here("watch", "--browser", "--port", str(urlsplit(page.url).port), code=1)
    assert "cannot be used" in said
