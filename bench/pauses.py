# SPDX-License-Identifier: Apache-2.0
"""Pauses of the processes (SIGSTOP, SIGCONT) in real time, and a controller that is killed beside a moving robot.

Each prints a row. An arm without efforts falls: it has left its limits by itself if a state violates one at most
REACTION after the first new effort.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import JointState

from bench.figures import Figure
from bench.nodes import controller, plant, ros_environment
from bench.tap import DEPTH, Tap
from fjr_core.config.controller import safety
from fjr_core.config.scenario import Scenario
from fjr_core.runtime.events import STOPS
from fjr_msgs_py import names
from fjr_msgs_py.messages.joint_states import nanoseconds
from fjr_msgs_py.scenarios import library

ROBOTS, PAUSED = ("arm7", "two_link"), (("controller",), ("plant",), ("plant", "controller"))
PAUSES, KILLS, SEED = 40, 4, 0
SHORTEST, LONGEST = 0.05, 1.0  # s
WARM_UP, AFTER, UNDISTURBED = 2.0, 5.0, 9.0  # s
REACTION = 10_000_000  # ns
OLD = 5_000_000  # ns; an effort for a state older than the newest one by more is one for the past
ON_ITS_WAY = 1_000_000  # ns; a state that left later before the effort may not have arrived
PEAK_BOUND = 1.5  # of the peak effort of the undisturbed run
LIMIT = 60.0  # s


@dataclass(frozen=True)
class Outcome:
    """What followed a pause. peak: relative to the undisturbed run; old: efforts for the past; lost [s]: the pause."""

    robot: str
    paused: str
    lost: float
    at: float
    stopped: bool
    left: bool
    peak: float
    old: int

    def row(self) -> str:
        """Return the row of the table."""
        yes = {True: "yes", False: "no"}
        return (
            f"{self.robot:9} {self.paused:17} {self.at:7.2f} {self.lost:7.2f} {yes[self.stopped]:>8} "
            f"{yes[self.left]:>12} {self.peak:6.2f} {self.old:8d}"
        )


HEADING = "robot     paused             at [s] for [s]  stopped  left limits   peak  old efforts"


def recovered(pauses: int = PAUSES, kills: int = KILLS) -> list[Figure]:
    """Return the worst of all pauses, and of all restarts of a killed controller; print a row for each."""
    ros_environment()
    random, outcomes = np.random.default_rng(SEED), []
    print(HEADING, flush=True)
    for k in range(pauses + kills):
        at, lost = random.uniform(0.0, 4.0), random.uniform(SHORTEST, LONGEST)
        paused = PAUSED[k // len(ROBOTS) % len(PAUSED)] if k < pauses else ()
        outcomes.append(_outcome(ROBOTS[k % len(ROBOTS)], paused, at, lost))
        print(outcomes[-1].row(), flush=True)
    figures = []
    for what, chosen in (
        ("pauses", [each for each in outcomes if each.paused != "killed"]),
        ("kills of the controller", [each for each in outcomes if each.paused == "killed"]),
    ):
        own = [each for each in chosen if not each.left]
        counted = {"all": float(len(chosen)), "within the limits": float(len(own))}
        figures += [
            Figure(f"{what}: stops within the limits", sum(each.stopped for each in own), "", bound=0, parts=counted),
            Figure(f"{what}: peak effort", max((each.peak for each in own), default=0.0), "of the run's", PEAK_BOUND),
            Figure(f"{what}: efforts for the past", sum(each.old for each in chosen), "", bound=0),
        ]
    return figures


class Watch(Tap):
    """All states, named commands and events of the controller from here on."""

    def __enter__(self) -> Watch:
        super().__enter__()
        kinds = {names.JOINT_STATES: JointState, names.JOINT_COMMANDS: JointState}
        kinds[f"{names.CONTROLLER}/events"] = DiagnosticStatus
        self._subscriptions = [
            (
                topic,
                self.node.create_subscription(kind, topic, lambda _: None, QoSProfile(depth=DEPTH), raw=True),
                kind,
            )
            for topic, kind in kinds.items()
        ]
        self.taken: dict[str, list[tuple[int, Any]]] = {topic: [] for topic in kinds}
        return self

    def take(self) -> None:
        """Take what has come: send time [ns] and message of each."""
        for topic, subscription, kind in self._subscriptions:
            while (taken := subscription.handle.take_message(kind, True)) is not None:
                self.taken[topic].append((taken[1]["source_timestamp"], deserialize_message(taken[0], kind)))

    def run(self, seconds: float) -> None:
        """Take messages for some time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.take()
            time.sleep(0.02)

    def wait_for_commands(self, more: int = 1) -> None:
        """Wait until that many more commands have come; raise TimeoutError."""
        wanted, end = len(self.taken[names.JOINT_COMMANDS]) + more, time.monotonic() + LIMIT
        while len(self.taken[names.JOINT_COMMANDS]) < wanted:
            if time.monotonic() > end:
                raise TimeoutError(f"no command came for {LIMIT:g} s; expected a running controller")
            self.run(0.02)

    def commands(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return send times and stamps (k, 2) [ns], and efforts (k, n)."""
        return _table(self.taken[names.JOINT_COMMANDS], lambda message: message.effort)

    def states(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return send times and stamps (k, 2) [ns], and positions and velocities (k, 4n) of links, motors."""
        return _table(self.taken[names.JOINT_STATES], lambda message: [*message.position, *message.velocity])

    def stopped(self) -> bool:
        """Return whether an event says that the controller stopped."""
        return any(event.name == STOPS for _, event in self.taken[f"{names.CONTROLLER}/events"])


def _table(taken: list[tuple[int, Any]], values: Any) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    times = [(sent, nanoseconds(message.header.stamp)) for sent, message in taken]
    return np.array(times, dtype=np.int64).reshape(-1, 2), np.array([values(message) for _, message in taken])


def _outcome(robot: str, paused: tuple[str, ...], at: float, lost: float) -> Outcome:
    """Run a pair, disturb it `at` seconds after the warm-up, and judge what follows; no process paused: kill."""
    own = _own_peak(robot, WARM_UP if paused else 0.0)  # a start is compared with a run and its start
    with _pair(robot) as nodes, Watch() as watch:
        watch.wait_for_commands()
        watch.run(WARM_UP + at)
        begin = time.time_ns()
        if paused:
            for name in paused:
                os.kill(nodes[name].pid, signal.SIGSTOP)
            threading.Event().wait(lost)
            woken = time.time_ns()
            for name in paused:
                os.kill(nodes[name].pid, signal.SIGCONT)
        else:
            nodes["controller"].kill()
            nodes["controller"].wait()
            nodes["controller"] = _started(nodes["controller"].args)
            woken = begin
        watch.wait_for_commands()
        watch.run(AFTER)
        return _judged(robot, "+".join(paused) or "killed", begin, woken, lost, at, own, watch)


def _judged(
    robot: str, paused: str, begin: int, woken: int, lost: float, at: float, own: float, watch: Watch
) -> Outcome:
    times, efforts = watch.commands()
    after, answers = times[:, 0] >= woken, np.zeros(len(times), dtype=bool)
    answers[np.unique(times[:, 1], return_index=True)[1]] = True  # the stop effort after a silence answers no state
    answers &= after
    seen, states = watch.states()
    newest = np.maximum.accumulate(seen[:, 1])
    at_sending = newest[np.searchsorted(seen[:, 0], times[answers, 0] - ON_ITS_WAY) - 1]
    old = int(np.sum(at_sending - times[answers, 1] > OLD))
    first = int(times[answers, 0][0]) if answers.any() else woken
    left = bool((_outside(_scenario(robot), states) & (seen[:, 0] >= begin) & (seen[:, 0] <= first + REACTION)).any())
    peak = float(np.abs(efforts[after]).max()) / own
    return Outcome(robot, paused, lost, at, watch.stopped(), left, peak, old)


def _outside(scenario: Scenario, states: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which states (k, 4n) violate a limit of position, velocity or deflection."""
    limits, n = safety(scenario.controller_values, scenario.robot), scenario.robot.n
    q_l, q_m, dq_l, dq_m = np.split(states, [n, 2 * n, 3 * n], axis=1)
    found = np.zeros(len(states), dtype=bool)
    for value, lower, upper in (
        (q_l, limits.link_position_lower, limits.link_position_upper),
        (q_m, limits.motor_position_lower, limits.motor_position_upper),
        (np.abs(dq_l), 0.0, limits.link_velocity),
        (np.abs(dq_m), 0.0, limits.motor_velocity),
        (np.abs(q_m - q_l), 0.0, limits.deflection),
    ):
        found |= ((value < np.asarray(lower)) | (value > np.asarray(upper))).any(axis=1)
    return found


@cache
def _own_peak(robot: str, skipped: float) -> float:
    """Return the largest effort of an undisturbed run [N m] after the first `skipped` seconds."""
    with _pair(robot), Watch() as watch:
        watch.wait_for_commands()
        watch.run(UNDISTURBED)
        times, efforts = watch.commands()
        return float(np.abs(efforts[times[:, 0] >= times[0, 0] + skipped * 1e9]).max())


@cache
def _scenario(robot: str) -> Scenario:
    return library.load(robot)


@contextmanager
def _pair(robot: str) -> Iterator[dict[str, subprocess.Popen[bytes]]]:
    """Run plant and controller of a scenario inside the block."""
    with tempfile.TemporaryDirectory(prefix="fjr-bench-") as folder:
        file = Path(folder, f"{robot}.yaml")
        file.write_text(library.as_run(library.find(robot), {})[0], encoding="utf-8")
        nodes = {"plant": _started(plant(file)), "controller": _started(controller(file))}
        try:
            yield nodes
        finally:
            _end(nodes)


def _started(command: Any) -> subprocess.Popen[bytes]:
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)


def _end(nodes: Mapping[str, subprocess.Popen[bytes]]) -> None:
    for node in nodes.values():
        node.send_signal(signal.SIGCONT)
        node.send_signal(signal.SIGINT)
    for node in nodes.values():
        try:
            node.wait(5.0)
        except subprocess.TimeoutExpired:
            node.kill()
