# SPDX-License-Identifier: Apache-2.0
"""`fjr watch`: display a running control loop ten times a second, until Ctrl-C, without disturbing it.

No executor: `FjrWatch.listen` empties the queues a few times a second. For most states only the times are read from the
serialised bytes; one message per call is deserialised. Subscriptions are best effort, so that no publisher waits for a
slow terminal.
"""

from __future__ import annotations

import os
import sys
import threading
import time
import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from click import UsageError
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rich.console import Console
from rich.live import Live
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String

from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.robot import description, locked_positions
from fjr_monitor.recording.bag import header_stamp
from fjr_monitor.recording.topics import ELSEWHERE, TopicError, nodes_seen
from fjr_monitor.watch.state import NodeHealth, View, Watched
from fjr_monitor.watch.terminal import render
from fjr_msgs_py import names
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.output import json_text, tell
from fjr_msgs_py.console.ros2 import discover_quickly
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.node.reports import labelled
from fjr_msgs_py.scenarios import library

DEPTH = 4000  # messages between two calls of `listen`
PERIOD = 0.1  # s between updates of a terminal
FRAME = 0.04  # s between updates of a browser
PLAIN_PERIOD = 1.0  # s between updates of other outputs
LOOK = 1.0  # s between queries of the ROS graph
PATIENCE = 2.0  # s until a notice that it is waiting


def watch(
    scenario: str | None,
    namespace: str,
    controller: str,
    once: bool,
    timeout: float,
    remaps: tuple[str, ...],
    browser: bool,
    port: int | None,
    as_json: bool,
) -> None:
    """Display a running control loop until Ctrl-C.

    scenario: source of effort limits and of the arm in 3D; None: the robot description. once: show one view, after at
    most `timeout` [s], or raise TopicError. port: of the page in the browser; None or 0: any free one.
    """
    if browser and (once or as_json):
        raise UsageError(f"--browser shows the loop until Ctrl-C; expected it without {'--once' if once else '--json'}")
    if port is not None and not browser:
        raise UsageError("--port is given without --browser; expected both")
    limits, urdf, locked = _known(scenario) if scenario else ({}, "", {})
    discover_quickly()
    rules = [f"__ns:=/{namespace.strip('/')}"] if namespace.strip("/") else []
    arguments = [part for rule in (*rules, *remaps) for part in ("-r", rule)]
    watched = Watched(f"fjr watch {namespace}", limits)
    watched.description(urdf)  # until that of the loop comes
    with stoppable() as stop, own_node("fjr_watch", arguments) as node:
        display = _Display(FjrWatch(node, watched, controller), watched, stop)
        if once:
            display.once(node, timeout, as_json)
        elif browser:
            display.in_browser(port or 0, urdf, locked)
        else:
            display.in_terminal(as_json)


def _known(scenario: str) -> tuple[dict[str, float], str, Mapping[str, float]]:
    """Return the effort limits [N m] by joint, the URDF and the positions of locked joints [rad, m] of a scenario."""
    loaded = library.load(scenario, robot_only=True)
    values, efforts = loaded.controller_values, np.asarray(loaded.settings.effort).tolist()
    limits = {joint: limit for joint, limit in zip(loaded.joints, efforts, strict=True) if np.isfinite(limit)}
    return limits, description(values), locked_positions(values)


class _Display:
    """Views of a loop until `stop`."""

    def __init__(self, listener: FjrWatch, watched: Watched, stop: threading.Event) -> None:
        self._listener, self._watched, self._stop = listener, watched, stop
        self._console = Console(highlight=False)

    def in_terminal(self, as_json: bool) -> None:
        """Show views in the terminal; as_json, or where there is none: print one after the other."""
        if as_json or not self._console.is_terminal:
            for view in self._views(PLAIN_PERIOD):
                self._print(view, as_json)
            return
        with Live(console=self._console, screen=True, auto_refresh=False) as live:
            for view in self._views(PERIOD):
                live.update(render(view, self._console.width), refresh=True)

    def in_browser(self, port: int, urdf: str, locked: Mapping[str, float]) -> None:
        """Show the arm of a URDF, or of the robot description if it is empty, on a page at a port; 0: any."""
        from fjr_monitor.watch.browser import BrowserPage  # Jinja2 and the mesh reader

        with BrowserPage(port, self._watched.title, locked) as page:
            print(f"watch the arm at {page.url} until Ctrl-C", flush=True)
            if sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
                webbrowser.open(page.url)
            for view in self._views(FRAME):
                page.show(asdict(view), urdf or self._watched.urdf)

    def once(self, node: Node, timeout: float, as_json: bool) -> None:
        """Print one view, once states and diagnostics came; raise TopicError if neither came within `timeout` [s]."""
        begin, notified = time.monotonic(), False
        for view in self._views(PERIOD):
            waited = time.monotonic() - begin
            late = waited > timeout
            heard = view.timing is not None, bool(view.health)
            if all(heard) or (late and any(heard)):
                self._print(replace(view, missing=tuple(self._listener.missing())), as_json)
                return
            if late:
                seen = f"no state and no diagnostics for {timeout:g} s on {', '.join(self._listener.waited_for)}"
                raise TopicError(f"{seen}; {nodes_seen(node)}; {ELSEWHERE}")
            if waited > PATIENCE and not notified:
                notified = True
                tell(f"waiting for states and diagnostics; {nodes_seen(node)}")

    def _views(self, period: float) -> Iterator[View]:
        missing: list[str] = []
        next_query = time.monotonic() + LOOK  # discovery is complete by then
        while True:
            now = time.monotonic()
            self._listener.listen(now)
            if now >= next_query:
                missing, next_query = self._listener.missing(), now + LOOK
            yield self._watched.view(now, missing)
            if self._stop.wait(period):
                return

    def _print(self, view: View, as_json: bool) -> None:
        if as_json:
            print(json_text(asdict(view)), flush=True)
        else:
            self._console.print(render(view, self._console.width))


