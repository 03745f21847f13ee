# SPDX-License-Identifier: Apache-2.0
"""The virtual system (38): equality with the plant on the diagonal, variational system, and Theorem 2."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fjr_core as fjr
from core.oracles.cases import (
    ARMS,
    HARD,
    TORSION,
    Arm,
    GainSet,
    cubic,
    linear,
    planar,
    random_point,
    random_state,
    single,
)
from core.oracles.chains import arm7, two_joints
from core.oracles.oracle import LiteralPlant, exact, stencil
from core.oracles.properties import TOLERANCE, residual

arms = pytest.mark.parametrize("arm", ARMS + HARD, ids=lambda arm: arm.name)
seeds = pytest.mark.parametrize("seed", range(2))


@pytest.mark.parametrize("arm", [*ARMS, *HARD, two_joints(), arm7()], ids=lambda arm: arm.name)
@seeds
def test_virtual_system_equals_the_plant_on_the_diagonal_for_any_input(arm: Arm, seed: int) -> None:
    p = random_point(arm, seed)
    virtual = fjr.VirtualSystem(arm.robot).derivative(p.x, p.x, p.u)
    assert residual(virtual, fjr.Plant(arm.robot).derivative(p.x, p.u)) <= 1e-13


@pytest.mark.parametrize("arm", ARMS + HARD + TORSION, ids=lambda arm: arm.name)
@seeds
def test_derivative_agrees_with_the_literal_virtual_system(arm: Arm, seed: int) -> None:
    p = random_point(arm, seed)
    wanted = LiteralPlant(arm).virtual(exact(p.x_v), exact(p.x), exact(p.u)).astype(float)
    assert fjr.VirtualSystem(arm.robot).derivative(p.x_v, p.x, p.u) == pytest.approx(wanted, rel=1e-12, abs=1e-12)


@arms
@seeds
def test_variational_system_is_the_derivative_in_x_v_and_u(arm: Arm, seed: int) -> None:
    p, system = random_point(arm, seed), fjr.VirtualSystem(arm.robot)
    rng = np.random.default_rng(100 + seed)
    delta_x_v, delta_u = rng.uniform(-1, 1, 4 * arm.n), rng.uniform(-1, 1, arm.n)
    wanted = stencil(lambda s: system.derivative(p.x_v + s * delta_x_v, p.x, p.u + s * delta_u), 0.03)
    assert residual(system.variational(p.x_v, p.x, delta_x_v, delta_u), wanted) <= TOLERANCE


def errors_of_virtual_solutions(arm: Arm, gains: GainSet, duration: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return |x_v - x| at start and end for three x_v(0), and |q_l - q_ld| at the end, under a persistent omega(t).

    omega keeps x(t) away from the reference, so that converging to x differs from converging to the reference.
    """
    law, plant, system = (
        fjr.TrackingLaw(arm.robot, gains.gains),
        fjr.Plant(arm.robot),
        fjr.VirtualSystem(arm.robot),
    )
    reference = fjr.Sine(np.linspace(1.0, 0.6, arm.n), np.linspace(1.0, 1.7, arm.n))
    rng = np.random.default_rng(9)
    start = np.concatenate([random_state(arm, rng, 0.5) for _ in range(4)])

    def field(t: float, z: np.ndarray) -> np.ndarray:
        x, *virtual = np.split(z, 4)
        jets, omega = reference.jets(t), np.full(arm.n, 2.0 * np.cos(3 * t))
        dx = plant.derivative(x, law.effort(x, x, jets, omega))
        return np.concatenate([dx, *(system.derivative(y, x, law.effort(y, x, jets, omega)) for y in virtual)])

    end = solve_ivp(field, (0, duration), start, method="DOP853", rtol=1e-9, atol=1e-11).y[:, -1]
    gaps = [np.max(np.abs(z.reshape(4, -1)[1:] - z.reshape(4, -1)[0]), axis=1) for z in (start, end)]
    return gaps[0], gaps[1], float(np.max(np.abs(end[: arm.n] - reference.jets(duration)[0])))


@pytest.mark.parametrize(
    ("arm", "gains"), [(single(3.1), linear(1)), (planar("31", 31.0), cubic(2))], ids=lambda each: each.name
)
def test_every_virtual_solution_converges_to_the_actual_one(arm: Arm, gains: GainSet) -> None:
    """Theorem 2."""
    at_start, at_end, error = errors_of_virtual_solutions(arm, gains, 2.5)
    assert np.min(at_start) > 0.1
    assert np.max(at_end) < 1e-6
    assert error > 1e-3
