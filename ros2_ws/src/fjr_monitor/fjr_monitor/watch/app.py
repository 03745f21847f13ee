# SPDX-License-Identifier: Apache-2.0
"""`fjr watch`: display a running control loop in the terminal, ten times a second, until Ctrl-C."""

from __future__ import annotations

import os
import sys
import threading
import time
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np
from rclpy.node import Node
from rich.console import Console
from rich.live import Live

from fjr_core.config.controller import safety
from fjr_core.config.robot import description, locked_positions
from fjr_core.config.scenario import Scenario
from fjr_monitor.recording.echo import ELSEWHERE, TopicError, nodes_seen
from fjr_monitor.watch.node import FjrWatch
from fjr_monitor.watch.state import View, Watched
from fjr_monitor.watch.terminal import render
from fjr_msgs_py.console.output import json_text
from fjr_msgs_py.node.participant import own_node

PERIOD = 0.1  # s between updates of a terminal
FRAME = 0.04  # s between updates of a browser
PLAIN_PERIOD = 1.0  # s between updates of other outputs
LOOK = 1.0  # s between queries of the ROS graph
PATIENCE = 2.0  # s until a notice that it is waiting


@dataclass(frozen=True)
class Options:
    """What to watch: namespace, remaps FROM:=TO, name of the controller.

    once [s]: show one view and exit, after at most this wait for states and diagnostics; None: show views until Ctrl-C.
    as_json: print one JSON document a view. port: show the loop in a browser, at this port of localhost, 0: any.
    """

    namespace: str = "/"
    remaps: tuple[str, ...] = ()
    controller: str = "fjr_controller"
    once: float | None = None
    as_json: bool = False
    port: int | None = None

    @property
    def arguments(self) -> list[str]:
        """Command-line arguments as after --ros-args."""
        rules = [f"__ns:=/{self.namespace.strip('/')}"] if self.namespace.strip("/") else []
        return [part for rule in (*rules, *self.remaps) for part in ("-r", rule)]


@dataclass(frozen=True)
class Known:
    """What a scenario tells about the robot: effort limits [N m] by joint, URDF, positions of locked joints [rad, m].

    Without a scenario the robot description tells it.
    """

    limits: Mapping[str, float] = field(default_factory=dict)
    urdf: str = ""
    locked: Mapping[str, float] = field(default_factory=dict)


def known(scenario: Scenario) -> Known:
    """Return what a scenario tells about the robot of its controller."""
    values = scenario.controller_values
    return Known(effort_limits(scenario), description(values), locked_positions(values))


def effort_limits(scenario: Scenario) -> Mapping[str, float]:
    """Return the effort limits [N m] of the controller of a scenario, by joint."""
    limits = np.asarray(safety(scenario.controller_values, scenario.robot).effort)
    return {joint: float(limit) for joint, limit in zip(scenario.joints, limits, strict=True) if np.isfinite(limit)}


def watch(options: Options, robot: Known, stop: threading.Event) -> None:
    """Show the view until `stop`, or once; raise TopicError if nothing is there to be shown once."""
    watched = Watched(f"fjr watch {options.namespace}", robot.limits)
    console = Console(highlight=False)
    with own_node("fjr_watch", options.arguments) as node:
        listener = FjrWatch(node, watched, options.controller)
        show = _as_json if options.as_json else lambda view: console.print(render(view, console.width))
        if options.once is not None:
            _once(node, listener, watched, show, options.once, stop)
        elif options.port is not None:
            _in_browser(listener, watched, robot, options, stop)
        elif options.as_json:
            for view in _views(listener, watched, PLAIN_PERIOD, stop):
                show(view)
        elif console.is_terminal:
            with Live(console=console, screen=True, auto_refresh=False) as live:
                for view in _views(listener, watched, PERIOD, stop):
                    live.update(render(view, console.width), refresh=True)
        else:
            for view in _views(listener, watched, PLAIN_PERIOD, stop):
                show(view)


def _in_browser(listener: FjrWatch, watched: Watched, robot: Known, options: Options, stop: threading.Event) -> None:
    from fjr_monitor.watch.browser import BrowserPage  # Jinja2 and the mesh reader

    with BrowserPage(options.port or 0, f"fjr watch {options.namespace}", robot.locked) as page:
        print(f"watch the arm at {page.url} until Ctrl-C", flush=True)
        if sys.platform != "linux" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
            webbrowser.open(page.url)
        for view in _views(listener, watched, FRAME, stop):
            page.show(asdict(view), robot.urdf or watched.urdf)


def _as_json(view: View) -> None:
    print(json_text(asdict(view)), flush=True)


def _views(listener: FjrWatch, watched: Watched, period: float, stop: threading.Event) -> Iterator[View]:
    missing: list[str] = []
    next_query = time.monotonic() + LOOK  # discovery is complete by then
    while True:
        now = time.monotonic()
        listener.listen(now)
        if now >= next_query:
            missing, next_query = listener.missing(), now + LOOK
        yield watched.view(now, missing)
        if stop.wait(period):
            return


def _once(
    node: Node,
    listener: FjrWatch,
    watched: Watched,
    show: Callable[[View], None],
    timeout: float,
    stop: threading.Event,
) -> None:
    begin, notified = time.monotonic(), False
    for view in _views(listener, watched, PERIOD, stop):
        waited = time.monotonic() - begin
        late = waited > timeout
        heard = view.timing is not None, bool(view.health)
        if all(heard) or (late and any(heard)):
            show(replace(view, missing=tuple(listener.missing())))
            return
        if late:
            seen = f"no state and no diagnostics for {timeout:g} s on {', '.join(listener.waited_for)}"
            raise TopicError(f"{seen}; {nodes_seen(node)}; {ELSEWHERE}")
        if waited > PATIENCE and not notified:
            notified = True
            print(f"fjr: waiting for states and diagnostics; {nodes_seen(node)}", file=sys.stderr, flush=True)
