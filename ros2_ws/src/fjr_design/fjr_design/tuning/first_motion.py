# SPDX-License-Identifier: Apache-2.0
"""Propose a first motion of an arm: slow sines about a pose, within the limits of its joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fjr_core.errors import TrajectoryError
from fjr_core.model.configuration_sampling import bounds_of, sample_configurations
from fjr_core.model.robot import Robot
from fjr_core.motions.sine import Sine
from fjr_core.numerics.checks import Array

FREQUENCY = np.pi  # rad/s: 0.5 Hz
LARGEST_AMPLITUDE = 0.2, 0.05  # rad, m; of revolute and prismatic joints
RANGE, VELOCITY, EFFORT = 0.1, 0.25, 0.8  # largest fraction of the range, the velocity limit and the effort limit
MARGIN = 0.3  # of the range, between a pose and the limits
EASY_WEIGHT, LARGEST_WEIGHT = 0.5, 0.75  # of the effort limit
POSES, INSTANTS, HALVINGS = 256, 16, 8


def first_motion(robot: Robot, joints: Sequence[str]) -> Sine:
    """Return sines of all joints that start at rest and need no more than 80 % of the efforts (rigid inverse dynamics).

    The pose in the middle is the zero position if the arm can carry its weight there, else another one within the
    ranges. Self-collisions are not considered. Raises TrajectoryError, which names the joint, if an effort limit
    cannot carry the weight of the arm in any of the poses.
    """
    pose, (lower, upper) = _pose(robot, joints), bounds_of(robot)
    largest = np.array([LARGEST_AMPLITUDE[slides] for slides in robot.prismatic or (False,) * robot.n])
    velocity = np.inf if robot.limits is None else VELOCITY / FREQUENCY * robot.limits.velocity
    amplitude = np.minimum(np.minimum(largest, RANGE * (upper - lower)), velocity)
    for _ in range(HALVINGS):
        motion = Sine(amplitude, FREQUENCY, pose, -np.pi / 2)
        if np.all(_efforts(robot, motion) <= EFFORT * _effort_limits(robot)):
            break
        amplitude = amplitude / 2
    return motion


def _pose(robot: Robot, joints: Sequence[str]) -> Array:
    """Return the first pose whose weight is easy to carry, else that of the lightest weight."""
    lower, upper = bounds_of(robot)
    low, high = lower + MARGIN * (upper - lower), upper - MARGIN * (upper - lower)
    shares = []
    poses = np.clip(sample_configurations(robot, POSES), low, high)
    for pose in poses:
        shares.append(np.abs(robot.grad_P_l(pose)) / _effort_limits(robot))
        if shares[-1].max() <= EASY_WEIGHT:
            return pose
    best = int(np.argmin([share.max() for share in shares]))
    worst = int(np.argmax(shares[best]))
    if shares[best][worst] > LARGEST_WEIGHT:
        limit, unit = _effort_limits(robot)[worst], robot.units[worst].effort
        raise TrajectoryError(
            f"joint '{joints[worst]}' has an effort limit of {limit:g} {unit}, and in each of {POSES} poses the weight "
            f"of the arm needs {shares[best][worst] * limit:.3g} {unit} there or overloads another joint; "
            "expected limits that carry the arm with a margin of a quarter, or other joints"
        )
    return np.asarray(poses[best])


def _effort_limits(robot: Robot) -> Array:
    return np.full(robot.n, np.inf) if robot.limits is None else robot.limits.effort


def _efforts(robot: Robot, motion: Sine) -> Array:
    """Return the largest effort of each joint (n,) along the motion, of the arm with rigid joints."""
    largest = np.zeros(robot.n)
    for t in np.linspace(0, 2 * np.pi / FREQUENCY, INSTANTS, endpoint=False):
        q, dq, ddq = motion.jets(t)[:3]
        torque = (robot.M_l(q) + robot.M_m) @ ddq + robot.coriolis(q, dq, dq) + robot.grad_P_l(q)
        largest = np.maximum(largest, np.abs(np.linalg.solve(robot.B_m, torque)))
    return largest
