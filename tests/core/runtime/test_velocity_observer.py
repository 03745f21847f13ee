# SPDX-License-Identifier: Apache-2.0
"""Velocity observer: exact for the exact model, convergence at its bandwidth, tracking in the loop."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import ARMS, Arm
from core.oracles.observer_error import error_radii
from fjr_core.config.controller import BANDWIDTH
from fjr_core.runtime.measurement_model import OBSERVER
from fjr_core.runtime.velocity_observer import LONGEST_GAP, corrections, first_corrections
from fjr_design.batch import Draws, scenario_loop
from fjr_msgs_py.scenarios import library

MS = 1_000_000  # ns
SHIPPED = ("paper_k31", "paper_k3p1", "two_link", "arm7")
arms = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)


class Moving:
    """A robot under random held efforts, integrated with fine steps, and its observer."""

    def __init__(self, arm: Arm, bandwidth: float = BANDWIDTH, seed: int = 0) -> None:
        self.arm, self.n, self.stamp = arm, arm.n, 5 * MS
        self.plant, self.rng = fjr.Plant(arm.robot), np.random.default_rng(seed)
        q_l = self.rng.uniform(-0.5, 0.5, arm.n)
        dq_l, dq_m = self.rng.uniform(-1, 1, (2, arm.n))
        self.x, self.u = arm.robot.state(q_l, q_l + 0.05, dq_l, dq_m), np.zeros(arm.n)
        self.observer = fjr.VelocityObserver(arm.robot, bandwidth)

    @property
    def q(self) -> np.ndarray:
        return self.x[: 2 * self.n]

    @property
    def dq(self) -> np.ndarray:
        return np.concatenate(self.plant.robot.velocities(self.x))

    @property
    def error(self) -> float:
        """Largest velocity error [rad/s]."""
        return float(np.abs(self.observer.state[2 * self.n :] - self.dq).max())

    def move(self, dt: int = MS) -> None:
        self.u = self.rng.uniform(-1, 1, self.n)
        steps = math.ceil(dt / MS) * 8
        for _ in range(steps):
            self.x = self.plant.step(self.x, self.u, dt * 1e-9 / steps)
        self.stamp += dt

    def update(self) -> tuple[np.ndarray, np.ndarray]:
        return self.observer.update(self.stamp, self.q[: self.n], self.q[self.n :], self.u)

    def run(self, samples: int, dt: int = MS) -> None:
        for _ in range(samples):
            self.move(dt)
            self.update()

    def begun(self, exact: bool = True) -> Moving:
        """Process the first sample; exact: set the true velocities, otherwise start at zero."""
        self.update()
        if exact:
            self.observer.state[2 * self.n :] = self.dq
        return self


@arms
def test_an_exact_estimate_stays_exact_at_any_sample_period(arm: Arm) -> None:
    moving = Moving(arm).begun()
    for dt in (MS, 2 * MS, MS // 3, 10 * MS, MS, 99 * MS, MS):
        moving.run(3, dt)
        assert moving.error < 1e-6
    np.testing.assert_allclose(moving.observer.state[: 2 * moving.n], moving.q, atol=1e-8)


@pytest.mark.parametrize("bandwidth", [40.0, 150.0, 400.0])
@arms
def test_a_wrong_estimate_decays_exponentially_at_the_bandwidth(arm: Arm, bandwidth: float) -> None:
    moving = Moving(arm, bandwidth).begun()
    moving.run(200)  # until the gains have settled
    moving.observer.state[2 * arm.n :] += 0.1
    moving.run(math.ceil(20e3 / bandwidth))
    assert moving.error < 1e-6


@arms
def test_start_in_motion_converges_well_before_one_time_constant(arm: Arm) -> None:
    moving = Moving(arm, bandwidth=20.0).begun(exact=False)
    assert moving.error == np.abs(moving.dq).max()
    moving.run(1)
    assert moving.error < 0.05 * np.abs(moving.dq).max()
    moving.run(4)
    assert moving.error < 0.02 * np.abs(moving.dq).max()


@pytest.mark.parametrize("bandwidth", [1.0, 150.0, 3000.0])
def test_both_poles_are_at_the_bandwidth(bandwidth: float) -> None:
    dt = 1e-3
    g, h = corrections(bandwidth, dt)
    error = np.array([[1 - g, (1 - g) * dt], [-h / dt, 1 - h]])
    z = math.exp(-bandwidth * dt)
    np.testing.assert_allclose(np.poly(error), [1, -2 * z, z * z], atol=1e-12)


def test_initial_gains_are_those_of_a_least_squares_line() -> None:
    y = np.random.default_rng(0).standard_normal(12)
    position, slope = y[0], 0.0
    for k in range(1, len(y)):
        g, h = first_corrections(k)
        error = y[k] - position - slope
        position, slope = position + slope + g * error, slope + h * error
        line = np.polyfit(np.arange(k + 1), y[: k + 1], 1)
        np.testing.assert_allclose([slope, position], [line[0], np.polyval(line, k)], rtol=1e-9)


BEGINNINGS = {
    "reset": lambda moving: moving.observer.reset(),
    "a stamp that went back": lambda moving: setattr(moving, "stamp", 1),
    "a long gap": lambda moving: setattr(moving, "stamp", moving.stamp + round(LONGEST_GAP * 1e9) + 1),
}


@pytest.mark.parametrize("beginning", BEGINNINGS)
def test_restart_uses_positions_only(beginning: str) -> None:
    moving = Moving(ARMS[2]).begun()
    moving.run(5)
    BEGINNINGS[beginning](moving)
    dq_l, dq_m = moving.update()
    assert not dq_l.any()
    assert not dq_m.any()
    assert (moving.observer.state[:4] == moving.q).all()
    moving.run(300)
    assert moving.error < 1e-6


@pytest.mark.parametrize(("bandwidth", "inertia"), [(5.0, 1e-2), (150.0, 1e-2), (150.0, 1e-3), (2000.0, 1e-3)])
def test_error_radius_of_an_undamped_joint_is_that_of_its_modes(bandwidth: float, inertia: float) -> None:
    k, m, dt = 2000.0, 0.02, 1e-3
    undamped = {"link_damping": 0.0, "motor_damping": 0.0, "gravity_torque": 1e-9}
    robot = fjr.single_link(stiffness=k, link_inertia=inertia, motor_inertia=m, **undamped)
    z, theta = math.exp(-bandwidth * dt), dt * math.sqrt(k / inertia + k / m)
    trace = (1 + z * z) * math.cos(theta) - (1 - z) ** 2 * math.sin(theta) / theta
    expected = max(z, np.abs(np.roots([1, -trace, z * z])).max())
    assert error_radii(robot, bandwidth, dt, [[0.3]])[0] == pytest.approx(expected, rel=1e-3)
    assert expected < 1
    if bandwidth == 150.0:  # upright, the joint of the paper falls at a rate below sqrt(m g l / M) = 5 1/s
        upright = fjr.single_link(stiffness=31.0, link_damping=0.0, motor_damping=0.0)
        slow, fast = (error_radii(upright, each, dt, [[np.pi]])[0] for each in (1.0, 50.0))
        assert slow > 1 > fast


@pytest.mark.parametrize("name", SHIPPED)
def test_tracks_with_16_bit_positions_only(name: str) -> None:
    _, observed = library.as_run(library.find(name), {"measurement.velocity": OBSERVER})
    loop = replace(scenario_loop(observed, observed.law, 3.0, settle_after=2.0), settings=None)  # no transition
    assert loop.run(Draws(1, resolution=2 * np.pi / 2**16)).rms.max() < 2e-3
