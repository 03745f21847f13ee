# SPDX-License-Identifier: Apache-2.0
"""From a measured state to an effort: the reference's clock and the law u(x, x, t); without ROS."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core import Reference, TrackingLaw
from fjr_core.checks import Array


@dataclass(frozen=True)
class Command:
    """Effort u (n,) [N m] for a state, with the reference jets (5, n) it was computed from."""

    u: Array
    jets: Array
    restarted: bool


class Tracker:
    """Answers stamped states with efforts; the reference's time 0 is the first answered state's stamp.

    A state older than the last one is not answered (None), unless its stamp jumped back by more than
    `state_timeout` [s] or nothing newer came for that long (a robot that was reset, a bag that loops):
    then the reference starts again. A repeated stamp is answered again.
    """

    def __init__(self, law: TrackingLaw, reference: Reference, state_timeout: float) -> None:
        self._law = law
        self._reference = reference
        self._timeout = round(state_timeout * 1e9)
        self._start: int | None = None
        self._last = 0
        self._last_arrival = 0

    def warm_up(self) -> None:
        """Build everything that is built once, so that the first state is answered as fast as any other."""
        n = self._law.robot.n
        x = self._law.robot.state(*(np.zeros(n),) * 4)
        self._law.command(x, self._reference.jets(0.0))

    def answer(self, stamp: int, x: Array, arrival: int) -> Command | None:
        """Command for the state x (4n,) stamped `stamp` [ns] that arrived at `arrival` [ns, steady clock]."""
        start, restarted = self._start, False
        if start is None:
            start = stamp
        elif stamp < self._last:
            restarted = self._last - stamp > self._timeout or arrival - self._last_arrival > self._timeout
            if not restarted:
                return None
            start = stamp
        jets = self._reference.jets((stamp - start) * 1e-9)
        command = Command(self._law.command(x, jets), jets, restarted)
        if is_sendable(command.u):  # else it is not answered, and leaves no trace here
            self._start, self._last, self._last_arrival = start, stamp, arrival
        return command


def is_sendable(u: Array) -> bool:
    """Whether an effort may leave the node: finite in every entry."""
    return bool(np.isfinite(u).all())
