# SPDX-License-Identifier: Apache-2.0
"""Random events against a model of the supervisor: what is latched stays, and no effort contradicts the state."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from fjr_core.motions.point_to_point import Hold
from fjr_core.numerics.checks import Array
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import State
from fjr_core.runtime.safety_settings import GRAVITY_HOLD, REACTIONS, STOP, YIELD, ZERO
from fjr_core.runtime.velocity_observer import VelocityObserver
from tracking.tracked import MS, SECOND, TWO, TWO_SINES, sample, settings

LIMIT, TIMEOUT = np.array([40.0, 20.0]), 100 * MS
REQUESTS = ("hold", "follow", "resume", "start", "apply")
EVENTS = (
    *["states"] * 7,
    "repeat",
    "late",
    "pause",
    "jump",
    "back",
    "broken",
    "silence",
    "contact",
    "limit",
    *REQUESTS,
)


@dataclass
class Model:
    """A tracker, the clocks of its states and arrivals, and what the supervisor must remember."""

    tracker: ControlStep
    rng: np.random.Generator
    now: int = SECOND
    arrival: int = SECOND
    heard: tuple[int, int] | None = None  # stamp and arrival of the last accepted state
    q: Array = field(default_factory=lambda: np.full(2, 0.1))
    latched: bool = False
    acting: bool = False

    def state(self, later: int, q: Any, dq: Any = 0.0) -> None:
        """Send a state `later` [ns] than the newest; check its command."""
        tracker, given = self.tracker, self.tracker.settings
        command = tracker.command(sample(self.now + later, q, self.q + 0.01, dq, dq), self.arrival)
        stopped = tracker.state is State.STOPPED
        if command is not None:
            assert np.all(np.abs(command.u) <= LIMIT)
            assert not (self.latched and not stopped), "a stop ended by itself"
            assert np.isnan(command.V) or not stopped
            assert stopped == (command.state is State.STOPPED)
            if stopped and given.on_stop == ZERO:
                assert not command.u.any()
            if self.acting and np.isfinite(q).all():
                assert stopped or given.on_contact != STOP, "tracks in contact"
                assert stopped or bool(tracker.controller.supervisor.yielding) == (given.on_contact == YIELD)
            if np.isfinite(q).all():
                self.check_gap(self.now + later, stopped)
        self.latched = stopped and not tracker.controller.supervisor.resuming

    def check_gap(self, stamp: int, stopped: bool) -> None:
        """Check that no state moves the arm after a gap longer than the longest."""
        longest = self.tracker.settings.recovery_longest_gap * SECOND
        if self.heard is not None and self.heard[0] != stamp and longest and self.arrival - self.heard[1] > longest:
            assert stopped, "moves after a long gap"
        self.heard = stamp, self.arrival

    def wait(self, seconds: float) -> None:
        self.now += round(seconds * SECOND)
        self.arrival += round(seconds * SECOND)

    def happen(self, event: str) -> None:
        tracker, rng = self.tracker, self.rng
        if event == "states":
            for dq in rng.normal(0, 0.5, (rng.integers(1, 25), 2)):
                self.wait(1e-3)
                self.q = np.clip(self.q + 1e-3 * dq, -1, 1)
                self.state(0, self.q, dq)
        elif event in ("repeat", "late"):
            self.state(0 if event == "repeat" else -2 * MS, self.q)
        elif event == "pause":
            self.wait(rng.choice([0.02, 0.06, 0.11, 0.3]))
        elif event in ("jump", "back"):
            self.now = self.now + 5 * SECOND if event == "jump" else max(self.now - 7 * SECOND, SECOND)
        elif event in ("broken", "limit"):
            self.wait(1e-3)
            self.state(0, [np.nan if event == "broken" else 2.5, 0.0])
        elif event == "silence":
            self.wait(rng.choice([0.0, 0.15]))
            u = tracker.silence(self.arrival)
            assert u is None or (tracker.silence(self.arrival + SECOND) is None and np.all(np.abs(u) <= LIMIT))
        elif event == "contact":
            self.acting = not self.acting
            tracker.controller.contact.acting, tracker.controller.contact.joints = self.acting, 1
        else:
            self.request(event)

    def request(self, event: str) -> None:
        tracker, rng = self.tracker, self.rng
        if event == "follow":
            tracker.follow(Hold(rng.uniform(-0.5, 0.5, 2)), [None, self.now, self.now + SECOND // 5][rng.integers(3)])
        elif event == "apply":
            tracker.apply(tracker.settings)
        else:
            getattr(tracker, event)()
        self.latched &= event not in ("resume", "start")
        self.acting &= event != "start"
        self.heard = None if event == "start" else self.heard


@pytest.mark.parametrize("observed", [False, True], ids=["measured", "observed"])
@pytest.mark.parametrize("seed", range(12))
def test_whatever_happens_the_supervisor_is_as_its_model(seed: int, observed: bool) -> None:
    rng = np.random.default_rng(seed)
    given = settings(
        2,
        ramp_time=rng.choice([0.0, 0.05]),
        start_join_time=rng.choice([0.0, 0.3]),
        recovery_join_time=rng.choice([0.0, 0.3]),
        recovery_longest_gap=rng.choice([0.0, 0.2]),
        start_error=rng.choice([np.inf, 0.2]),
        on_stop=rng.choice([ZERO, GRAVITY_HOLD]),
        on_contact=rng.choice(REACTIONS),
        state_timeout=TIMEOUT / SECOND,
        link_velocity=5.0,
        link_position_upper=2.0,
        effort=LIMIT,
        wiring_check=False,
    )
    observer = VelocityObserver(TWO.robot, 200.0) if observed else None
    model = Model(ControlStep(TWO, TWO_SINES, given, observer=observer), rng)
    for event in rng.choice(EVENTS, 120):
        model.happen(event)
    for each in list(model.tracker.controller.journal.event):
        assert each.below == (each.value < each.limit), "an event below its limit says so"
