# SPDX-License-Identifier: Apache-2.0
"""Exact identities of the closed loop on URDF arms with two and seven joints, with the matrices of Pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import PLANAR, Arm, Array, Point
from core.oracles.chains import arm7, scaled_gains, urdf_arm
from core.oracles.oracle import stencil
from core.oracles.properties import (
    Loop,
    block_diagonal,
    error_dynamics,
    generator,
    metric,
    metric_residual,
    residual,
    storage_rate,
    storage_terms,
    sym,
)

TOLERANCE = 1e-11
"""Residuals are relative to the largest torques of the arm; this bound checks the terms of the wrist to six digits."""


@cache
def two_joints() -> Arm:
    """Return a two-link arm with skew axes, gravity and full elastic matrices."""
    m, c, inertia = PLANAR["link_mass"], PLANAR["link_com"], PLANAR["link_inertia"]
    links = "".join(
        f'<link name="link{i}"><inertial><origin xyz="0.02 0.01 {-c[i]}"/><mass value="{m[i]}"/>'
        f'<inertia ixx="0.01" ixy="0" ixz="0" iyy="{inertia[i]}" iyz="0" izz="0.006"/></inertial></link>'
        for i in (0, 1)
    )
    joints = "".join(
        f'<joint name="joint{i}" type="revolute"><parent link="{parent}"/><child link="link{i}"/>'
        f'<origin xyz="0 0 {z}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        for i, parent, z, axis in ((0, "base", 0, "0 1 0"), (1, "link0", -0.3, "0.6 0.8 0"))
    )
    return urdf_arm(
        "two",
        f'<robot name="two"><link name="base"/>{links}{joints}</robot>',
        ("joint1", "joint0"),
        stiffness=np.array([[30.0, 4.0], [4.0, 20.0]]),
        motor_inertia=np.array([[0.02, 0.003], [0.003, 0.01]]),
        link_damping=np.array([[0.2, 0.05], [0.05, 0.1]]),
        motor_damping=np.array([[0.02, -0.004], [-0.004, 0.01]]),
        input_gain=np.array([[1.2, 0.1], [-0.2, 0.8]]),
    )


ARMS = (two_joints, arm7)
arms = pytest.mark.parametrize("make", ARMS, ids=lambda make: make.__name__)
loops = pytest.mark.parametrize(
    ("make", "cubic"),
    [(make, cubic) for make in ARMS for cubic in (False, True)],
    ids=[f"{make.__name__}-{kind}" for make in ARMS for kind in ("linear", "cubic")],
)
seeds = pytest.mark.parametrize("seed", range(3))
PLACES = [(seed, same, pushed) for seed in range(3) for same in (True, False) for pushed in (True, False)]
places = pytest.mark.parametrize(
    "place", PLACES, ids=[f"{s}-{'same' if a else 'apart'}-{'omega' if b else 'free'}" for s, a, b in PLACES]
)


def state(arm: Arm, rng: np.random.Generator) -> Array:
    """Return a state with positions and velocities of order one and spring torques up to 10 N m."""
    q_l, dq_l, dq_m = rng.uniform(-1.5, 1.5, (3, arm.n))
    q_m = q_l + np.linalg.solve(arm.K, rng.uniform(-10, 10, arm.n))
    return np.concatenate([q_l, q_m, arm.links.M(q_l) @ dq_l, arm.M_m @ dq_m])


def point(arm: Arm, seed: int, same: bool, pushed: bool) -> Point:
    rng = np.random.default_rng(seed)
    x, x_v = state(arm, rng), state(arm, rng)
    jets = rng.uniform(-1, 1, (6, arm.n))
    omega, u = rng.uniform(-5, 5, (2, arm.n))
    return Point(x.copy() if same else x_v, x, jets[:5], jets[1:], omega if pushed else 0 * omega, u)


@cache
def loop(make: Callable[[], Arm], cubic: bool) -> Loop:
    return Loop(make(), gains := scaled_gains(make(), cubic=cubic), fjr.TrackingLaw(make().robot, gains.gains))


@arms
@seeds
def test_plant_satisfies_the_equation_of_motion_of_pinocchio(make: Callable[[], Arm], seed: int) -> None:
    """dp_l = d/dt (M_l dq_l) with M_l ddq_l = K zeta - C dq_l - D_l dq_l - grad P_l."""
    arm = make()
    p = point(arm, seed, same=True, pushed=False)
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
    p = point(arm, seed, same=True, pushed=False)
    dx = fjr.Plant(arm.robot).derivative(p.x, p.u)
    dq_l, dq_m = dx[: arm.n], dx[arm.n : 2 * arm.n]
    dH = stencil(lambda s: arm.robot.hamiltonian(p.x + s * dx), 1e-3)
    assert residual(dH, dq_m @ arm.B_m @ p.u, -dq_l @ arm.D_l @ dq_l, -dq_m @ arm.D_m @ dq_m) <= TOLERANCE


@arms
@seeds
def test_virtual_system_equals_the_plant_on_the_diagonal(make: Callable[[], Arm], seed: int) -> None:
    arm = make()
    p = point(arm, seed, same=True, pushed=False)
    virtual = fjr.VirtualSystem(arm.robot).derivative(p.x, p.x, p.u)
    assert residual(virtual, fjr.Plant(arm.robot).derivative(p.x, p.u)) <= 1e-13


@loops
@places
def test_the_four_error_equations(make: Callable[[], Arm], cubic: bool, place: tuple[int, bool, bool]) -> None:
    residuals = error_dynamics(loop(make, cubic), point(make(), *place))
    assert max(residuals.values()) <= TOLERANCE, residuals


@loops
@places
def test_exact_rate_of_the_storage(make: Callable[[], Arm], cubic: bool, place: tuple[int, bool, bool]) -> None:
    assert storage_rate(loop(make, cubic), point(make(), *place)) <= TOLERANCE


@loops
@places
def test_dissipation_and_dV_are_the_terms_of_the_exact_rate(
    make: Callable[[], Arm], cubic: bool, place: tuple[int, bool, bool]
) -> None:
    p = point(make(), *place)
    *lost, supplied = storage_terms(loop(make, cubic), p)
    e = loop(make, cubic).law.evaluate(p.x_v, p.x, p.jets, p.omega)
    assert residual(e.dissipation, *(-term for term in lost)) <= TOLERANCE
    assert residual(e.dV, *lost, supplied) <= TOLERANCE


@loops
def test_storage_decays_at_least_at_rate_beta(make: Callable[[], Arm], cubic: bool) -> None:
    """dV <= -2 beta V for omega = 0, beta at the measured configuration."""
    for seed in range(20):
        p = point(make(), seed, same=seed % 2 == 0, pushed=False)
        law = loop(make, cubic).law
        e = law.evaluate(p.x_v, p.x, p.jets)
        assert e.V > 0
        assert e.dV <= -2 * law.rate(p.x[None, : make().n]).beta * e.V * (1 - 1e-10)


@loops
@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_differential_storage_decays_by_the_dissipation(make: Callable[[], Arm], cubic: bool, same: bool) -> None:
    """(P A + A' P + dP)/2 = -diag(sym(Pi_l dphi_l), sym(Pi_m dphi_m), M_l^-1 (D_l + K_ld) M_l^-1, ..)."""
    closed, arm, gains = loop(make, cubic), make(), loop(make, cubic).gains
    p = point(arm, 0, same, pushed=True)
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


def test_identities_detect_a_relative_error_of_1e_6() -> None:
    """A relative error of 1e-6 in the damping of the wrist breaks the identities by more than the tolerance."""
    right = loop(arm7, False)
    wrong = replace(right.gains, K_ld=right.gains.K_ld * (1 + 1e-6 * (np.arange(7) == 6)))
    p = point(arm7(), 0, same=True, pushed=False)
    assert error_dynamics(replace(right, gains=wrong), p)["sigma_l"] > 10 * TOLERANCE
    assert storage_rate(replace(right, gains=wrong), p) > 10 * TOLERANCE
