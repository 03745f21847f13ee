# SPDX-License-Identifier: Apache-2.0
"""What the checks of a record share: kinds of findings, the slow part of the motion, and lines fitted to it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from scipy.signal import butter, sosfiltfilt

from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import spring_torque
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import compiled
from fjr_core.runtime.events import Finding

from ..estimation.motion_record import MotionRecord

AT_REST, CONSTANT, TOO_SHORT, CLIPPED = "at_rest", "constant", "too_short", "clipped"
DEGREES, GEAR_RATIO, SIGN, SWAPPED, SCALE = "degrees", "gear_ratio", "sign", "swapped_sides", "effort_scale"
JUMP, STUCK, SKEW, ORDER, TIME = "jump", "stuck", "skew", "joint_order", "time_scale"
KINDS = (
    *(TOO_SHORT, AT_REST, CONSTANT, JUMP, STUCK, DEGREES, ORDER),
    *(GEAR_RATIO, SIGN, SKEW, SWAPPED, SCALE, TIME, CLIPPED),
)
CUTOFF = 8.0  # Hz
SAMPLES = 4000  # that are kept, at most
EDGE, LARGEST_EDGE = 2.0 / CUTOFF, 0.2  # s at each end where the filter is not settled, and share of the record
LEAST_SHARE = 1e-6  # of a regressor's variance that the others do not explain
ROUNDING = 1e-20  # share of the squares of a regressor below which it is constant


def contradiction(kind: str, joint: str, seen: str, expected: str) -> Finding:
    """Return a finding of a record, which says what was seen and what was expected."""
    return Finding(kind, joint, sentence=f"{seen}; expected {expected}")


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """Filtered signals of a record, k samples of n joints, and what a robot needs for them; each (k, n) unless noted.

    q_l, q_m, torque, u: as in the record, NaN where not measured. position, velocity: of the link, of the motor where
    the link is not measured. motor_velocity: of the motor or else of the link. tau: spring torque that the motion of
    the links needs. needed: effort that both sides need. both (n,): whether both sides are measured and move.
    independent: number of independent samples. dt [s]: between two of the k samples.
    """

    record: MotionRecord
    robot: Robot
    q_l: Array
    q_m: Array
    torque: Array
    u: Array
    position: Array
    velocity: Array
    motor_velocity: Array
    tau: Array
    needed: Array
    both: Array
    independent: float
    dt: float

    @property
    def deflection(self) -> Array:
        """q_m - q_l."""
        return np.asarray(self.q_m - self.q_l)

    @cached_property
    def exchanged(self) -> RigidMotion:
        """The motion of the record with its sides exchanged."""
        return rigid_motion(replace(self.record, q_l=self.record.q_m, q_m=self.record.q_l), self.robot)

    def line(self, x: Array, y: Array, *others: Array) -> FittedLine:
        """Fit y = slope x + others + constant by least squares; all are (k,).

        A regressor that the others explain has the slope 0 with an infinite deviation.
        """
        least = len(x) * max(LEAST_SHARE * float(np.var(x)), ROUNDING * float(np.mean(x**2)))
        x, y = without(x, *others), without(y, *others)
        power, total = float(x @ x), float(y @ y)
        if not power > least or total == 0:
            return FittedLine(0.0, np.inf, 1.0)
        slope = float(x @ y) / power
        residual = y - slope * x
        freedom = max(1.0, self.independent - len(others) - 2)
        deviation = np.sqrt(float(residual @ residual) / power / freedom)
        return FittedLine(slope, float(deviation), float(residual @ residual) / total)


@dataclass(frozen=True)
class FittedLine:
    """Slope of y over x, its standard deviation, and the share of the variance of y that the fit leaves."""

    slope: float
    deviation: float
    unexplained: float


def rigid_motion(record: MotionRecord, robot: Robot, scale: Array | float = 1.0) -> RigidMotion:
    """Return the motion of a record below CUTOFF; scale: of the positions, (n,)."""
    signals = record.q_l * scale, record.q_m * scale, record.torque, record.u
    q_l, q_m, torque, u = (_low_pass(signal, record.dt) for signal in signals)
    link, motor = np.where(np.isfinite(q_l), q_l, q_m), np.where(np.isfinite(q_m), q_m, q_l)
    dq_l, dq_m = (np.gradient(q, record.dt, axis=0) for q in (link, motor))
    ddq_l, ddq_m = (np.gradient(dq, record.dt, axis=0) for dq in (dq_l, dq_m))
    edge = int(min(EDGE / record.dt, LARGEST_EDGE * len(u)))
    rows = slice(edge, len(u) - edge, max(1, len(u) // SAMPLES))
    tau = spring_torques(robot, link[rows], dq_l[rows], ddq_l[rows])
    needed = (tau + ddq_m[rows] @ robot.M_m.T + dq_m[rows] @ robot.D_m.T) @ np.linalg.inv(robot.B_m).T
    both = np.isfinite(q_l).all(axis=0) & np.isfinite(q_m).all(axis=0) & (np.ptp(link, axis=0) > 0)
    independent, dt = max(4.0, 2 * CUTOFF * len(u) * record.dt), record.dt * rows.step
    measured = q_l[rows], q_m[rows], torque[rows], u[rows]
    return RigidMotion(record, robot, *measured, link[rows], dq_l[rows], dq_m[rows], tau, needed, both, independent, dt)


def _low_pass(values: Array, dt: float) -> Array:
    """Return the columns without what is faster than CUTOFF, without a lag; columns with NaN are NaN."""
    slow = np.full_like(values, np.nan)
    measured = np.isfinite(values).all(axis=0)
    if measured.any():
        sections = butter(4, min(2 * CUTOFF * dt, 0.5), output="sos")
        slow[:, measured] = sosfiltfilt(sections, values[:, measured], axis=0)
    return slow


def spring_torques(robot: Robot, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the spring torques (k, n) of a motion of the links, each (k, n)."""
    return np.asarray(_spring_torque(robot)(q.T, dq.T, ddq.T)).T


@lru_cache(maxsize=4)
def _spring_torque(robot: Robot) -> ca.Function:
    q, dq, ddq = (ca.SX.sym(name, robot.n) for name in ("q", "dq", "ddq"))
    return compiled(ca.Function("spring_torque", [q, dq, ddq], [spring_torque(robot, q, dq, ddq)]))


def without(values: Array, *others: Array) -> Array:
    """Return the values (k,) without their projection on the others, (k,) each, and on a constant."""
    rest = np.column_stack([*others, np.ones_like(values)])
    return np.asarray(values - rest @ np.linalg.lstsq(rest, values, rcond=None)[0])
