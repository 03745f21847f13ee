# SPDX-License-Identifier: Apache-2.0
"""Starts with springs that harden: the check against simulations and the map of the stiffest springs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import Array
from fjr_core.config.scenario import Scenario
from fjr_design.batch import Draws, scenario_loop
from fjr_design.stability.hard_start import HardStart, hard_start
from fjr_design.stability.sampled_loop import check
from fjr_msgs_py.scenarios import library

AT = 0.1  # rad, at which the springs carry twice the torque of straight ones
CUBIC = np.diag(fjr.planar_two_link().K) / AT**2


def started(share: float, *more: str) -> Scenario:
    """Return two_link with springs that harden, this share of its start error away from the motion of its reference."""
    on = {"link_position": [0.3, 0.0], "motor_position": [0.337, 0.019], "link_velocity": [1.0, 2.1]}
    on["motor_velocity"] = on["link_velocity"]
    at = [f"initial_{name}:={[float((1 - share) * each) for each in value]}" for name, value in on.items()]
    return library.load("two_link", [f"robot.cubic_stiffness:={CUBIC.tolist()}", *at, *more])


def found(scenario: Scenario) -> HardStart:
    start = hard_start(scenario)
    assert start is not None
    return start


def tracks(scenario: Scenario) -> bool:
    """Return whether the simulated loop is on its reference after three seconds."""
    try:
        run = scenario.simulate(3.0)
    except fjr.StateError:
        return False
    return bool(np.abs(run.x[-500:, :2] - run.jets[-500:, 0]).max() < 1e-3)


@pytest.mark.parametrize("share", [0.2, 0.7, 1.2])
def test_a_start_diverges_where_the_simulation_does(share: float) -> None:
    scenario = started(share, "limits.start_error:=[1.0, 1.0]")
    assert found(scenario).diverges != tracks(scenario)


def test_a_ramp_of_the_effort_counts_as_the_control_step_applies_it() -> None:
    """With a ramp the arm first falls without effort; the oracle is a run of both nodes' code with the same start."""
    sudden, ramped = (found(started(0.3, f"start.ramp_time:={each}")) for each in (0.0, 0.2))
    scenario = started(0.3, "start.ramp_time:=0.2")
    loop = scenario_loop(scenario, scenario.sampled_law, 1.2, settle_after=0.0)
    x = loop.recorded(Draws(1))[1].x[0]
    assert np.all(ramped.deflection >= np.abs(x[:, 2:4] - x[:, :2]).max(axis=0) - 1e-9)
    assert ramped.deflection != pytest.approx(sudden.deflection, rel=1e-3)


def stiffened(robot: fjr.Robot, deflection: Array) -> fjr.Robot:
    """Return the robot with straight springs of the slope of K zeta + k zeta^3 at the deflections, by differences."""
    K, h = np.diag(robot.K), 1e-6
    torques = [K * zeta + CUBIC * zeta**3 for zeta in (deflection + h, deflection - h)]
    return replace(robot, K=np.diag((torques[0] - torques[1]) / (2 * h)), cubic=None)


def test_the_start_inside_is_that_at_which_the_loop_of_the_stiffest_springs_becomes_unstable() -> None:
    """Just below it, the sampled check of straight springs as stiff as at the deflections is just stable."""
    whole = found(started(1.0))
    assert whole.error == pytest.approx([-0.3, 0.0])
    assert whole.diverges
    assert 0.2 < whole.inside < 0.7
    part = started(whole.inside - 0.02)
    start, run = found(part), part.simulate(1.0)
    assert start.inside == 1.0
    assert np.all(start.deflection >= np.abs(run.x[:, 2:4] - run.x[:, :2]).max(axis=0) - 1e-12)
    law = fjr.TrackingLaw(stiffened(part.robot, start.deflection), part.gains)
    radius = check(law, part.sample_period, configurations=part.configurations(), lowest_rate=False).spectral_radius
    assert start.radius == pytest.approx(radius, abs=1e-6)
    assert 0.97 < radius < 1
    beyond = found(started(whole.inside + 0.1))
    assert beyond.radius > 1
    assert beyond.inside < 1


def test_straight_springs_other_laws_and_transitions_have_no_such_start() -> None:
    assert hard_start(library.load("two_link", [])) is None
    assert hard_start(started(1.0, "limits.start_error:=[0.1, 0.1]")) is None
