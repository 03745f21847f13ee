# SPDX-License-Identifier: Apache-2.0
"""The loop in real time while others make use of the controller, and after pauses and kills of its processes.

Gaps of `arm7`: a trajectory of 100,000 points is sent to a standing and to a moving arm; parameters are read 100 times
a second; a bag is recorded while `fjr watch --browser` serves a page. A gap is the largest difference of the send times
of two consecutive efforts, from two seconds of commands on until the use ends; a trajectory ends after half of the move
to its first point. The bound is for the median of the repeats; the largest stands beside it. A gap covers all that
delays an effort: states that the plant sends late, the cycle of the controller, reading and planning of the trajectory,
the change of the reference, and every other process on the cores. It does not cover the start (bench/starts.py) and
processes that join before the recording. `machine` is the largest lateness meanwhile of a thread of high priority that
only sleeps (bench/machine.py), `machine then` in the repeat of the largest gap. A refused trajectory gives no figure,
unless the arm had stopped before.

Pauses (SIGSTOP, SIGCONT) and kills of the controller beside a moving robot: an arm without efforts falls. It has left
its limits by itself if a state violates one at most REACTION after the first new effort.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from bench.figures import Figure
from bench.machine import watched
from bench.nodes import DEPTH, Heard, Tap, controller, plant, process, running, scenario_file, waiting
from bench.real_time import at_rest
from fjr_bringup.clients import ServiceClient
from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.scenario import Scenario
from fjr_core.runtime.events import STOPS
from fjr_msgs_py import names
from fjr_msgs_py.messages.trajectories import trajectory_message
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.scenarios import library

WARM_UP, LIMIT = 2.0, 60.0  # s; timeout of each wait
REPEATS, GAP_BOUND = 5, 5.0  # ms
POINTS, SPACING, LEAD = 100_000, 1e-3, 20.0  # of the trajectory; s; s until its first point, while it is planned
SHIFT, SWING = 0.3, 0.05  # rad, of the first joint beyond its reference
PERIOD = 0.01  # s between two reads of parameters
SECONDS = 10.0  # s of reading, and of recording and watching
TRAJECTORY, REFERENCE, EVENTS = (
    topic.replace("~", CONTROLLER) for topic in (names.JOINT_TRAJECTORY, names.REFERENCE, names.EVENTS)
)
ROBOTS, PAUSED = ("arm7", "two_link"), (("controller",), ("plant",), ("plant", "controller"))
PAUSES, KILLS, SEED = 40, 4, 0
SHORTEST, LONGEST = 0.05, 1.0  # s
AFTER, UNDISTURBED = 5.0, 9.0  # s
REACTION = 10_000_000  # ns
OLD = 5_000_000  # ns; an effort for a state older than the newest one by more is one for the past
ON_ITS_WAY = 1_000_000  # ns; a state that left later before the effort may not have arrived
PEAK_BOUND = 1.5  # of the peak effort of the undisturbed run
load = cache(library.load)
TOPICS = [names.JOINT_STATES, names.JOINT_COMMANDS]

Use = Callable[[Tap, Heard], None]
"""What others do with the controller meanwhile; it empties the queues at least every five seconds."""


def longest_gaps(repeats: int = REPEATS) -> list[Figure]:
    """Return the longest gaps between two efforts, of `repeats` for each use."""
    standing = at_rest(load("arm7"))
    uses: Mapping[str, tuple[Use, Mapping[str, Any]]] = {
        f"while a standing arm receives {POINTS:,} points": (_send, standing),
        f"while a moving arm receives {POINTS:,} points": (_send, {}),
        "while parameters are read 100 times a second": (_read_parameters, {}),
        "while a bag is recorded and fjr watch --browser is open": (_record_and_watch, {}),
    }
    figures = []
    for name, (use, overrides) in uses.items():
        gaps, machine = np.array([_gap(use, overrides) for _ in range(repeats)]).T
        parts = {"largest [ms]": float(gaps.max()), "machine then [ms]": float(machine[gaps.argmax()])}
        parts |= {"machine [ms]": float(machine.max()), "repeats": float(repeats)}
        median = float(np.median(gaps))
        figures.append(Figure(f"longest gap between efforts {name}", median, "ms", bound=GAP_BOUND, parts=parts))
    return figures


def _gap(use: Use, overrides: Mapping[str, Any]) -> tuple[float, float]:
    """Return the longest gap [ms] from the second second on, and the lateness of the machine itself [ms]."""
    with scenario_file(overrides) as file, Tap() as tap, running(plant(file), controller(file)):
        with tap.listening([names.JOINT_COMMANDS], LIMIT) as begun:
            begun.collect(WARM_UP)
        with tap.listening([names.JOINT_COMMANDS], LIMIT) as heard, watched() as late:
            use(tap, heard)
            heard.drain()
    return 1e-6 * float(np.diff(heard.messages()[0][:, 1]).max()), max(late).late


def _send(tap: Tap, heard: Heard) -> None:
    """Send the trajectory; return once it is the reference, or if the arm has stopped."""
    events = tap.node.create_subscription(DiagnosticStatus, EVENTS, lambda _: None, 100)
    publisher = tap.node.create_publisher(JointTrajectory, TRAJECTORY, 1)
    reference = tap.node.create_subscription(JointState, REFERENCE, lambda _: None, 1)
    subscribed = f"a subscription to {TRAJECTORY}"
    heard.until(lambda: publisher.get_subscription_count() and events.get_publisher_count(), LIMIT, subscribed)
    publisher.publish(_trajectory())
    arrived = float(_pose()[0] + SHIFT / 2)

    def followed() -> bool:
        """Return whether the arm moves to the first point, or has stopped, which a long gap may do."""
        for event, _ in waiting(events, DiagnosticStatus):
            if event.name.startswith("trajectory refused"):
                if "stopped" not in event.message:
                    raise RuntimeError(f"{event.message}; expected it to be followed")
                return True
        moved = [message.position[0] >= arrived for message, _ in waiting(reference, JointState)]
        return any(moved[-1:])

    heard.until(followed, LIMIT, "the trajectory to be the reference")


def _pose() -> np.ndarray:
    """Return the largest position (n,) [rad] of the first joint's reference, with those of the others at time 0."""
    reference = load("arm7").reference
    largest = max(reference.jets(t)[0][0] for t in np.arange(0.0, 20.0, 0.01))
    return np.array([largest, *reference.jets(0.0)[0][1:]])


