# SPDX-License-Identifier: Apache-2.0
"""Plant and differential storage of URDF arms with two and seven joints, with the matrices of Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import Arm
from core.oracles.chains import arm7, chain_point, scaled_gains, two_joints
from core.oracles.oracle import stencil
from core.oracles.properties import Loop, block_diagonal, generator, metric, metric_residual, residual, sym

TOLERANCE = 1e-11
"""Residuals are relative to the largest torques of the arm; this bound checks the terms of the wrist to six digits."""
ARMS = (two_joints, arm7)
arms = pytest.mark.parametrize("make", ARMS, ids=lambda make: make.__name__)
loops = pytest.mark.parametrize(
    ("make", "cubic"),
    [(make, cubic) for make in ARMS for cubic in (False, True)],
    ids=[f"{make.__name__}-{kind}" for make in ARMS for kind in ("linear", "cubic")],
)
seeds = pytest.mark.parametrize("seed", range(3))


@cache
def loop(make: Callable[[], Arm], cubic: bool) -> Loop:
    return Loop(make(), gains := scaled_gains(make(), cubic=cubic), fjr.TrackingLaw(make().robot, gains.gains))


@arms
@seeds
def test_plant_satisfies_the_equation_of_motion_of_pinocchio(make: Callable[[], Arm], seed: int) -> None:
    """dp_l = d/dt (M_l dq_l) with M_l ddq_l = K zeta - C dq_l - D_l dq_l - grad P_l."""
    arm = make()
    p = chain_point(arm, seed, same=True, pushed=False)
    q_l, q_m, p_l, p_m = np.split(p.x, 4)
    M, M_m = arm.links.M(q_l), arm.M_m
    dq_l, dq_m = np.linalg.solve(M, p_l), np.linalg.solve(M_m, p_m)
    C, spring = arm.links.C(q_l, dq_l), arm.K @ (q_m - q_l)
    Mddq_l = spring - C @ dq_l - arm.D_l @ dq_l - arm.links.grad_P(q_l)
    dp = np.concatenate([Mddq_l + (C + C.T) @ dq_l, arm.B_m @ p.u - spring - arm.D_m @ dq_m])
    seen = fjr.Plant(arm.robot).derivative(p.x, p.u)
    assert residual(seen[2 * arm.n :], dp) <= 1e-10
    assert residual(seen[: 2 * arm.n], np.concatenate([dq_l, dq_m])) <= 1e-10


@arms
@seeds
def test_power_balance(make: Callable[[], Arm], seed: int) -> None:
    arm = make()
    p = chain_point(arm, seed, same=True, pushed=False)
    dx = fjr.Plant(arm.robot).derivative(p.x, p.u)
    dq_l, dq_m = dx[: arm.n], dx[arm.n : 2 * arm.n]
    dH = stencil(lambda s: arm.robot.hamiltonian(p.x + s * dx), 1e-3)
    assert residual(dH, dq_m @ arm.B_m @ p.u, -dq_l @ arm.D_l @ dq_l, -dq_m @ arm.D_m @ dq_m) <= TOLERANCE


@arms
@seeds
def test_virtual_system_equals_the_plant_on_the_diagonal(make: Callable[[], Arm], seed: int) -> None:
    arm = make()
    p = chain_point(arm, seed, same=True, pushed=False)
    virtual = fjr.VirtualSystem(arm.robot).derivative(p.x, p.x, p.u)
    assert residual(virtual, fjr.Plant(arm.robot).derivative(p.x, p.u)) <= 1e-13


@loops
@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_differential_storage_decays_by_the_dissipation(make: Callable[[], Arm], cubic: bool, same: bool) -> None:
    """(P A + A' P + dP)/2 = -diag(sym(Pi_l dphi_l), sym(Pi_m dphi_m), M_l^-1 (D_l + K_ld) M_l^-1, ..)."""
    closed, arm, gains = loop(make, cubic), make(), loop(make, cubic).gains
    p = chain_point(arm, 0, same, pushed=True)
    e_l, e_m, *_ = np.split(closed.errors(p.x_v, p.x, p.jets), 4)
    W_l, W_m = np.linalg.inv(arm.links.M(p.x[: arm.n])), np.linalg.inv(arm.M_m)
    dissipated = block_diagonal(
        sym(gains.Pi_l @ gains.dphi_l(e_l)),
        sym(gains.Pi_m @ gains.dphi_m(e_m)),
        W_l @ (arm.D_l + gains.K_ld) @ W_l,
        W_m @ (arm.D_m + gains.K_md) @ W_m,
    )
    A, (P, dP) = generator(closed, p), metric(closed, p)
    assert metric_residual(P, -dissipated, P @ A / 2, A.T @ P / 2, dP / 2) <= TOLERANCE
