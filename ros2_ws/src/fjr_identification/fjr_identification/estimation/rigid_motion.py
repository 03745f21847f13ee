# SPDX-License-Identifier: Apache-2.0
"""The slow part of a record and the torques that its motion needs by the nominal robot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from scipy.signal import butter, sosfiltfilt

from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import spring_torque
from fjr_core.numerics.checks import Array

from .motion_record import MotionRecord

CUTOFF = 8.0  # Hz
SAMPLES = 4000  # that are kept, at most
EDGE, LARGEST_EDGE = 2.0 / CUTOFF, 0.2  # s at each end where the filter is not settled, and share of the record


@dataclass(frozen=True, eq=False)
class RigidMotion:
    """Filtered signals of k samples and n joints; each (k, n) unless noted.

    q_l, q_m, torque, u: as in the record, NaN where not measured. position, velocity: of the link, of the motor where
    the link is not measured. motor_velocity: of the motor or else of the link. tau: spring torque that the motion of
    the links needs. needed: effort that both sides need. both (n,): whether both sides are measured and move.
    independent: number of independent samples. dt [s]: between two of the k samples.
    """

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


def rigid_motion(record: MotionRecord, robot: Robot, scale: Array | float = 1.0, swapped: bool = False) -> RigidMotion:
    """Return the motion of a record below CUTOFF; scale: of the positions, (n,). swapped: exchange the sides."""
    sides = (record.q_m, record.q_l) if swapped else (record.q_l, record.q_m)
    q_l, q_m = (_low_pass(side * scale, record.dt) for side in sides)
    torque, u = _low_pass(record.torque, record.dt), _low_pass(record.u, record.dt)
    link, motor = np.where(np.isfinite(q_l), q_l, q_m), np.where(np.isfinite(q_m), q_m, q_l)
    dq_l, dq_m = (np.gradient(each, record.dt, axis=0) for each in (link, motor))
    ddq_l, ddq_m = (np.gradient(each, record.dt, axis=0) for each in (dq_l, dq_m))
    rows = _kept(len(u), record.dt)
    tau = spring_torques(robot, link[rows], dq_l[rows], ddq_l[rows])
    needed = (tau + ddq_m[rows] @ robot.M_m.T + dq_m[rows] @ robot.D_m.T) @ np.linalg.inv(robot.B_m).T
    moves = np.isfinite(q_l).all(axis=0) & np.isfinite(q_m).all(axis=0) & (np.ptp(link, axis=0) > 0)
    return RigidMotion(
        q_l[rows],
        q_m[rows],
        torque[rows],
        u[rows],
        link[rows],
        dq_l[rows],
        dq_m[rows],
        tau,
        needed,
        moves,
        max(4.0, 2 * CUTOFF * len(u) * record.dt),
        record.dt * rows.step,
    )


def _low_pass(values: Array, dt: float) -> Array:
    """Return the columns without what is faster than CUTOFF, without a lag; columns with NaN are NaN."""
    found = np.full_like(values, np.nan)
    known = np.isfinite(values).all(axis=0)
    if known.any():
        sections = butter(4, min(2 * CUTOFF * dt, 0.5), output="sos")
        found[:, known] = sosfiltfilt(sections, values[:, known], axis=0)
    return found


def _kept(k: int, dt: float) -> slice:
    """Return the rows that are kept: not the ends, and every so many."""
    edge = int(min(EDGE / dt, LARGEST_EDGE * k))
    return slice(edge, k - edge, max(1, k // SAMPLES))


def spring_torques(robot: Robot, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the spring torques (k, n) of a motion of the links, each (k, n)."""
    return np.asarray(_spring_torque(robot)(q.T, dq.T, ddq.T)).T


@lru_cache(maxsize=4)
def _spring_torque(robot: Robot) -> ca.Function:
    q, dq, ddq = (ca.SX.sym(name, robot.n) for name in ("q", "dq", "ddq"))
    return ca.Function("spring_torque", [q, dq, ddq], [spring_torque(robot, q, dq, ddq)])
