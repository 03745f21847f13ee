# SPDX-License-Identifier: Apache-2.0
"""Propose a first loop for an arm of which only the model is known: motion, gains, start and integrator steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fjr_core.config.controller import FROM_ROBOT
from fjr_core.config.law import gain_values
from fjr_core.config.scenario import Scenario
from fjr_core.errors import GainsError, TrajectoryError
from fjr_core.law.gains import Gains
from fjr_core.law.linearized import rest_position
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.configuration_sampling import bounds_of, sample_configurations
from fjr_core.model.robot import Robot
from fjr_core.motions.sine import Sine
from fjr_core.numerics.checks import Array
from fjr_design.stability.sampled_loop import SampledCheck, check, fastest_mode, least_steps
from fjr_design.tuning.gain_synthesis import GainSearch, gain_search
from fjr_msgs_py.console.output import phase, plural

RATE = 1000.0  # Hz
FEWEST_STEPS, STEP_MARGIN = 4, 2.0  # integrator steps per sample, and their factor beyond the stability of rk4
ALONG, EVERYWHERE = "along the reference", "everywhere"
TRIALS = (*((beta, ALONG) for beta in (6.0, 4.0, 2.5, 1.5, 1.0)), (1.0, EVERYWHERE), (0.3, EVERYWHERE))
"""Rate [1/s] and where it holds, in the order of the trials: the fastest that is robust first."""
DELAY_MARGIN = 0.4  # samples; gains that tolerate it everywhere end the search
FREQUENCY = np.pi  # rad/s: 0.5 Hz
LARGEST_AMPLITUDE = 0.2, 0.05  # rad, m; of revolute and prismatic joints
RANGE, VELOCITY, EFFORT = 0.1, 0.25, 0.8  # largest fraction of the range, the velocity limit and the effort limit
MARGIN = 0.3  # of the range, between a pose and the limits
EASY_WEIGHT, LARGEST_WEIGHT = 0.5, 0.75  # of the effort limit
POSES, INSTANTS = 256, 16  # configurations of the arm; instants of a cycle
START_ERROR, START_EFFORT = 0.25, 0.6  # of the amplitude; of the effort limit
HALVINGS = 8, 12  # of the amplitude; of the start error


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
        gains = first_gains(robot, 1 / RATE, motion.configurations(64), delay, joints)
    q_l, q_m = _start(robot, motion, gains.gains)
    steps = least_steps(STEP_MARGIN * fastest_mode(robot, motion.configurations(64)), 1 / RATE)
    return Proposal(motion, gains, q_l, q_m, max(FEWEST_STEPS, steps))


def _start(robot: Robot, motion: Sine, gains: Gains) -> tuple[Array, Array]:
    """Return a start at rest beside the motion, towards its middle; the first effort is within the limits."""
    law, jets = TrackingLaw(robot, gains), motion.jets(0.0)
    error = START_ERROR * np.asarray(motion.amplitude)
    for _ in range(HALVINGS[1]):
        position = rest_position(robot, np.asarray(jets[0]) + error)
        effort = np.abs(law.measured_command(position, np.zeros(2 * robot.n), jets)[0])
        weight = np.abs(np.linalg.solve(robot.B_m, robot.grad_P_l(position[: robot.n])))
        if np.all(effort <= np.maximum(START_EFFORT * _effort_limits(robot), 1.1 * weight)):
            break
        error = error / 2
    return position[: robot.n], position[robot.n :]


def first_values(loaded: Scenario) -> dict[str, Any]:
    """Return the parameters, by name, that make a robot file a scenario; loaded: the file as a scenario.

    Raises TrajectoryError or GainsError if there is no first motion, or no gains within reach.
    """
    robot = loaded.robot
    found = proposal_of(robot, loaded.joints, loaded.name)
    fields = {name: getattr(found.motion, name) for name in ("amplitude", "frequency", "offset", "phase")}
    return {
        "reference.type": "sine",
        **{f"reference.{name}": np.broadcast_to(value, robot.n).tolist() for name, value in fields.items()},
        **gain_values(found.gains.gains, robot.n),
        "initial_link_position": found.q_l.tolist(),
        "initial_motor_position": found.q_m.tolist(),
        "inner_steps": found.inner_steps,
        **({FROM_ROBOT.name: True} if robot.limits is not None else {}),
    }


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
    for _ in range(HALVINGS[0]):
        motion = Sine(amplitude, FREQUENCY, pose, -np.pi / 2)
        if np.all(_efforts(robot, motion) <= EFFORT * _effort_limits(robot)):
            break
        amplitude = amplitude / 2
    return motion


def _pose(robot: Robot, joints: Sequence[str]) -> Array:
    """Return the first pose whose weight is easy to carry, else that of the lightest weight."""
    lower, upper = bounds_of(robot)
    low, high = lower + MARGIN * (upper - lower), upper - MARGIN * (upper - lower)
    poses = np.clip(sample_configurations(robot, POSES), low, high)
    shares = np.abs([np.linalg.solve(robot.B_m, robot.grad_P_l(q)) for q in poses]) / _effort_limits(robot)
    easy = shares.max(axis=1) <= EASY_WEIGHT
    best = int(np.argmax(easy) if easy.any() else np.argmin(shares.max(axis=1)))
    worst = int(np.argmax(shares[best]))
    if shares[best][worst] > LARGEST_WEIGHT:
        limit, unit = _effort_limits(robot)[worst], robot.units[worst].effort
        raise TrajectoryError(
            f"joint '{joints[worst]}' has an effort limit of {limit:g} {unit}, and in each of {POSES} poses the weight "
            f"of the arm needs {shares[best][worst] * limit:.3g} {unit} there or overloads another joint; "
            "expected limits that carry the arm with a margin of a quarter, or other joints"
        )
    return np.asarray(poses[best])


def _efforts(robot: Robot, motion: Sine) -> Array:
    """Return the largest effort of each joint (n,) along the motion, of the arm with rigid joints."""
    instants = np.linspace(0, 2 * np.pi / FREQUENCY, INSTANTS, endpoint=False)
    torques = [
        (robot.M_l(q) + robot.M_m) @ ddq + robot.coriolis(q, dq, dq) + robot.grad_P_l(q)
        for q, dq, ddq in motion.jets(instants)[:, :3]
    ]
    return np.asarray(np.abs(np.linalg.solve(robot.B_m, np.transpose(torques))).max(axis=1))


@dataclass(frozen=True, eq=False)
class FirstGains:
    """Gains of a rate beta [1/s], where it holds, and the check of the sampled loop in the whole range."""

    gains: Gains
    beta: float
    where: str
    check: SampledCheck


def first_gains(
    robot: Robot, sample_period: float, configurations: Array, delay: float = 0.0, joints: Sequence[str] = ()
) -> FirstGains:
    """Return the first gains whose loop tolerates DELAY_MARGIN in the whole range, else the most tolerant ones.

    configurations (k, n) [rad]: of the reference. delay [s]: of the loop. joints: names. Raises GainsError, with the
    joint of the most variable inertia, if no trial is stable in the whole range.
    """
    best: FirstGains | None = None
    searches: dict[str, GainSearch] = {}
    for beta, where in TRIALS:
        if where not in searches:
            searches[where] = gain_search(robot, sample_period, delay, configurations if where == ALONG else None)
        gains = searches[where].best(beta)
        if gains is None:
            continue
        found = check(TrackingLaw(robot, gains), sample_period, delay, lowest_rate=False)
        if found.stable and (best is None or found.delay_margin > best.check.delay_margin):
            best = FirstGains(gains, beta, where, found)
        if best is not None and best.check.delay_margin >= DELAY_MARGIN:
            return best
    if best is None:
        M = np.sort([np.diag(robot.M_l(q)) for q in sample_configurations(robot, POSES)], axis=0)
        i = int(np.argmax(M[-1] / M[0]))
        inertia = robot.units[i].of(f"{M[0, i]:.3g} to {M[-1, i]:.3g} kg m^2")
        raise GainsError(
            f"no gains of {TRIALS[0][0]:g} to {TRIALS[-1][0]:g} 1/s are stable at {1 / sample_period:g} Hz in the "
            f"whole range: joint {repr(joints[i]) if joints else i + 1} moves {inertia}; expected less range or joints"
        )
    return best


def _effort_limits(robot: Robot) -> Array:
    return np.full(robot.n, np.inf) if robot.limits is None else robot.limits.effort
