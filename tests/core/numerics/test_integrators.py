# SPDX-License-Identifier: Apache-2.0
"""Integrators: order of convergence, and the energy of undamped robots under the implicit midpoint rule."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fjr_core as fjr

ORDERS = {"rk4": 4, "implicit_midpoint": 2}
DURATION = 0.2


def walk(plant: fjr.Plant, x: np.ndarray, u: np.ndarray, steps: int) -> np.ndarray:
    for _ in range(steps):
        x = plant.step(x, u, DURATION / steps)
    return x


def measured_order(plant: fjr.Plant, x: np.ndarray, u: np.ndarray, exact: np.ndarray) -> np.ndarray:
    steps = np.array([160, 320, 640])
    errors = [np.max(np.abs(walk(plant, x, u, k) - exact)) for k in steps]
    return -np.diff(np.log2(errors))


@pytest.mark.parametrize("integrator", ORDERS)
@pytest.mark.parametrize("robot", [fjr.single_link(), fjr.planar_two_link()], ids=["single", "planar"])
def test_order_of_convergence_against_a_high_precision_solution(robot: fjr.Robot, integrator: str) -> None:
    n, plant = robot.n, fjr.Plant(robot, integrator)
    x, u = robot.state(np.full(n, 0.8), np.full(n, 0.7), np.full(n, -2), np.full(n, 1)), np.full(n, 0.5)
    run = solve_ivp(lambda _, y: plant.derivative(y, u), (0, DURATION), x, method="DOP853", rtol=1e-13, atol=1e-14)
    assert measured_order(plant, x, u, run.y[:, -1]) == pytest.approx(ORDERS[integrator], abs=0.1)


FREE = fjr.planar_two_link(link_damping=0.0, motor_damping=0.0)
START = FREE.state([0.4, -0.25], [0.4, -0.25], [0, 0], [0, 0])
"""An undamped arm falls from rest with unloaded springs."""


def test_implicit_midpoint_conserves_the_energy_of_a_free_robot() -> None:
    """Over 30 s at 1 ms the energy stays within 1e-6 of its initial value and does not drift."""
    plant, x, u, H = fjr.Plant(FREE, "implicit_midpoint"), START, np.zeros(2), []
    for _ in range(30_000):
        H.append(FREE.hamiltonian(x))
        x = plant.step(x, u, 1e-3)
    H = np.array(H) / H[0]
    assert np.max(np.abs(H - 1)) <= 1e-6
    wobble = np.max(H) - np.min(H)
    assert abs(np.mean(H[-5000:]) - np.mean(H[:5000])) <= 0.05 * wobble
    assert abs(np.polyfit(np.linspace(0, 1, len(H)), H, 1)[0]) <= 0.05 * wobble


@pytest.mark.parametrize("integrator", ORDERS)
def test_steps_far_from_the_origin(integrator: str) -> None:
    """Whole turns of the joint do not change a step, even under a large effort."""
    robot = fjr.single_link()
    plant, turns = fjr.Plant(robot, integrator), 2 * np.pi * 1000
    near, far = (robot.state(0.3 + q, 0.5 + q, 5, -3) for q in (0.0, turns))
    steps = [plant.step(x, [250.0], 1e-3) for x in (near, far)]
    assert steps[1] - steps[0] == pytest.approx(np.array([turns, turns, 0, 0]), abs=1e-9)


@pytest.mark.parametrize("dt", [1e-3, -1e-3, 0.1, 10.0])
def test_implicit_midpoint_solves_its_equation_even_for_huge_steps(dt: float) -> None:
    """The equation is symmetric in time."""
    plant, u = fjr.Plant(FREE, "implicit_midpoint"), np.array([0.3, -0.2])
    z = plant.step(START, u, dt)
    assert z - START == pytest.approx(dt * plant.derivative((START + z) / 2, u), abs=1e-11)
