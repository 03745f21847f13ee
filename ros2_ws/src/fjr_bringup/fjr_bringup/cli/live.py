# SPDX-License-Identifier: Apache-2.0
"""`fjr echo`, `fjr record` and `fjr watch`: commands that listen to running nodes."""

from __future__ import annotations

import math
import shutil
from collections.abc import Sequence
from pathlib import Path

from fjr_bringup.interrupt import stoppable
from fjr_bringup.monitor import app as monitor_app
from fjr_bringup.recording.echo import echo
from fjr_bringup.recording.record import record
from fjr_bringup.runner.run import discover_quickly
from fjr_bringup.scenarios import library
from fjr_core.errors import FjrError


class BetterToolError(FjrError):
    """ROS 2's own tool is installed."""


def echo_topic(topic: str, count: int | None, timeout: float | None, force: bool) -> None:
    """Print messages of a topic until `count` have arrived or none arrives for `timeout` [s]."""
    _refuse_over_ros2(f"ros2 topic echo {topic}", "with filters, fields and statistics", force)
    discover_quickly()
    with stoppable() as stop:
        echo(topic, count, math.inf if timeout is None else timeout, stop)


def record_topics(topics: Sequence[str], output: Path | None, duration: float | None, force: bool) -> None:
    """Record topics, or all, to a new bag for `duration` [s] or until interrupted."""
    wanted = " ".join(topics) or "--all"
    _refuse_over_ros2(f"ros2 bag record --storage mcap {wanted}", "with splitting and compression", force)
    discover_quickly()
    with stoppable() as stop:
        print(record(topics, output, duration, stop))


def watch_loop(scenario: str | None, namespace: str, controller: str, once: bool, remaps: tuple[str, ...]) -> None:
    """Display a running control loop; scenario: source of the displayed effort limits."""
    limits = dict(monitor_app.effort_limits(library.load(scenario))) if scenario else {}
    discover_quickly()
    wish = monitor_app.Options(namespace, remaps, controller, once)
    with stoppable() as stop:
        monitor_app.watch(wish, limits, stop)


def _refuse_over_ros2(command: str, advantage: str, force: bool) -> None:
    """Raise BetterToolError, naming the `command` of ros2 to use, if ros2 is on the PATH, unless forced."""
    if not force and (found := shutil.which("ros2")):
        raise BetterToolError(f"{found} does this better: use `{command}` ({advantage}), or add --force")
