# SPDX-License-Identifier: Apache-2.0
"""Longest gap between two efforts of `arm7` in real time while others make use of the controller.

A trajectory of 100,000 points is sent to a standing and to a moving arm; parameters are read 100 times a second; a bag
is recorded while `fjr watch --browser` serves a page.

A gap is the largest difference of the send times of two consecutive efforts, from two seconds of commands on until the
use ends; a trajectory ends after half of the move to its first point. The bound is for the median of the repeats; the
largest stands beside it. A gap covers all that delays an effort: states that the plant sends late, the cycle of the
controller, reading and planning of the trajectory, the change of the reference, and every other process on the cores.
It does not cover the start (bench/starts.py) and processes that join before the recording. `machine` is the largest
lateness meanwhile of a thread of high priority that only sleeps (bench/machine.py), `machine then` in the repeat of the
largest gap. A refused trajectory gives no figure, unless the arm had stopped before.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import cache
from pathlib import Path
from typing import Any
from urllib.request import urlopen

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter_client import AsyncParameterClient
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from bench.figures import Figure
from bench.latency import at_rest
from bench.machine import watched
from bench.nodes import controller, plant, process, running, scenario_file
from bench.tap import Heard, Tap, waiting
from fjr_core.config.nodes import CONTROLLER
from fjr_msgs_py import names
from fjr_msgs_py.messages.trajectories import trajectory_message
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.scenarios import library

REPEATS, WARM_UP = 5, 2.0  # s
BOUND = 5.0  # ms
POINTS, SPACING, LEAD = 100_000, 1e-3, 20.0  # of the trajectory; s; s until its first point, while it is planned
SHIFT, SWING = 0.3, 0.05  # rad, of the first joint beyond its reference
PERIOD = 0.01  # s between two reads of parameters
SECONDS = 10.0  # s of reading, and of recording and watching
LONGEST = 60.0  # s; timeout of each wait
TRAJECTORY = names.JOINT_TRAJECTORY.replace("~", CONTROLLER)
EVENTS = names.EVENTS.replace("~", CONTROLLER)
REFERENCE = names.REFERENCE.replace("~", CONTROLLER)

Use = Callable[[Tap, Heard], None]
"""What others do with the controller meanwhile; it empties the queues at least every five seconds."""


def longest(repeats: int = REPEATS) -> list[Figure]:
    """Return the longest gaps between two efforts, of `repeats` for each use."""
    scenario = library.load("arm7")
    standing = at_rest(scenario)
    uses: Mapping[str, tuple[Use, Mapping[str, Any]]] = {
        f"while a standing arm receives {POINTS:,} points": (_send, standing),
        f"while a moving arm receives {POINTS:,} points": (_send, {}),
        "while parameters are read 100 times a second": (_read_parameters, {}),
        "while a bag is recorded and fjr watch --browser is open": (_record_and_watch, {}),
    }
    return [_figure(name, use, overrides, repeats) for name, (use, overrides) in uses.items()]


def _figure(name: str, use: Use, overrides: Mapping[str, Any], repeats: int) -> Figure:
    gaps, machine = np.array([_gap(use, overrides) for _ in range(repeats)]).T
    parts = {"largest [ms]": float(gaps.max()), "machine then [ms]": float(machine[gaps.argmax()])}
    parts |= {"machine [ms]": float(machine.max()), "repeats": float(repeats)}
    return Figure(f"longest gap between efforts {name}", float(np.median(gaps)), "ms", bound=BOUND, parts=parts)


def _gap(use: Use, overrides: Mapping[str, Any]) -> tuple[float, float]:
    """Return the longest gap [ms] from the second second on, and the lateness of the machine itself [ms]."""
    with scenario_file(overrides) as file, Tap() as tap, running(plant(file), controller(file)):
        with tap.listening([names.JOINT_COMMANDS], LONGEST) as begun:
            begun.collect(WARM_UP)
        with tap.listening([names.JOINT_COMMANDS], LONGEST) as heard, watched() as late:
            use(tap, heard)
            heard.drain()
    return 1e-6 * float(np.diff(heard.messages()[0][:, 1]).max()), max(late).late


def _send(tap: Tap, heard: Heard) -> None:
    """Send the trajectory; return once it is the reference, or if the arm has stopped."""
    events = tap.node.create_subscription(DiagnosticStatus, EVENTS, lambda _: None, 100)
    publisher = tap.node.create_publisher(JointTrajectory, TRAJECTORY, 1)
    reference = tap.node.create_subscription(JointState, REFERENCE, lambda _: None, 1)
    subscribed = f"a subscription to {TRAJECTORY}"
    heard.until(lambda: publisher.get_subscription_count() and events.get_publisher_count(), LONGEST, subscribed)
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

    heard.until(followed, LONGEST, "the trajectory to be the reference")


def _pose() -> np.ndarray:
    """Return the largest position (n,) [rad] of the first joint's reference, with those of the others at time 0."""
    reference = library.load("arm7").reference
    largest = max(reference.jets(t)[0][0] for t in np.arange(0.0, 20.0, 0.01))
    return np.array([largest, *reference.jets(0.0)[0][1:]])


