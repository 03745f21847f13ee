# SPDX-License-Identifier: Apache-2.0
"""`fjr echo`, `fjr record`, `fjr play` and `fjr watch`: the topics of running nodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from click import UsageError

from fjr_monitor.recording.echo import echo
from fjr_monitor.recording.play import play
from fjr_monitor.recording.record import record
from fjr_monitor.watch import app as monitor_app
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.options import FIRST
from fjr_msgs_py.console.output import Result
from fjr_msgs_py.console.ros2 import discover_quickly, refuse_over_ros2
from fjr_msgs_py.scenarios import library


def echo_topic(topic: str, count: int | None, timeout: float | None, force: bool, as_json: bool) -> None:
    """Print messages of a topic until `count` have arrived or none arrives for `timeout` [s], FIRST by default for one.

    Without either it waits until Ctrl-C.
    """
    timeout = FIRST if timeout is None and count == 1 else timeout
    refuse_over_ros2(f"ros2 topic echo {topic}", "with filters, fields and statistics", force)
    discover_quickly()
    with stoppable() as stop:
        echo(topic, count, math.inf if timeout is None else timeout, stop, as_json)


def record_topics(topics: Sequence[str], output: Path | None, duration: float | None, force: bool) -> Result:
    """Record topics, or all, to a new bag for `duration` [s] or until interrupted."""
    wanted = " ".join(topics) or "--all"
    refuse_over_ros2(f"ros2 bag record --storage mcap {wanted}", "with splitting and compression", force)
    discover_quickly()
    with stoppable() as stop:
        return record(topics, output, duration, stop)


def play_bag(bag: Path, topics: Sequence[str], rate: float, efforts: bool, force: bool) -> Result:
    """Publish topics of a bag, or all but commands to a robot, at their recorded times divided by `rate`."""
    wanted = f" --topics {' '.join(topics)}" if topics else ""
    refuse_over_ros2(f"ros2 bag play {bag}{wanted}", "with pause, loop and clock", force)
    discover_quickly()
    with stoppable() as stop:
        return play(bag, topics, rate, efforts, stop)


def watch_loop(
    scenario: str | None,
    namespace: str,
    controller: str,
    once: bool,
    timeout: float,
    remaps: tuple[str, ...],
    browser: bool,
    foxglove: bool,
    port: int | None,
    as_json: bool,
) -> None:
    """Display a running control loop, or serve Foxglove; scenario: source of effort limits and of the arm in 3D.

    timeout [s]: longest wait of a single view.
    """
    _refuse_conflicts({"--browser": browser, "--foxglove": foxglove}, {"--once": once, "--json": as_json}, port)
    robot = monitor_app.known(library.load(scenario, robot_only=True)) if scenario else monitor_app.Known()
    discover_quickly()
    page = (port or 0) if browser else None
    wish = monitor_app.Options(namespace, remaps, controller, timeout if once else None, as_json, page)
    with stoppable() as stop:
        if foxglove:
            from fjr_monitor.watch import foxglove as server  # SciPy, which other commands here do not need

            server.serve(wish, robot.locked, server.PORT if port is None else port, stop)
        else:
            monitor_app.watch(wish, robot, stop)


def _refuse_conflicts(displays: dict[str, bool], terminal: dict[str, bool], port: int | None) -> None:
    """Raise UsageError for two displays, for options of the terminal with one, and for a port without one.

    displays, terminal: whether each option is given.
    """
    any_display = any(displays.values())
    chosen = [option for option, given in (displays | terminal).items() if given]
    if any_display and len(chosen) > 1:
        raise UsageError(f"{chosen[0]} shows the loop until Ctrl-C; expected it without {chosen[1]}")
    if port is not None and not any_display:
        raise UsageError(f"--port is given without {' or '.join(displays)}; expected one of them")