@cache
def _trajectory() -> bytes:
    """Return the serialised trajectory: a slow swing of the first joint, beyond its reference."""
    times = np.asarray(LEAD + SPACING * np.arange(POINTS), dtype=float)
    scenario, phase = load("arm7"), 2 * np.pi * np.linspace(0, 10, POINTS)
    rate = 2 * np.pi * 10 / (SPACING * (POINTS - 1))
    positions = np.tile(_pose(), (POINTS, 1))
    velocities, accelerations = np.zeros((2, *positions.shape))
    positions[:, 0] += SHIFT + SWING * (1 - np.cos(phase))
    velocities[:, 0], accelerations[:, 0] = SWING * rate * np.sin(phase), SWING * rate**2 * np.cos(phase)
    return bytes(serialize_message(trajectory_message(scenario.joints, times, positions, velocities, accelerations)))


def _read_parameters(_: Tap, heard: Heard) -> None:
    """Read two parameters of the controller again and again."""
    with own_node("fjr_bench_reader") as node, closing(ServiceClient(node, LIMIT)) as client:
        parameters = client.find(f"/{CONTROLLER}/get_parameters")
        due = begun = time.monotonic()
        while due < begun + SECONDS:
            client.ask(parameters, GetParameters.Request(names=["gains.K_ld", "joints"]))
            heard.drain()
            due = max(due + PERIOD, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))


def _record_and_watch(_: Tap, heard: Heard) -> None:
    """Record a bag and keep a page of `fjr watch --browser` open."""
    with tempfile.TemporaryDirectory(prefix="fjr-bench-") as folder, ExitStack() as stack:
        bag = Path(folder, "bag")
        stack.enter_context(process(["fjr", "record", "--output", str(bag)]))
        watch = stack.enter_context(process(["fjr", "watch", "--browser"], stdout=subprocess.PIPE))
        assert watch.stdout is not None
        address = next(word for word in watch.stdout.readline().split() if word.startswith("http://"))
        events = stack.enter_context(urlopen(f"{address}events", timeout=LIMIT))
        heard.until(lambda: any(f.stat().st_size > 1 << 20 for f in bag.glob("*.mcap")), LIMIT, "the bag to grow")
        heard.drain()
        for found in heard.seen:
            found.clear()  # a process that joins is another matter: docs/real_time.md
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            events.readline()
            heard.drain()


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


