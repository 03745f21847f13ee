# SPDX-License-Identifier: Apache-2.0
"""The tracker in closed loop with a simulated plant, sample by sample, without ROS."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

import fjr_core as fjr
from fjr_core.numerics.symbolic import NumericFunction
from fjr_core.robust.law import Robust
from fjr_core.runtime.control_step import Command, ControlStep
from fjr_core.runtime.library import constant
from fjr_core.runtime.safety_settings import Settings

PERIOD = 1_000_000  # ns
TWO_LINK_GAINS = fjr.Gains(
    Lambda_l=16.0,
    Pi_l=np.array([[32.22, 4.272], [4.272, 4.229]]),
    K_ld=np.array([[1.697, 0.225], [0.225, 0.2227]]),
    Lambda_m=16.0,
    Pi_m=np.array([40.0, 25.0]),
    K_md=np.array([0.32, 0.16]),
)


def sample(stamp: int, q_l: Any, q_m: Any, dq_l: Any = 0.0, dq_m: Any = 0.0) -> Any:
    vectors = np.broadcast_arrays(*(np.atleast_1d(np.asarray(v, dtype=float)) for v in (q_l, q_m, dq_l, dq_m)))
    return SimpleNamespace(stamp=stamp, q_l=vectors[0], q_m=vectors[1], dq_l=vectors[2], dq_m=vectors[3])


def settings(n: int = 1, **given: Any) -> Settings:
    return replace(Settings(tuple(f"joint{i + 1}" for i in range(n))), **given)


def motion_of_a_period(robot: fjr.Robot) -> NumericFunction:
    """Return the state a PERIOD after x under u, in four steps, as one function of x and u."""
    x, u = ca.MX.sym("x", 4 * robot.n), ca.MX.sym("u", robot.n)
    step, after = fjr.Plant(robot).step_function, x
    for _ in range(4):
        after = step(after, u, PERIOD * 1e-9 / 4)
    return NumericFunction(ca.Function("period", [x, u], [after]))


class Loop:
    """A plant and a tracker of the same robot, with a record of both; the arrival clock is that of the stamps."""

    def __init__(self, law: fjr.TrackingLaw, reference: fjr.Reference, given: Settings, x0: Any, **more: Any) -> None:
        self.tracker = ControlStep(law, reference, given, **more)
        self.robot, self._after_a_period = law.robot, motion_of_a_period(law.robot)
        self.x = np.asarray(x0, dtype=float)
        self.now = 10**9
        self.u = np.zeros(law.robot.n)
        self.commands: list[Command] = []
        self.efforts: list[Any] = []
        self.states: list[Any] = []

    def sample(self) -> Any:
        n = self.robot.n
        return sample(self.now, self.x[:n], self.x[n : 2 * n], *self.robot.velocities(self.x))

    def step(self, answered: bool = True) -> Command | None:
        command = None
        if answered:
            command = self.tracker.command(self.sample(), self.now)
            self.u = command.u.copy()
            self.commands.append(command)
        self.efforts.append(self.u)
        self.states.append(self.x)
        (self.x,) = self._after_a_period(self.x, self.u)
        self.now += PERIOD
        return command

    def run(self, seconds: float, answered: bool = True) -> None:
        for _ in range(round(seconds * 1e9 / PERIOD)):
            self.step(answered)

    def run_through_transition(self, more: float = 1.0) -> None:
        """Run until the transition has ended, and for `more` seconds."""
        end = self.tracker.controller.supervisor.reference.transition_end
        self.run((end - self.now) * 1e-9 + more)

    @property
    def error(self) -> float:
        """Return the largest |q_tilde_l| at the last sample."""
        return float(np.max(np.abs(self.states[-1][: self.robot.n] - self.commands[-1].jets[0])))


def largest_step(efforts: Any) -> float:
    """Return the largest change of an effort between two samples [N m]."""
    return float(np.max(np.abs(np.diff(np.asarray(efforts), axis=0))))


OBSERVED = int(constant("OBSERVED"))
"""Samples after a reset of the observer before its velocities are used."""
STILL: dict[str, Any] = {"wiring_check": False}
"""Setting for states that repeat whatever the effort is; with the check no motor stands still against an effort."""
MS = 1_000_000
SECOND = 1_000_000_000
SINE = fjr.Sine(1.0, 1.0)
TWO_SINES = fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0])

LAW, TWO = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS), fjr.TrackingLaw(fjr.planar_two_link(), TWO_LINK_GAINS)
STEP = 0.3
"""The largest step [N m] of an effort of the two-link arm that a recovery may make."""


def moving_arm(**given: Any) -> Loop:
    """Return the loop of the two-link arm, which starts at rest beside its moving reference."""
    return Loop(TWO, TWO_SINES, settings(2, **given), TWO.robot.state(0.0, 0.0, 0.0, 0.0))


LIMITED = {
    "link_position_upper": ("link position", lambda v: (v, 0.0, 0.0, 0.0)),
    "link_position_lower": ("link position", lambda v: (-v, 0.0, 0.0, 0.0)),
    "motor_position_upper": ("motor position", lambda v: (0.0, v, 0.0, 0.0)),
    "motor_position_lower": ("motor position", lambda v: (0.0, -v, 0.0, 0.0)),
    "link_velocity": ("link velocity", lambda v: (0.0, 0.0, -v, 0.0)),
    "motor_velocity": ("motor velocity", lambda v: (0.0, 0.0, 0.0, v)),
    "deflection": ("deflection", lambda v: (0.0, -v, 0.0, 0.0)),
    "tracking_error": ("tracking error", lambda v: (v, 0.0, 0.0, 0.0)),
}
"""By limit: the kind of its violation, and a state (q_l, q_m, dq_l, dq_m) in which the quantity is v."""


def kinds(tracker: ControlStep) -> list[str]:
    return [event.kind for event in tracker.events]


def tracker_at(
    *stamps: int, reference: fjr.Reference = SINE, robust: Robust | None = None, **given: Any
) -> ControlStep:
    tracker = ControlStep(LAW, reference, settings(**STILL, **given), robust=robust)
    for stamp in stamps:
        assert tracker.command(sample(stamp, 0.5, 0.5), stamp) is not None
    return tracker


def last_effort(tracker: ControlStep) -> np.ndarray:
    """Return the last effort sent (n,), within the present limits."""
    return np.array(list(tracker.controller.limits.sent))


class Passed:
    """A law in Python whose effort is the link position, so that a test chooses the effort."""

    def __init__(self, robot: fjr.Robot) -> None:
        self.n = robot.n

    def effort(self, position: Any, velocity: Any, jets: Any) -> Any:
        return position[: self.n]


def bare_sample(stamp: int, q: float = 0.5) -> Any:
    bare = sample(stamp, q, q)
    bare.dq_l = bare.dq_m = None
    return bare
