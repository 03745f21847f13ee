# SPDX-License-Identifier: Apache-2.0
"""Propose a loop for an arm: a motion, gains, an initial state and integrator steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.law.gains import Gains
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.motions.sine import Sine
from fjr_core.numerics.checks import Array
from fjr_core.stability.linearization import rest_position
from fjr_design.stability.integration_steps import fastest_mode, least_steps
from fjr_design.tuning.first_gains import FirstGains, first_gains
from fjr_design.tuning.first_motion import first_motion
from fjr_msgs_py.console.output import phase, plural

RATE = 1000.0  # Hz
FEWEST_STEPS, STEP_MARGIN = 4, 2.0  # integrator steps per sample, and their factor beyond the stability of rk4
START_ERROR = 0.25  # of the amplitude
START_EFFORT = 0.6  # of the effort limit
HALVINGS = 12


@dataclass(frozen=True, eq=False)
class Proposal:
    """A loop at RATE: motion, gains, and the initial positions of links and motors (n,) [rad, m]."""

    motion: Sine
    gains: FirstGains
    q_l: Array
    q_m: Array
    inner_steps: int


def proposal_of(robot: Robot, joints: Sequence[str], name: str, delay: float = 0.0) -> Proposal:
    """Return a loop with a delay [s] for the robot; raises TrajectoryError or GainsError if none is within reach."""
    motion = first_motion(robot, joints)
    with phase(f"{name}: computing gains for {plural(robot.n, 'joint')}"):
        gains = first_gains(robot, 1 / RATE, motion.configurations(64), delay)
    q_l, q_m = _start(robot, motion, gains.gains)
    steps = least_steps(STEP_MARGIN * fastest_mode(robot, motion.configurations(64)), 1 / RATE)
    return Proposal(motion, gains, q_l, q_m, max(FEWEST_STEPS, steps))


def _start(robot: Robot, motion: Sine, gains: Gains) -> tuple[Array, Array]:
    """Return a start at rest beside the motion, towards its middle; the first effort is within the limits."""
    law, jets = TrackingLaw(robot, gains), motion.jets(0.0)
    limits = np.full(robot.n, np.inf) if robot.limits is None else robot.limits.effort
    error = START_ERROR * np.asarray(motion.amplitude)
    for _ in range(HALVINGS):
        position = rest_position(robot, np.asarray(jets[0]) + error)
        effort = np.abs(law.measured_command(position, np.zeros(2 * robot.n), jets)[0])
        if np.all(effort <= np.maximum(START_EFFORT * limits, 1.1 * np.abs(robot.grad_P_l(position[: robot.n])))):
            break
        error = error / 2
    return position[: robot.n], position[robot.n :]
