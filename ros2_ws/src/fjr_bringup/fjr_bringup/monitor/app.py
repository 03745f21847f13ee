# SPDX-License-Identifier: Apache-2.0
"""`fjr watch`: a running loop in a terminal, some ten times a second, until Ctrl-C."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from rich.console import Console
from rich.live import Live

from fjr_bringup.monitor.node import FjrWatch
from fjr_bringup.monitor.state import View, Watched
from fjr_bringup.monitor.terminal import render
from fjr_bringup.recording.echo import listening
from fjr_core.config.safety import safety
from fjr_core.config.scenario import Scenario

PERIOD = 0.1  # s between two pictures on a terminal
PLAIN_PERIOD = 1.0  # s elsewhere
LOOK = 1.0  # s between looks at the graph
FIRST = 60.0  # s that a single picture waits for states and reports at most
PATIENCE = 2.0  # s after which it says that it waits


@dataclass(frozen=True)
class Wish:
    """What to watch: namespace, remaps FROM:=TO, the controller's name; once: one picture and end."""

    namespace: str = "/"
    remaps: tuple[str, ...] = ()
    controller: str = "fjr_controller"
    once: bool = False

    @property
    def arguments(self) -> list[str]:
        """As after --ros-args."""
        rules = [f"__ns:=/{self.namespace.strip('/')}"] if self.namespace.strip("/") else []
        return [part for rule in (*rules, *self.remaps) for part in ("-r", rule)]


def effort_limits(scenario: Scenario) -> Mapping[str, float]:
    """Limits [N m] that the controller of a scenario keeps, by joint."""
    limits = np.asarray(safety(scenario.controller_values, scenario.robot).effort)
    return {joint: float(limit) for joint, limit in zip(scenario.joints, limits, strict=True) if np.isfinite(limit)}


def watch(wish: Wish, limits: Mapping[str, float], stop: threading.Event) -> None:
    """Show the picture until `stop`, or once."""
    watched = Watched(f"fjr watch {wish.namespace}", limits)
    console = Console(highlight=False)
    with listening("fjr_watch", wish.arguments) as node:
        listener = FjrWatch(node, watched, wish.controller)
        if wish.once:
            _once(listener, watched, console, stop)
        elif console.is_terminal:
            with Live(console=console, screen=True, auto_refresh=False) as live:
                for view in _views(listener, watched, PERIOD, stop):
                    live.update(render(view, console.width), refresh=True)
        else:
            for view in _views(listener, watched, PLAIN_PERIOD, stop):
                console.print(render(view, console.width))


def _views(listener: FjrWatch, watched: Watched, period: float, stop: threading.Event) -> Iterator[View]:
    missing: list[str] = []
    look = time.monotonic() + LOOK  # by then all is found that is there
    while True:
        now = time.monotonic()
        listener.listen(now)
        if now >= look:
            missing, look = listener.missing(), now + LOOK
        yield watched.view(now, missing)
        if stop.wait(period):
            return


def _once(listener: FjrWatch, watched: Watched, console: Console, stop: threading.Event) -> None:
    begin, said = time.monotonic(), False
    for view in _views(listener, watched, PERIOD, stop):
        if time.monotonic() - begin > PATIENCE and not said:
            said = True
            print("fjr: waiting for states and reports", file=sys.stderr, flush=True)
        if (view.timing is not None and view.health) or time.monotonic() - begin > FIRST:
            console.print(render(replace(view, missing=tuple(listener.missing())), console.width))
            return
