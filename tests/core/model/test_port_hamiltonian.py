# SPDX-License-Identifier: Apache-2.0
"""The plant (36) as a port-Hamiltonian system: structure, gradient, power balance."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import ARMS, HARD, TORSION, Arm, random_point
from core.oracles.chains import arm7, two_joints
from core.oracles.oracle import LiteralPlant, exact, stencil
from core.oracles.properties import TOLERANCE, residual

arms = pytest.mark.parametrize("arm", ARMS + HARD, ids=lambda arm: arm.name)
URDF_ARMS = two_joints(), arm7()
seeds = pytest.mark.parametrize("seed", range(2))


@arms
@seeds
def test_derivative_is_structure_times_gradient(arm: Arm, seed: int) -> None:
    p, plant = random_point(arm, seed), fjr.Plant(arm.robot)
    (J, R, G), gradient = plant.structure(p.x), plant.gradient(p.x)
    assert residual(plant.derivative(p.x, p.u), J @ gradient, -R @ gradient, G @ p.u) <= TOLERANCE


@arms
def test_J_is_skew_and_R_is_symmetric_positive_semidefinite(arm: Arm) -> None:
    J, R, G = fjr.Plant(arm.robot).structure(random_point(arm, 0).x)
    n = arm.n
    assert np.array_equal(J, -J.T)
    assert np.array_equal(R, R.T)
    assert np.min(np.linalg.eigvalsh(R)) >= -1e-15
    assert np.array_equal(R[2 * n : 3 * n, 2 * n : 3 * n], arm.D_l)
    assert np.array_equal(R[3 * n :, 3 * n :], arm.D_m)
    assert np.array_equal(G, np.vstack([np.zeros((3 * n, n)), arm.B_m]))


@pytest.mark.parametrize("arm", ARMS + HARD + TORSION, ids=lambda arm: arm.name)
@seeds
def test_derivative_agrees_with_the_literal_plant(arm: Arm, seed: int) -> None:
    p = random_point(arm, seed)
    wanted = LiteralPlant(arm).derivative(exact(p.x), exact(p.u)).astype(float)
    assert fjr.Plant(arm.robot).derivative(p.x, p.u) == pytest.approx(wanted, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_outputs_are_positions_velocities_and_torques_of_springs_and_motors(arm: Arm) -> None:
    p, n = random_point(arm, 0), arm.n
    q, dq, torques = (out.full().ravel() for out in fjr.Plant(arm.robot).output_function(p.x, p.u))
    np.testing.assert_array_equal(q, p.x[: 2 * n])
    np.testing.assert_allclose(dq, np.concatenate(arm.robot.velocities(p.x)), rtol=1e-12)
    np.testing.assert_allclose(torques, [*arm.K @ (q[n:] - q[:n]), *arm.B_m @ p.u], rtol=1e-12)


@pytest.mark.parametrize("arm", URDF_ARMS, ids=lambda arm: arm.name)
@seeds
def test_plant_satisfies_the_equation_of_motion_of_pinocchio(arm: Arm, seed: int) -> None:
    """dp_l = d/dt (M_l dq_l) with M_l ddq_l = K zeta - C dq_l - D_l dq_l - grad P_l."""
    p = random_point(arm, seed)
    q_l, q_m, p_l, p_m = np.split(p.x, 4)
    dq_l, dq_m = np.linalg.solve(arm.links.M(q_l), p_l), np.linalg.solve(arm.M_m, p_m)
    C, spring = arm.links.C(q_l, dq_l), arm.K @ (q_m - q_l)
    Mddq_l = spring - C @ dq_l - arm.D_l @ dq_l - arm.links.grad_P(q_l)
    dp = np.concatenate([Mddq_l + (C + C.T) @ dq_l, arm.B_m @ p.u - spring - arm.D_m @ dq_m])
    seen = fjr.Plant(arm.robot).derivative(p.x, p.u)
    assert residual(seen[2 * arm.n :], dp) <= TOLERANCE
    assert residual(seen[: 2 * arm.n], np.concatenate([dq_l, dq_m])) <= TOLERANCE


@pytest.mark.parametrize("arm", [*ARMS, *HARD, *URDF_ARMS], ids=lambda arm: arm.name)
@seeds
def test_power_balance(arm: Arm, seed: int) -> None:
    """dH/dt = dq_m' B_m u - dq_l' D_l dq_l - dq_m' D_m dq_m."""
    p = random_point(arm, seed)
    dx = fjr.Plant(arm.robot).derivative(p.x, p.u)
    dq_l, dq_m = dx[: arm.n], dx[arm.n : 2 * arm.n]
    dH = stencil(lambda s: arm.robot.hamiltonian(p.x + s * dx), 1e-3)
    assert residual(dH, dq_m @ arm.B_m @ p.u, -dq_l @ arm.D_l @ dq_l, -dq_m @ arm.D_m @ dq_m) <= TOLERANCE