class FjrWatch:
    """Subscribe with a node, under its namespace and remaps; pass all messages to `watched`."""

    def __init__(self, node: Node, watched: Watched, controller: str = CONTROLLER) -> None:
        """controller: name of the node that owns the ~/ topics."""
        self._node, self._watched = node, watched
        self._now = 0.0
        self._space = f"{node.get_namespace()}/".lstrip("/")
        own = {name: name.replace("~", controller) for name in (names.TRACKING_ERROR, names.CERTIFICATE, names.EVENTS)}
        self._topics: list[str] = []
        subscribe = self._subscribe
        self._stamped = [
            (subscribe(JointState, names.JOINT_STATES), watched.sent, self._on_state),
            (subscribe(JointState, names.JOINT_COMMANDS), watched.answered, self._on_command),
        ]
        self._newest = [
            (subscribe(JointState, own[names.TRACKING_ERROR], 1), lambda m: watched.error(_by_name(m, m.position))),
            (subscribe(Float64MultiArray, own[names.CERTIFICATE], 1), lambda m: watched.certificate(labelled(m))),
            (subscribe(Float64MultiArray, names.EFFORT_COMMANDS, 1), self._on_efforts),
            (subscribe(String, names.ROBOT_DESCRIPTION, 1, names.LATCHED), lambda m: watched.description(m.data)),
        ]
        self._every = [
            (subscribe(DiagnosticArray, names.DIAGNOSTICS, 100), self._on_diagnostics),
            (
                subscribe(DiagnosticStatus, own[names.EVENTS], 100),
                lambda m: watched.event(self._now, m.level[0], m.name, m.message),
            ),
        ]
        self.waited_for = self._stamped[0][0].topic_name, self._every[0][0].topic_name  # states and diagnostics
        self._joints: list[str] = []
        self._named_efforts = False

    def listen(self, now: float) -> None:
        """Process all new messages; `now` [s]: the current time."""
        self._now = now
        for subscription, on_times, on_last in self._stamped:
            taken = drained(subscription)
            on_times([(header_stamp(each), i["source_timestamp"], i["received_timestamp"]) for each, i in taken])
            for data, _ in taken[-1:]:
                on_last(deserialize_message(data, subscription.msg_type))
        for subscription, on_newest in self._newest:
            for data, _ in drained(subscription)[-1:]:
                on_newest(deserialize_message(data, subscription.msg_type))
        for subscription, on_each in self._every:
            for data, _ in drained(subscription):
                on_each(deserialize_message(data, subscription.msg_type))

    def missing(self) -> list[str]:
        """Return the topics without a publisher; one of the two command topics is enough."""
        silent = [topic for topic in self._topics if not self._node.count_publishers(topic)]
        commands = {self._stamped[1][0].topic_name, self._newest[2][0].topic_name}
        return silent if commands <= set(silent) else [topic for topic in silent if topic not in commands]

    def _subscribe(self, kind: type, topic: str, depth: int = DEPTH, qos: QoSProfile | None = None) -> Subscription:
        profile = qos or QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        subscription = self._node.create_subscription(kind, topic, lambda _: None, profile, raw=True)
        self._topics.append(subscription.topic_name)
        return subscription

    def _on_state(self, message: JointState) -> None:
        self._joints = [name for name in message.name if not name.endswith(names.motor_name(""))]
        self._watched.state(self._now, _by_name(message, message.position), _by_name(message, message.velocity))

    def _on_command(self, message: JointState) -> None:
        self._named_efforts = True
        self._watched.effort(_by_name(message, message.effort))

    def _on_efforts(self, message: Float64MultiArray) -> None:
        """Use these efforts without JointState commands: by label, else in the joint order of the states."""
        if not self._named_efforts:
            in_order = dict(zip(self._joints, message.data))  # noqa: B905
            self._watched.effort(labelled(message) or in_order)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in (each for each in message.status if each.name.startswith(self._space)):  # of this robot
            values = {pair.key: pair.value for pair in status.values}
            health = NodeHealth(status.name, status.level[0], status.message, values.get("state", ""))
            self._watched.health(self._now, health)


def _by_name(message: JointState, values: Sequence[float]) -> dict[str, float]:
    return dict(zip(message.name, values))  # noqa: B905 (a field may be empty)


def drained(subscription: Subscription) -> list[tuple[bytes, Any]]:
    """Empty a queue; return the serialised messages with their infos."""
    return list(iter(lambda: subscription.handle.take_message(subscription.msg_type, True), None))
