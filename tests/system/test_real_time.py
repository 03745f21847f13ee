# SPDX-License-Identifier: Apache-2.0
"""What needs the clock: plant and controller on two sides of a network, a motion that is sent, the demo.

These tests run alone (tests/conftest.py), so they stand in one file: others wait for them once.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from fjr_monitor.recording.bag import read_bag
from fjr_msgs_py.console.ros2 import discover_quickly
from nodes.harness import Listener, Ros, nanoseconds, seconds
from system.executables import SLOW, Executable, documented_keys, fjr, fjr_here, installed, running, scenario, wait_for
from system.shared_runs import Recorded, messages, recorded_run
from system.test_running_nodes import MOTION, T, holding, motion_file
from time_limits import HANG

pytestmark = [pytest.mark.system, pytest.mark.real_time]

SECONDS = 3.0  # of stamped time
AUXILIARY_RATE = 100  # Hz, of the topics for observers in real time
SETTLED = 2.0  # s; the initial error of 0.5 rad has decayed by then
RECORDED = ("/joint_states", "/joint_commands", "/fjr_controller/reference")


class RefusedError(Exception):
    """Reason why namespaces are not available."""


class Network:
    """Two network namespaces `left` and `right`, joined by a veth pair, each like a separate computer.

    Use as a context. Raises RefusedError.
    """

    def __init__(self) -> None:
        self.left, self.right = (f"fjr-{side}-{os.getpid()}" for side in ("left", "right"))
        self._started: list[Executable] = []

    def __enter__(self) -> Network:
        try:
            self._build()
        except RefusedError:
            self._remove()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for each in self._started:
            each.kill()
        self._remove()

    def start(self, namespace: str, command: list[str]) -> Executable:
        """Start a command in a namespace."""
        words = ["ip", "netns", "exec", namespace, *command]
        self._started.append(Executable(words, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET"))
        return self._started[-1]

    def words(self) -> str:
        """Return the output of all started processes."""
        return "\n".join(each.said_so_far() for each in self._started)

    def sent(self, namespace: str) -> int:
        """Return the number of packets sent from a namespace."""
        shown = ip("-n", namespace, "-s", "-j", "link", "show", "dev", "veth")
        return int(json.loads(shown)[0]["stats64"]["tx"]["packets"])

    def impair(self, delay: str, loss: str) -> None:
        """Delay and lose packets in both directions with `tc netem`; raises RefusedError."""
        for namespace in (self.left, self.right):
            netem = ("qdisc", "add", "dev", "veth", "root", "netem", "delay", delay, "loss", loss)
            _run("tc", "-n", namespace, *netem)

    def _build(self) -> None:
        ip("netns", "add", self.left)
        ip("netns", "add", self.right)
        ip("link", "add", "veth", "netns", self.left, "type", "veth", "peer", "name", "veth", "netns", self.right)
        for number, namespace in enumerate((self.left, self.right), start=1):
            ip("-n", namespace, "address", "add", f"10.77.0.{number}/24", "dev", "veth")
            for device in ("lo", "veth"):
                ip("-n", namespace, "link", "set", device, "up")
            ip("-n", namespace, "route", "add", "default", "dev", "veth")  # multicast, which discovery uses, needs one

    def _remove(self) -> None:
        for namespace in (self.left, self.right):
            with suppress(RefusedError):
                ip("netns", "del", namespace)


def ip(*arguments: str) -> str:
    """Run `ip`; raises RefusedError with its error message."""
    return _run("ip", *arguments)


def _run(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=HANG)
    except FileNotFoundError:
        raise RefusedError(f"`{command[0]}` is not installed") from None
    if done.returncode:
        raise RefusedError(f"`{' '.join(command)}`: {done.stderr.strip()}")
    return done.stdout


@pytest.fixture
def network(monkeypatch) -> Iterator[Network]:
    monkeypatch.setenv("FASTRTPS_DEFAULT_PROFILES_FILE", "")
    monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")
    discover_quickly(locally=True)
    try:
        with Network() as made:
            yield made
    except RefusedError as why:
        pytest.skip(f"no network namespaces here: {why}")


def run(network: Network, folder: Path) -> tuple[Recorded, float]:
    """Run plant and recorder on the left, the controller on the right; return what was recorded and the last error."""
    arguments = "--ros-args", "--params-file", scenario("paper_k31")
    recorder = installed("fjr", "record", *RECORDED, "--output", str(folder / "bag"), "--force")
    started = [network.start(network.left, command) for command in (recorder, installed("plant", *arguments))]
    started.append(network.start(network.right, installed("controller", *arguments)))

    def recorded() -> bool:
        """Return whether the bag has SECONDS of references."""
        assert all(each.process.poll() is None for each in started), network.words()
        topic = read_bag(folder / "bag").topics.get(RECORDED[-1]) if any((folder / "bag").glob("*.mcap")) else None
        return topic is not None and topic.last - topic.first > SECONDS * 1e9

    wait_for(recorded, "the motion")
    for each in reversed(started):
        each.signal(signal.SIGINT)
        assert each.end()[0] == 0, network.words()
    seen = recorded_run(folder, "")
    assert np.isfinite(seen.u).all()
    return seen, float(np.max(seen.error[seen.t > SETTLED]))


def test_demo_runs_unchanged_between_two_network_namespaces(network: Network, tmp_path: Path) -> None:
    seen, worst = run(network, tmp_path)
    assert len(seen.t) >= 0.5 * SECONDS * AUXILIARY_RATE
    states, efforts = (list(messages(tmp_path, topic)) for topic in RECORDED[:2])
    assert np.median(np.diff([nanoseconds(message) for _, message in states])) == pytest.approx(1e6, rel=0.01)  # 1 kHz
    packets = min(network.sent(network.left), network.sent(network.right))
    assert packets >= 0.5 * len(efforts) > 0  # states and efforts cross the network, not shared memory
    assert worst <= 2e-3


def test_tracks_with_loss_and_delay_of_packets_in_the_network(network: Network, tmp_path: Path) -> None:
    """The kernel loses 5 % of the packets and delays them by 1 ms in both directions."""
    try:
        network.impair("1ms", "5%")
    except RefusedError as why:
        pytest.skip(f"no `tc netem` here: {why}")
    assert run(network, tmp_path)[1] <= 0.05


WATCHED = {**SLOW, "controller": (*SLOW["controller"], "-p", "auxiliary_rate:=0.0")}
"""In real time with every reference: lock-step in native threads is too fast for a listener in Python."""


def test_the_controller_tracks_the_motion_that_is_sent(ros: Ros, tmp_path: Path) -> None:
    """After a gap of the states, as on a machine that stands still, a transition leads back: then it is sent again."""
    file, listener = motion_file(tmp_path, MOTION), Listener(ros, only=["fjr_controller/reference"])
    for _ in range(3):
        t, q = references_of_sent_motion(ros, listener, file)
        if np.diff(t).max() < 0.02:
            break
    rising = (q > MOTION[300]) & (q < MOTION[900])
    begin = np.median(t[rising] - np.interp(q[rising], MOTION, T))
    inside = (t > begin + 0.05) & (t < begin + 0.95)
    assert np.count_nonzero(inside) > 50
    np.testing.assert_allclose(q[inside], np.interp(t[inside] - begin, T, MOTION), atol=0.01)


def references_of_sent_motion(ros: Ros, listener: Listener, file: str) -> tuple[np.ndarray, np.ndarray]:
    """Start the nodes, send a motion, and return times [s] and positions of the reference up to its end."""
    listener.references.clear()
    with running(holding(WATCHED)), ThreadPoolExecutor(1) as worker:
        ros.until(lambda: listener.references, "the controller")
        sent = worker.submit(fjr, "send", file, "--lead", "1", "--scenario", "paper_k31", "--json")
        ros.until(sent.done, "the end of fjr send")
        assert "through every sample the motion of the file would ask for" in sent.result()
        assert set(json.JSONDecoder().raw_decode(sent.result())[0]) == documented_keys()["send"]
        ros.until(lambda: (last := listener.references[-1]).position[0] > 0.4 and last.velocity[0] == 0.0, "its end")
    seen = ((seconds(message), message.position[0]) for message in listener.references)
    t, q = map(np.array, zip(*seen, strict=True))
    return t, q


@pytest.mark.usefixtures("no_picture")
def test_the_demo_runs_the_paper_and_an_arm_in_real_time_without_matplotlib(tmp_path: Path) -> None:
    """The other tests wait meanwhile; test_fjr_command.py looks at a picture."""
    said = fjr_here("demo", "--duration", "0.5", "--output", str(tmp_path))
    for name in ("paper_k31", "paper_k3p1", "arm7"):
        counts = json.loads((tmp_path / name / "report.json").read_text())["counts"]
        assert counts["nominal"] == counts["published"] + counts["missing"]
        assert counts["nominal"] in (500, 501)
        assert counts["published"] == counts["answered_in_time"] + counts["late"] + counts["unanswered"] > 0
        assert (tmp_path / name / "bag" / "metadata.yaml").is_file()
        assert (tmp_path / name / "report.html").is_file()
        assert not (tmp_path / name / "overview.png").exists()
        assert name in said
    assert "Matplotlib" not in said
    assert "The paper's claim" in said
    assert "The paper&#39;s claim" in (tmp_path / "comparison.html").read_text()
