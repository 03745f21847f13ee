# SPDX-License-Identifier: Apache-2.0
"""Limits of a motion on both sides of the springs: position, speed, acceleration, deflection and effort."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import casadi as ca
import numpy as np

from fjr_core.errors import TrajectoryError
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.motions.reference import JETS, Reference
from fjr_core.numerics.checks import Array
from fjr_core.runtime.safety_settings import Settings

INSTANTS = 2000  # of a reference that stands for missing limits
ACCELERATION = 0.99  # of the limit, which the reference has to keep, not the robot
RESTING = 1e-6  # rad, rad/s, N m; range of a quantity that does not move
COMPLETED = {"q_l": "position", "dq_l": "velocity", "u": "effort"}


@dataclass(frozen=True, eq=False)
class ElasticMotion:
    """Motion of n elastic joints at k instants, each (k, n): what limits and information depend on."""

    q_l: Array  # [rad]
    dq_l: Array  # [rad/s]
    ddq_l: Array  # [rad/s^2]
    torque: Array  # of the springs [N m]
    q_m: Array  # [rad]
    dq_m: Array  # [rad/s]
    ddq_m: Array  # [rad/s^2]
    u: Array  # effort [N m]

    @property
    def stacked(self) -> Array:
        """Return all quantities (8, k, n)."""
        return np.stack([getattr(self, field.name) for field in fields(self)])


QUANTITIES = tuple(field.name for field in fields(ElasticMotion))


def elastic_motion(robot: Robot, jets: Array, function: ca.Function | None = None) -> ElasticMotion:
    """Return the motion of both sides along jets (k, 5, n) of the links.

    function: the inverse dynamics of the robot for k instants, where it was prepared for many calls.
    """
    rows = [jets[:, row].T for row in range(JETS)]
    found = (function or inverse_dynamics(robot).map(len(jets)))(*rows)
    tau, q_m, dq_m, ddq_m, torque = (value.full().T for value in found)
    q_l, dq_l, ddq_l = (row.T for row in rows[:3])
    return ElasticMotion(q_l, dq_l, ddq_l, tau, q_m, dq_m, ddq_m, torque @ np.linalg.inv(robot.B_m).T)


@dataclass(frozen=True, eq=False)
class MotionEnvelope:
    """Lower and upper limits (8, n) of QUANTITIES, infinite on both sides for none."""

    lower: Array
    upper: Array

    @cached_property
    def middle(self) -> Array:
        """Middle (8, n) of the limits, 0 without."""
        bounded = np.isfinite(self.upper)
        return (np.where(bounded, self.lower, 0.0) + np.where(bounded, self.upper, 0.0)) / 2

    @cached_property
    def slope(self) -> Array:
        """Derivative (8, 1, n) of the ratios: the inverse of half the distance of the limits."""
        return np.asarray(2.0 / (self.upper - self.lower)[:, None])

    def ratios(self, values: Array) -> Array:
        """Return the distance of values (8, k, n) from the middle, from -1 to 1 within the limits; 0 without."""
        return np.asarray((values - self.middle[:, None]) * self.slope)

    def keeps(self, values: Array) -> bool:
        """Return whether all values (8, k, n) are within the limits."""
        return bool(np.abs(self.ratios(values)).max() <= 1.0)

    def shrunk(self, share: float) -> MotionEnvelope:
        """Return the part `share` of the limits about their middle."""
        return MotionEnvelope(
            self.middle + share * (self.lower - self.middle), self.middle + share * (self.upper - self.middle)
        )


def motion_envelope(
    robot: Robot, settings: Settings, acceleration: Array, reference: Reference, share: float, horizon: float
) -> MotionEnvelope:
    """Return the part `share` of the limits of settings and robot, and those of acceleration (n,) [rad/s^2].

    Where position, speed or effort of a joint have no limit, the extremes of the reference in `horizon` [s] stand for
    it, undiminished. Motor positions count if both sides are limited. Raises TrajectoryError if the reference rests
    where it must stand for a limit.
    """
    held = settings if robot.limits is None else settings.tightened(robot.limits)
    none, torque = np.full(robot.n, np.inf), np.diag(robot.K) * np.asarray(held.deflection)
    magnitudes = (
        held.link_velocity,
        ACCELERATION / share * acceleration,
        torque,
        none,
        held.motor_velocity,
        none,
        held.effort,
    )
    upper = np.stack([none, *magnitudes])
    lower = -upper
    for row, side in ((0, "link"), (4, "motor")):
        ends = np.stack([getattr(held, f"{side}_position_{end}") for end in ("lower", "upper")])
        lower[row], upper[row] = np.where(np.isfinite(ends).all(axis=0), ends, [-none, none])
    given = MotionEnvelope(lower, upper).shrunk(share)
    return _completed(given, robot, reference, horizon, settings.joints)


def _completed(
    given: MotionEnvelope, robot: Robot, reference: Reference, horizon: float, joints: Sequence[str]
) -> MotionEnvelope:
    """Return the envelope with the extremes of the reference in place of missing limits."""
    lower, upper = given.lower.copy(), given.upper.copy()
    motion = elastic_motion(robot, np.asarray(reference.jets(np.linspace(0.0, min(horizon, reference.end), INSTANTS))))
    for name in COMPLETED:
        values, row = getattr(motion, name), QUANTITIES.index(name)
        peak = np.abs(values).max(axis=0)
        low, high = (values.min(axis=0), values.max(axis=0)) if name == "q_l" else (-peak, peak)
        missing = ~np.isfinite(upper[row])
        if np.any(still := missing & ~(high - low > RESTING)):
            raise TrajectoryError(
                f"joint '{joints[int(np.argmax(still))]}' has no {COMPLETED[name]} limit and rests along the "
                "reference; expected limits.* or a moving reference"
            )
        lower[row], upper[row] = np.where(missing, low, lower[row]), np.where(missing, high, upper[row])
    return MotionEnvelope(lower, upper)
