# SPDX-License-Identifier: Apache-2.0
"""The differential form of the closed loop: (43), (44), (49), and the rate (50)."""

from __future__ import annotations

import numpy as np
import pytest
from cases import LOOP_NAMES, LOOPS, Arm, GainSet, Point, linear, planar, random_point, random_state, single
from oracle import inverse
from properties import (
    TOLERANCE,
    block_diagonal,
    closed_form,
    generator,
    loop_of,
    metric,
    metric_residual,
    sym,
)
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

import fjr_core as fjr

loops = pytest.mark.parametrize(("arm", "gains"), LOOPS, ids=LOOP_NAMES)
places = pytest.mark.parametrize("place", [(0, True), (1, True), (2, False), (3, False)], ids=str)


@loops
@places
def test_differential_storage_decays_by_the_dissipation(arm: Arm, gains: GainSet, place: tuple[int, bool]) -> None:
    """(P A + A' P + dP)/2 = -diag(sym(Pi_l dphi_l), sym(Pi_m dphi_m), M_l^-1 (D_l + K_ld) M_l^-1, ..)."""
    loop, p = loop_of(arm, gains), random_point(arm, *place)
    e_l, e_m, *_ = np.split(loop.errors(p.x_v, p.x, p.jets), 4)
    W_l, W_m = inverse(closed_form(loop, p)[0]), inverse(arm.M_m)
    dissipated = block_diagonal(
        sym(gains.Pi_l @ gains.dphi_l(e_l)),
        sym(gains.Pi_m @ gains.dphi_m(e_m)),
        W_l @ (arm.D_l + gains.K_ld) @ W_l,
        W_m @ (arm.D_m + gains.K_md) @ W_m,
    )
    A, (P, dP) = generator(loop, p), metric(loop, p)
    assert metric_residual(P, -dissipated, P @ A / 2, A.T @ P / 2, dP / 2) <= TOLERANCE


def interconnection(arm: Arm, gains: GainSet, coupling: np.ndarray) -> np.ndarray:
    """J_v of eq. (44) with the blocks of eq. (49): `coupling` and minus its transpose."""
    zero, one = np.zeros((arm.n, arm.n)), np.eye(arm.n)
    return np.block([
        [zero, zero, one, zero],
        [zero, zero, -coupling.T, one],
        [-one, coupling, zero, zero],
        [zero, -one, zero, zero],
    ])  # fmt: skip


def structure_residual(arm: Arm, gains: GainSet, p: Point, coupling: np.ndarray) -> float:
    """A = (J_v - R_v) P, eq. (44), in metric coordinates."""
    loop = loop_of(arm, gains)
    e_l, e_m, *_ = np.split(loop.errors(p.x_v, p.x, p.jets), 4)
    P, E = metric(loop, p)[0], closed_form(loop, p)[2]
    R_v = block_diagonal(
        gains.dphi_l(e_l) @ inverse(gains.Pi_l),
        gains.dphi_m(e_m) @ inverse(gains.Pi_m),
        E + arm.D_l + gains.K_ld,
        arm.D_m + gains.K_md,
    )
    J_v = interconnection(arm, gains, coupling)
    assert np.array_equal(J_v, -J_v.T)
    return metric_residual(P, P @ generator(loop, p), P @ J_v @ P, -P @ R_v @ P)


@loops
@places
def test_variational_error_dynamics_have_the_skew_structure(arm: Arm, gains: GainSet, place: tuple[int, bool]) -> None:
    """(44), and (49) with K Pi_m^-1."""
    coupling = arm.K @ inverse(gains.Pi_m)
    assert structure_residual(arm, gains, random_point(arm, *place), coupling) <= TOLERANCE


@loops
def test_interconnection_as_printed_is_not_that_of_the_loop(arm: Arm, gains: GainSet) -> None:
    """(49) prints K Pi_m; it is as skew as the right one, so only the Jacobian tells."""
    assert structure_residual(arm, gains, random_point(arm, 2), arm.K @ gains.Pi_m) > 1e-3


def test_rates_of_table_1() -> None:
    rate = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS).rate()
    assert rate.beta == pytest.approx(10, rel=1e-12)
    assert rate.beta_paper == pytest.approx(0.307 / 0.031, rel=1e-12)
    assert rate.proven


@pytest.mark.parametrize(("inertia", "beta"), [(0.031, 10.0), (0.5, 0.307 / 0.5)])
def test_the_heavier_side_sets_the_mixed_rate(inertia: float, beta: float) -> None:
    """lambda_min(M^-1) of eq. (50) is taken over links and motors."""
    rate = fjr.TrackingLaw(fjr.single_link(motor_inertia=inertia), fjr.PAPER_GAINS).rate()
    assert rate.beta_paper == pytest.approx(0.307 / max(inertia, 0.031), rel=1e-12)
    assert rate.beta == pytest.approx(min(beta, 0.307 / inertia), rel=1e-12)


def sampled_rates(arm: Arm, gains: GainSet, configurations: np.ndarray) -> tuple[float, float]:
    """beta block by block and beta of eq. (50), least over the configurations."""
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
def test_rate_is_what_the_differential_storage_decays_with(arm: Arm, gains: GainSet) -> None:
    """The least decay of the variation in the metric is at least beta, at any point."""
    beta = loop_of(arm, gains).law.rate().beta
    for seed in range(4):
        loop, p = loop_of(arm, gains), random_point(arm, seed)
        A, (P, dP) = generator(loop, p), metric(loop, p)
        assert eigh(-sym(P @ A + dP / 2), P, eigvals_only=True)[0] >= beta * (1 - 1e-9)


@pytest.mark.parametrize("arm", [single(31.0), planar("31", 31.0)], ids=lambda arm: arm.name)
def test_virtual_solutions_contract_at_rate_beta_along_any_curve(arm: Arm) -> None:
    """Two virtual solutions along an x(t) driven by an unrelated u: the storage of their gap decays."""
    gains = linear(arm.n)
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
