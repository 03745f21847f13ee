# SPDX-License-Identifier: Apache-2.0
"""The start of a sampled loop with springs that harden: how far they deflect, and whether the loop is stable there.

A start error deflects the springs beyond the motion of the reference, where they are stiffer, by their tangents
K + 3 k zeta^2. The theory holds at any stiffness in continuous time, the sampled loop only up to some. So the motion
from the start is simulated as sampled, and the one-sample map is that of straight springs with the stiffest tangents.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.errors import StateError
from fjr_core.law.linearized import equilibria_at
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.model.springs import hardening
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.numerics.checks import Array
from fjr_core.simulation.closed_loop import simulate
from fjr_core.stability.linearization import closed_form
from fjr_design.batch import Draws, scenario_loop
from fjr_design.batch.closed_loop import plain_settings

LASTING = 1.0  # s; simulated motion from the start, after the ramp of start.ramp_time
FAR = 1e6  # rad; error of a loop that diverges
HORIZON, INSTANTS = 60.0, 1024  # s of the reference whose deflections count, at most
SHARES = 65  # of the largest deflections, at which tangents are taken
NARROW = 0.02  # of the start error, between a part that is inside and one that is not


@dataclass(frozen=True, eq=False)
class HardStart:
    """The start of a scenario, with n springs of which some harden.

    error (n,) [rad]: q_l - q_ld. deflection (n,) [rad]: the largest, of the motion from the start and along the
    reference; infinite if the simulated loop diverges. radius: spectral radius with springs as stiff as there, infinite
    likewise. inside: largest part of the deviation from the reference, 0 to 1, with a radius below 1; 0 also if none.
    """

    error: Array
    deflection: Array
    radius: float
    inside: float

    @property
    def diverges(self) -> bool:
        """Return whether the simulated loop diverges from the start."""
        return not np.isfinite(self.radius)


def hard_start(scenario: Scenario) -> HardStart | None:
    """Return the start under v-dPBC; None with straight springs, another law, or a transition to the reference."""
    error = scenario.x0[: scenario.robot.n] - scenario.reference.jets(0.0)[0]
    most = np.asarray(scenario.settings.start_error)
    hard = any(robot.curve for robot in (scenario.robot, scenario.plant.robot))
    if np.any(np.abs(error) > most) or not hard or not isinstance(scenario.law, TrackingLaw):
        return None
    along = _along_reference(scenario)
    deflection = _deflection(scenario, 1.0, along)
    radius = _radius(scenario, deflection)
    low, high = (0.0, 1.0) if radius >= 1 else (1.0, 1.0)
    while high - low > NARROW:
        middle = (low + high) / 2
        stable = _radius(scenario, _deflection(scenario, middle, along)) < 1
        low, high = (middle, high) if stable else (low, middle)
    return HardStart(error, deflection, radius, low)


def _along_reference(scenario: Scenario) -> Array:
    """Return the largest deflections (n,) of the plant's springs along the reference."""
    instants = np.linspace(0.0, min(HORIZON, scenario.reference.end), INSTANTS)
    jets = np.asarray(scenario.reference.jets(instants))
    _, theta, *_ = inverse_dynamics(scenario.plant.robot)(*jets.transpose(1, 2, 0))
    return np.asarray(np.abs(theta.full().T - jets[:, 0]).max(axis=0))


def _deflection(scenario: Scenario, share: float, along: Array) -> Array:
    """Return the largest deflections (n,) with this share of the deviation from the reference at the start."""
    robot, n, T = scenario.plant.robot, scenario.robot.n, scenario.sample_period
    jets = scenario.reference.jets(0.0)
    _, q_m, dq_m, *_ = (value.full().ravel() for value in inverse_dynamics(robot)(*jets))
    on = np.array([jets[0], q_m, jets[1], dq_m])
    own = np.array([*np.split(scenario.x0[: 2 * n], 2), *robot.velocities(scenario.x0)])
    x = robot.state(*(on + share * (own - on)))
    if scenario.settings.ramp_time:
        states = _ramped(scenario, x)
    else:
        inner = T / scenario.inner_steps
        law, reference = scenario.sampled_law, scenario.reference
        try:
            states = simulate(scenario.plant, law, reference, x, LASTING, T, inner, delay=scenario.loop_delay).x
        except StateError:
            return np.full(n, np.inf)
    return np.maximum(along, np.abs(states[:, n : 2 * n] - states[:, :n]).max(axis=0))


def _ramped(scenario: Scenario, x: Array) -> Array:
    """Return the states (k, 4n) from x (4n,) under the control step, which ramps the effort; zero and inf if lost."""
    own, n = scenario.settings, scenario.robot.n
    settings = replace(plain_settings(n), ramp_time=own.ramp_time, on_stop=own.on_stop)
    loop = scenario_loop(scenario, scenario.sampled_law, own.ramp_time + LASTING, settle_after=0.0, lost=FAR)
    loop = replace(loop, x0=x, settings=settings, observer=None, measurement=None)
    outcomes, recorded = loop.recorded(Draws(1, delay=scenario.loop_delay))
    lost = np.repeat([[0.0, np.inf, 0.0, 0.0]], n, axis=1)
    return np.asarray(recorded.x[0] if outcomes.stable[0] else lost)


def _radius(scenario: Scenario, deflection: Array) -> float:
    """Return the largest spectral radius on the reference with springs as stiff as at the deflections (n,)."""
    law, where = scenario.law, scenario.configurations()
    if not np.isfinite(deflection).all() or not isinstance(law, TrackingLaw):
        return np.inf
    own, real = (equilibria_at(_stiffened(robot, deflection), where) for robot in (law.robot, scenario.plant.robot))
    return float(closed_form(own, law.gains, real).radii(scenario.sample_period, scenario.loop_delay).max())


def _stiffened(robot: Robot, deflection: Array) -> Robot:
    """Return the robot with straight springs as stiff as its own at most up to the deflections (n,)."""
    if not robot.curve:
        return robot
    on_the_way = np.linspace(0.0, 1.0, SHARES)[:, None] * deflection  # a table may soften
    stiffest = np.diag(robot.K) * hardening(robot, on_the_way).max(axis=0)
    return replace(robot, K=np.diag(stiffest), cubic=None, torsion=None)