def recovered(pauses: int = PAUSES, kills: int = KILLS) -> list[Figure]:
    """Return the worst of all pauses, and of all restarts of a killed controller; print each."""
    random, outcomes = np.random.default_rng(SEED), list[Outcome]()
    for k in range(pauses + kills):
        at, lost = random.uniform(0.0, 4.0), random.uniform(SHORTEST, LONGEST)
        paused = PAUSED[k // len(ROBOTS) % len(PAUSED)] if k < pauses else ()
        outcomes.append(_outcome(ROBOTS[k % len(ROBOTS)], paused, at, lost))
        print(outcomes[-1], flush=True)
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


@contextmanager
def _pair(robot: str, may_end: bool = False) -> Iterator[tuple[Path, dict[str, subprocess.Popen[str]], Tap, Heard]]:
    """Run plant and controller of a robot; yield their file and processes, and a tap that hears TOPICS."""
    with (
        scenario_file(name=robot) as file,
        Tap() as tap,
        process(plant(file), quiet=True) as plant_node,
        process(controller(file), quiet=True, may_end=may_end) as controller_node,
        tap.listening(TOPICS, LIMIT) as heard,
    ):
        yield file, {"plant": plant_node, "controller": controller_node}, tap, heard


def _outcome(robot: str, paused: tuple[str, ...], at: float, lost: float) -> Outcome:
    """Run a pair, disturb it `at` seconds after the warm-up, and judge what follows; no process paused: kill."""
    own = _own_peak(robot, WARM_UP if paused else 0.0)  # a start is compared with a run and its start
    with _pair(robot, may_end=not paused) as (file, nodes, tap, heard), ExitStack() as stack:
        events = tap.node.create_subscription(DiagnosticStatus, EVENTS, lambda _: None, DEPTH)
        heard.collect(WARM_UP + at)
        begin = woken = time.time_ns()
        if paused:
            for name in paused:
                os.kill(nodes[name].pid, signal.SIGSTOP)
            time.sleep(lost)
            woken = time.time_ns()
            for name in paused:
                os.kill(nodes[name].pid, signal.SIGCONT)
        else:
            nodes["controller"].kill()
            nodes["controller"].wait()
            stack.enter_context(process(controller(file), quiet=True))
        count = len(heard.seen[1])
        heard.until(lambda: len(heard.seen[1]) > count, LIMIT, "a command of a running controller")
        heard.collect(AFTER)
        stopped = STOPS in [event.name for event, _ in waiting(events, DiagnosticStatus)]
    left, peak, old = _judged(robot, heard, begin, woken)
    return Outcome(robot, "+".join(paused) or "killed", lost, at, stopped, left, peak / own, old)


def _judged(robot: str, heard: Heard, begin: int, woken: int) -> tuple[bool, float, int]:
    """Return whether the arm left its limits by itself, the peak effort [N m], and the number of efforts for the past.

    begin, woken: when the pause began and ended [ns].
    """
    seen, times = heard.messages()
    after, answers = times[:, 1] >= woken, np.zeros(len(times), dtype=bool)
    answers[np.unique(times[:, 0], return_index=True)[1]] = True  # the stop effort after a silence answers no state
    answers &= after
    newest = np.maximum.accumulate(seen[:, 0])
    at_sending = newest[np.searchsorted(seen[:, 1], times[answers, 1] - ON_ITS_WAY) - 1]
    old = int(np.sum(at_sending - times[answers, 0] > OLD))
    first = int(times[answers, 1][0]) if answers.any() else woken
    meanwhile = (seen[:, 1] >= begin) & (seen[:, 1] <= first + REACTION)
    left = bool((_outside(load(robot), heard.values(0, "position", "velocity")) & meanwhile).any())
    return left, float(np.abs(heard.values(1, "effort")[after]).max()), old


def _outside(scenario: Scenario, states: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which positions and velocities (k, 4n) violate a limit of position, velocity or deflection."""
    limits, n = scenario.settings, scenario.robot.n
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
    with _pair(robot) as (*_, heard):
        heard.collect(UNDISTURBED)
    sent = heard.messages()[1][:, 1]
    return float(np.abs(heard.values(1, "effort")[sent >= sent[0] + skipped * 1e9]).max())
