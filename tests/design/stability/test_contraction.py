# SPDX-License-Identifier: Apache-2.0
"""The differential form of the closed loop: (10), (43)-(49), and the rate (50)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

import fjr_core as fjr
from core.oracles.cases import (
    HARD,
    LOOPS,
    Arm,
    GainSet,
    Point,
    cubic,
    linear,
    planar,
    random_point,
    random_state,
    single,
)
from core.oracles.chains import arm7, scaled_gains, two_joints
from core.oracles.oracle import inverse, jacobian
from core.oracles.properties import (
    TOLERANCE,
    block_diagonal,
    closed_form,
    coordinate_steps,
    generator,
    loop_of,
    metric,
    metric_residual,
    on_reference,
    structure_as_printed,
    sym,
)

STRAIGHT = [(arm, gains) for arm, gains in LOOPS if gains.name != "linear" and not arm.cubic.any()]
URDF = [(arm, scaled_gains(arm, cubic=True)) for arm in (two_joints(), arm7())]
EXACT = 1e-11  # tolerance for URDF arms, as in law/test_law.py
loops = pytest.mark.parametrize(("arm", "gains"), STRAIGHT, ids=[f"{arm.name}-{gains.name}" for arm, gains in STRAIGHT])
places = pytest.mark.parametrize("place", [(0, True), (2, False)], ids=str)


@pytest.mark.parametrize(("arm", "gains"), [*STRAIGHT, *URDF], ids=lambda each: each.name)
@places
def test_differential_storage_decays_by_the_dissipation(arm: Arm, gains: GainSet, place: tuple[int, bool]) -> None:
    """(P A + A' P + dP)/2 = -diag(sym(Pi_l dphi_l), sym(Pi_m dphi_m), M_l^-1 (D_l + K_ld) M_l^-1, ..)."""
    assert excess(arm, gains, random_point(arm, *place)) <= (EXACT if (arm, gains) in URDF else TOLERANCE)


def excess(arm: Arm, gains: GainSet, p: Point) -> float:
    """Return the residual of the differential storage's rate."""
    loop = loop_of(arm, gains)
    e_l, e_m, *_ = np.split(loop.errors(p.x_v, p.x, p.jets), 4)
    W_l, W_m = inverse(closed_form(loop, p)[0]), inverse(arm.M_m)
    dissipated = block_diagonal(
        sym(gains.Pi_l @ gains.dphi_l(e_l)),
        sym(gains.Pi_m @ gains.dphi_m(e_m)),
        W_l @ (arm.D_l + gains.K_ld) @ W_l,
        W_m @ (arm.D_m + gains.K_md) @ W_m,
    )
    A, (P, dP) = generator(loop, p), metric(loop, p)
    return metric_residual(P, -dissipated, P @ A / 2, A.T @ P / 2, dP / 2)


@pytest.mark.parametrize("arm", HARD, ids=[arm.name for arm in HARD])
def test_hardening_springs_keep_this_decay_where_the_errors_vanish_only(arm: Arm) -> None:
    """The coupling of two solutions is the tangent, that of a solution and the reference the secant."""
    p, x_v = on_reference(arm, linear(arm.n))
    assert excess(arm, linear(arm.n), replace(p, x_v=x_v)) <= 1e-7
    assert excess(arm, linear(arm.n), p) > 1e-3


def structure(arm: Arm, gains: GainSet, p: Point, coupling: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return J_v and R_v with the skew part of the printed R_v in J_v: S_H of E_l = S_H - dM_l/2, as in eq. (26)."""
    J_v, R_v = structure_as_printed(arm, gains, p, coupling)
    return J_v - (R_v - R_v.T) / 2, sym(R_v)


def structure_residual(arm: Arm, gains: GainSet, p: Point, coupling: np.ndarray) -> float:
    """Return the residual of A = (J_v - R_v) P, eq. (44), in metric coordinates."""
    loop, (J_v, R_v) = loop_of(arm, gains), structure(arm, gains, p, coupling)
    P = metric(loop, p)[0]
    return metric_residual(P, P @ generator(loop, p), P @ J_v @ P, -P @ R_v @ P)


@loops
@places
def test_variational_error_dynamics_have_the_skew_structure(arm: Arm, gains: GainSet, place: tuple[int, bool]) -> None:
    """Equation (44), and (49) with K Pi_m^-1."""
    coupling = arm.K @ inverse(gains.Pi_m)
    assert structure_residual(arm, gains, random_point(arm, *place), coupling) <= TOLERANCE


@loops
def test_interconnection_as_printed_differs_from_that_of_the_loop(arm: Arm, gains: GainSet) -> None:
    """The printed K Pi_m in (49) is as skew as the correct term, so only the Jacobian reveals it."""
    assert structure_residual(arm, gains, random_point(arm, 2), arm.K @ gains.Pi_m) > 1e-3


@loops
@places
def test_skew_part_of_the_link_damping_belongs_to_the_interconnection(
    arm: Arm, gains: GainSet, place: tuple[int, bool]
) -> None:
    """(44): J_v is skew and R_v symmetric with S_H = (C - C')/2 in J_v and D_l + K_ld - dM_l/2 in R_v."""
    p = random_point(arm, *place)
    J_v, R_v = structure(arm, gains, p, arm.K @ inverse(gains.Pi_m))
    assert np.array_equal(J_v, -J_v.T)
    assert np.array_equal(R_v, R_v.T)
    sigma_l, C = slice(2 * arm.n, 3 * arm.n), closed_form(loop_of(arm, gains), p)[1]
    np.testing.assert_allclose(J_v[sigma_l, sigma_l], -(C - C.T) / 2, atol=1e-12)
    np.testing.assert_allclose(R_v[sigma_l, sigma_l], arm.D_l + gains.K_ld - (C + C.T) / 2, atol=1e-12)


@loops
@places
def test_loop_is_the_feedback_of_its_link_and_motor_parts(arm: Arm, gains: GainSet, place: tuple[int, bool]) -> None:
    """(45) with V_l (46) and (47) with V_m (48), connected by (49) with K Pi_m^-1."""
    loop, p, n = loop_of(arm, gains), random_point(arm, *place), arm.n
    e_l, e_m, *_ = np.split(loop.errors(p.x_v, p.x, p.jets), 4)
    P, zero, one = metric(loop, p)[0], np.zeros((n, n)), np.eye(n)
    link = [[-gains.dphi_l(e_l) @ inverse(gains.Pi_l), one], [-one, -closed_form(loop, p)[2] - arm.D_l - gains.K_ld]]
    motor = [[-gains.dphi_m(e_m) @ inverse(gains.Pi_m), one], [-one, -arm.D_m - gains.K_md]]
    coupling = arm.K @ inverse(gains.Pi_m)
    to_link, to_motor = [[zero, zero], [coupling, zero]], [[zero, -coupling.T], [zero, zero]]
    parts = np.block([[np.block(link), np.block(to_link)], [np.block(to_motor), np.block(motor)]])
    order = np.arange(4 * n).reshape(4, n)[[0, 2, 1, 3]].ravel()  # (q_l, q_m, sigma_l, sigma_m) -> link, motor
    P_parts = P[np.ix_(order, order)]
    A = generator(loop, p)[np.ix_(order, order)]
    assert metric_residual(P_parts, P_parts @ A, P_parts @ parts @ P_parts) <= TOLERANCE


@loops
@places
def test_external_input_and_its_output_are_a_passive_pair(arm: Arm, gains: GainSet, place: tuple[int, bool]) -> None:
    """(10), (44): omega enters d sigma_m alone, Psi = (0, 0, 0, I); output Psi' P delta_e = M_m^-1 delta sigma_m."""
    loop, p, n = loop_of(arm, gains), random_point(arm, *place), arm.n
    Theta = jacobian(lambda y: loop.errors(y, p.x, p.jets), p.x_v, coordinate_steps(loop, p))
    rest = loop.field(p.x_v, replace(p, omega=np.zeros(n)))
    moved = [loop.field(p.x_v, replace(p, omega=e)) - rest for e in np.eye(n)]
    Psi = np.vstack([np.zeros((3 * n, n)), np.eye(n)])
    np.testing.assert_allclose(Theta @ np.transpose(moved), Psi, atol=1e-9)
    np.testing.assert_allclose(Psi.T @ metric(loop, p)[0], np.hstack([np.zeros((n, 3 * n)), inverse(arm.M_m)]))


@pytest.mark.parametrize(("inertia", "beta"), [(0.004, 10.0), (0.031, 0.307 / 0.031), (0.5, 0.307 / 0.5)])
def test_rates_of_table_1(inertia: float, beta: float) -> None:
    """With the motor of the paper, and with heavier ones: lambda_min(M^-1) of eq. (50) is over links and motors."""
    rate = fjr.TrackingLaw(fjr.single_link(motor_inertia=inertia), fjr.PAPER_GAINS).rate()
    assert rate.beta == pytest.approx(beta, rel=1e-12)
    assert rate.beta_paper == pytest.approx(0.307 / max(inertia, 0.031), rel=1e-12)
    assert rate.proven


def sampled_rates(arm: Arm, gains: GainSet, configurations: np.ndarray) -> tuple[float, float]:
    """Return the blockwise beta and beta of eq. (50), minima over the configurations."""
    position = min(eigh(sym(g[0] @ g[1]), g[0], eigvals_only=True)[0] for g in position_gains(gains))
    D_l, D_m = arm.D_l + gains.K_ld, arm.D_m + gains.K_md
    inertias = [arm.links.M(q) for q in configurations]
    motor = eigh(D_m, arm.M_m, eigvals_only=True)[0]
    block_wise = min(motor, *(eigh(D_l, M, eigvals_only=True)[0] for M in inertias))
    damping = min(np.linalg.eigvalsh(D_l)[0], np.linalg.eigvalsh(D_m)[0])
    mobility = min(1 / np.linalg.eigvalsh(M)[-1] for M in (*inertias, arm.M_m))
    return min(position, block_wise), min(position, damping * mobility)


def position_gains(gains: GainSet) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    return (gains.Pi_l, gains.Lambda_l), (gains.Pi_m, gains.Lambda_m)


@loops
def test_rates_block_by_block_and_of_eq_50(arm: Arm, gains: GainSet) -> None:
    law = loop_of(arm, gains).law
    grid = np.stack([np.zeros(61), np.linspace(-np.pi, np.pi, 61)], axis=1)[:, -arm.n :]
    beta, beta_paper = sampled_rates(arm, gains, grid)
    sampled = law.rate(grid)
    assert (sampled.beta, sampled.beta_paper) == (pytest.approx(beta), pytest.approx(beta_paper))
    assert not sampled.proven
    proven = law.rate()
    assert proven.proven
    assert proven.beta <= beta * (1 + 1e-12)
    assert proven.beta_paper <= beta_paper * (1 + 1e-12)
    assert proven.beta_paper <= proven.beta * (1 + 1e-12)


@loops
def test_differential_storage_decays_at_least_at_the_rate(arm: Arm, gains: GainSet) -> None:
    """The slowest decay of the variation in the metric is at least beta at any point."""
    beta = loop_of(arm, gains).law.rate().beta
    for seed in range(4):
        loop, p = loop_of(arm, gains), random_point(arm, seed)
        A, (P, dP) = generator(loop, p), metric(loop, p)
        assert eigh(-sym(P @ A + dP / 2), P, eigvals_only=True)[0] >= beta * (1 - 1e-9)


@pytest.mark.parametrize(
    ("arm", "gains"),
    [(single(3.1), cubic(1)), (planar("31", 31.0), linear(2))],
    ids=["k = 3.1, cubic", "two links"],
)
def test_virtual_solutions_contract_at_rate_beta_along_any_curve(arm: Arm, gains: GainSet) -> None:
    """The storage of the difference of two virtual solutions decays along any x(t), here driven by an unrelated u."""
    loop, reference = loop_of(arm, gains), fjr.Sine(np.full(arm.n, 0.8), 1.3)
    beta, duration = loop.law.rate().beta, 0.5

    def field(t: float, z: np.ndarray) -> np.ndarray:
        x, *virtual = np.split(z, 3)
        jets = reference.jets(t)
        moves = [loop.virtual.derivative(y, x, loop.law.effort(y, x, jets)) for y in virtual]
        return np.concatenate([loop.plant.derivative(x, np.full(arm.n, 0.6 * np.sin(4 * t))), *moves])

    def storage(t: float, z: np.ndarray) -> float:
        x, one, other = np.split(z, 3)
        difference = loop.errors(one, x, reference.jets(t)) - loop.errors(other, x, reference.jets(t))
        P = block_diagonal(gains.Pi_l, gains.Pi_m, inverse(arm.links.M(x[: arm.n])), inverse(arm.M_m))
        return float(difference @ P @ difference)

    rng = np.random.default_rng(10)
    start = np.concatenate([random_state(arm, rng, 0.5) for _ in range(3)])
    run = solve_ivp(field, (0, duration), start, method="DOP853", rtol=1e-10, atol=1e-12, dense_output=True)
    times = np.linspace(0, duration, 51)
    seen = np.array([storage(t, run.sol(t)) for t in times])
    assert np.all(seen <= seen[0] * np.exp(-2 * beta * times) * (1 + 1e-6))