@cache
def _trajectory() -> bytes:
    """Return the serialised trajectory: a slow swing of the first joint, beyond its reference."""
    times = np.asarray(LEAD + SPACING * np.arange(POINTS), dtype=float)
    scenario, phase = library.load("arm7"), 2 * np.pi * np.linspace(0, 10, POINTS)
    rate = 2 * np.pi * 10 / (SPACING * (POINTS - 1))
    positions = np.tile(_pose(), (POINTS, 1))
    velocities, accelerations = np.zeros((2, *positions.shape))
    positions[:, 0] += SHIFT + SWING * (1 - np.cos(phase))
    velocities[:, 0], accelerations[:, 0] = SWING * rate * np.sin(phase), SWING * rate**2 * np.cos(phase)
    return bytes(serialize_message(trajectory_message(scenario.joints, times, positions, velocities, accelerations)))


def _read_parameters(_: Tap, heard: Heard) -> None:
    """Read three parameters of the controller again and again."""
    with own_node("fjr_bench_reader") as node:
        executor = SingleThreadedExecutor(context=node.context)
        executor.add_node(node)
        client = AsyncParameterClient(node, CONTROLLER)
        if not client.wait_for_services(LONGEST):
            raise TimeoutError(f"waited {LONGEST:g} s for the parameters of {CONTROLLER}")
        due = begun = time.monotonic()
        while due < begun + SECONDS:
            executor.spin_until_future_complete(client.get_parameters(["gains.K_ld", "joints"]), LONGEST)
            heard.drain()
            due = max(due + PERIOD, time.monotonic())
            time.sleep(max(0.0, due - time.monotonic()))
        executor.shutdown()


def _record_and_watch(_: Tap, heard: Heard) -> None:
    """Record a bag and keep a page of `fjr watch --browser` open."""
    with tempfile.TemporaryDirectory(prefix="fjr-bench-") as folder, ExitStack() as stack:
        bag = Path(folder, "bag")
        stack.enter_context(process(["fjr", "record", "--output", str(bag)]))
        events = stack.enter_context(_page())
        heard.until(lambda: any(f.stat().st_size > 1 << 20 for f in bag.glob("*.mcap")), LONGEST, "the bag to grow")
        heard.drain()
        for found in heard.seen:
            found.clear()  # a process that joins is another matter: docs/real_time.md
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            events.readline()
            heard.drain()


@contextmanager
def _page() -> Iterator[Any]:
    """Yield the stream of events of a page of `fjr watch --browser`."""
    with process(["fjr", "watch", "--browser"], stdout=subprocess.PIPE) as watch:
        assert watch.stdout is not None
        address = next(word for word in watch.stdout.readline().split() if word.startswith("http://"))
        with urlopen(f"{address}events", timeout=LONGEST) as events:
            yield events
