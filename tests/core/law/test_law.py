# SPDX-License-Identifier: Apache-2.0
"""The law u(x_v, x, t): agreement with the literal equations, closed-loop error dynamics and storage.

The identities hold for closed-form arms and, with the matrices of Pinocchio, for URDF arms with two and seven joints.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh

import fjr_core as fjr
from core.oracles.cases import LOOP_NAMES, LOOPS, POINTS, Arm, GainSet, Point, planar, random_point
from core.oracles.chains import arm7, scaled_gains, two_joints
from core.oracles.oracle import LiteralLaw, jacobian
from core.oracles.properties import (
    TOLERANCE,
    Loop,
    error_dynamics,
    loop_of,
    residual,
    storage_rate,
    storage_terms,
)
from fjr_core.law.linearized import equilibria_at, feedback, plant_matrices
from fjr_core.law.rate import rate, rate_from_inertia_bounds

EXACT = 1e-11
"""Tolerance for URDF arms: residuals are relative to the largest torques, so this checks the wrist to six digits."""
URDF_ARMS = {"two_joints": two_joints, "arm7": arm7}
loops = pytest.mark.parametrize(("arm", "gains"), LOOPS, ids=LOOP_NAMES)
all_loops = pytest.mark.parametrize("name", [*LOOP_NAMES, *URDF_ARMS])
points = pytest.mark.parametrize(
    "place", POINTS, ids=lambda p: f"{p[0]}-{'same' if p[1] else 'apart'}-{'omega' if p[2] else 'free'}"
)


@cache
def loop_named(name: str) -> Loop:
    if name in LOOP_NAMES:
        return loop_of(*LOOPS[LOOP_NAMES.index(name)])
    arm = URDF_ARMS[name]()
    return loop_of(arm, scaled_gains(arm, cubic=True))


def at(name: str, *place: Any) -> tuple[Loop, Point, float]:
    """Return a loop by its name, a random point of it and the tolerance of its residuals."""
    loop = loop_named(name)
    return loop, random_point(loop.arm, *place), TOLERANCE if name in LOOP_NAMES else EXACT


def relative(seen: np.ndarray, wanted: np.ndarray) -> float:
    return float(np.max(np.abs(seen - wanted)) / np.max(np.abs(wanted)))


@loops
@pytest.mark.parametrize("same", [True, False], ids=["same", "apart"])
def test_law_matches_80_digit_oracle(arm: Arm, gains: GainSet, same: bool) -> None:
    """The oracle evaluates (30)-(43) in 80 digits; time derivatives are nested differences along the flow."""
    law, p = loop_of(arm, gains).law, random_point(arm, 20, same)
    seen, wanted = (each.evaluate(p.x_v, p.x, p.jets, p.omega) for each in (law, LiteralLaw(arm, gains)))
    for name in ("u", "u_l", "q_md", "q_tilde_l", "sigma_l", "q_tilde_m", "sigma_m", "V"):
        assert relative(np.asarray(getattr(seen, name)), getattr(wanted, name)) <= TOLERANCE, name
    assert relative(law.effort(p.x_v, p.x, p.jets, p.omega), wanted.u) <= TOLERANCE


@all_loops
@points
def test_the_four_error_equations(name: str, place: tuple[int, bool, bool]) -> None:
    loop, p, tolerance = at(name, *place)
    residuals = error_dynamics(loop, p)
    assert max(residuals.values()) <= tolerance, residuals


@all_loops
@points
def test_exact_rate_of_the_storage(name: str, place: tuple[int, bool, bool]) -> None:
    loop, p, tolerance = at(name, *place)
    assert storage_rate(loop, p) <= tolerance


@all_loops
@points
def test_dissipation_and_dV_are_the_terms_of_the_exact_rate(name: str, place: tuple[int, bool, bool]) -> None:
    loop, p, tolerance = at(name, *place)
    *lost, supplied = storage_terms(loop, p)
    e = loop.law.evaluate(p.x_v, p.x, p.jets, p.omega)
    exact = 1e-13 if tolerance == TOLERANCE else tolerance
    assert residual(e.dissipation, *(-term for term in lost)) <= exact
    assert residual(e.dV, *lost, supplied) <= exact


@all_loops
def test_storage_is_positive_and_decays_at_least_at_rate_beta(name: str) -> None:
    """V > 0 and dV <= -2 beta V for omega = 0; beta of a URDF arm is that of the measured configuration."""
    for seed in range(20):
        loop, p, _ = at(name, seed, seed % 2 == 0)
        n, law = loop.arm.n, loop.law
        beta = law.rate(None if name in LOOP_NAMES else p.x[None, :n]).beta
        e = law.evaluate(p.x_v, p.x, p.jets)
        assert e.V > 0
        assert e.dV <= -2 * beta * e.V * (1 - (1e-12 if name in LOOP_NAMES else 1e-10))


def test_law_is_a_pure_function_of_arrays_or_lists() -> None:
    arm = planar("31", 31.0)
    law, (p, other) = fjr.TrackingLaw(arm.robot, fjr.PAPER_GAINS), (random_point(arm, seed) for seed in (1, 2))
    inputs = [p.x_v.copy(), p.x.copy(), p.jets.copy()]
    first = law.effort(*inputs)
    kept = first.copy()
    law.effort(other.x_v, other.x, other.jets)
    assert np.array_equal(law.effort(*inputs), kept)
    assert np.array_equal(first, kept)
    assert all(np.array_equal(a, b) for a, b in zip(inputs, (p.x_v, p.x, p.jets), strict=True))
    assert np.array_equal(law.effort(p.x_v.tolist(), np.repeat(p.x, 2)[::2], np.asfortranarray(p.jets)), kept)
    assert np.array_equal(law.effort(*inputs, 1.5), law.effort(*inputs, np.full(arm.n, 1.5)))


# The law of measured velocities with symbolic gains, which may change while it runs.
SOFT = planar("soft", (40.0, 25.0))
COUPLED = np.array([[3.0, 0.5], [0.5, 2.0]])
DIAGONAL = fjr.Gains(10.0, 20.0, 0.6, 15.0, 60.0, 0.3)
OTHER = fjr.Gains([8.0, 9.0], [16.0, 30.0], 0.4, 12.0, [40.0, 50.0], 0.2, Gamma_l=1.5, Gamma_m=[0.0, 2.0])


def measured(law: fjr.TrackingLaw, x: np.ndarray, jets: np.ndarray) -> tuple[np.ndarray, float]:
    velocity = np.concatenate(law.robot.velocities(x))
    return law.measured_command(x[: 2 * law.robot.n], velocity, jets)


@loops
def test_equals_the_law_and_its_storage_on_the_diagonal(arm: Arm, gains: GainSet) -> None:
    law = loop_of(arm, gains).law
    for seed in range(5):
        p = random_point(arm, seed, True)
        (u, V), e = measured(law, p.x, p.jets), law.evaluate(p.x, p.x, p.jets)
        np.testing.assert_allclose(u, e.u, rtol=1e-10, atol=1e-10 * np.max(np.abs(e.u)))
        assert pytest.approx(e.V, rel=1e-10) == V


COUPLED_GAINS = fjr.Gains(10.0, 10 * COUPLED, COUPLED, 15.0, 20 * COUPLED, 0.1 * COUPLED)


@pytest.mark.parametrize(("first", "then"), [(DIAGONAL, OTHER), (COUPLED_GAINS, DIAGONAL)], ids=["values", "diagonal"])
def test_changed_gains_give_the_law_built_with_them_from_the_same_function(first: fjr.Gains, then: fjr.Gains) -> None:
    law = fjr.TrackingLaw(SOFT.robot, first)
    other, wanted = law.with_gains(then), fjr.TrackingLaw(SOFT.robot, then)
    assert other.function is law.function
    p = random_point(SOFT, 3, True)
    (u, V), (wanted_u, wanted_V) = (measured(each, p.x, p.jets) for each in (other, wanted))
    np.testing.assert_allclose(u, wanted_u, rtol=1e-10)
    assert pytest.approx(wanted_V, rel=1e-10) == V
    again = fjr.TrackingLaw(SOFT.robot, replace(wanted.gains, Lambda_l=5.0))  # checked gains are checked again
    assert again.gains.beta_l == pytest.approx(5.0)


def test_law_built_for_diagonal_gains_refuses_matrices_and_every_law_refuses_invalid_gains() -> None:
    law = fjr.TrackingLaw(SOFT.robot, DIAGONAL)
    with pytest.raises(fjr.GainsError, match="K_ld has entries off the diagonal; expected a diagonal matrix"):
        law.with_gains(fjr.Gains(10.0, 20.0, COUPLED, 15.0, 60.0, 0.3))
    with pytest.raises(fjr.GainsError, match="K_ld"):
        law.with_gains(fjr.Gains(10.0, 20.0, -0.6, 15.0, 60.0, 0.3))


@pytest.mark.parametrize("others", [1.0, 1e3], ids=["damping of the links", "position gains"])
def test_rates_from_bounds_of_a_constant_inertia_are_those_at_its_vertex(others: float) -> None:
    """A proof bounds M_l relative to the damping; it may lose ROUNDING of the rate, and claims no more."""
    robot, damping = fjr.single_link(), 0.1
    gains = replace(fjr.PAPER_GAINS, Lambda_l=10.0 / others, K_ld=damping).checked(1)
    exact, M = rate(robot, gains), float(robot.M_l([0.0])[0, 0])
    bound = M / (float(robot.D_l[0, 0]) + damping)
    found = rate_from_inertia_bounds(robot, gains, bound, bound, M)
    assert found.beta_sigma_l == pytest.approx(exact.beta_sigma_l, rel=1e-8)
    assert found.beta <= found.attained == pytest.approx(exact.beta, rel=1e-8)
    assert found.beta_paper == pytest.approx(exact.beta_paper, rel=1e-8)
    assert found.proven


def test_rates_of_the_position_errors_are_those_of_conditions_32_and_41() -> None:
    """The least eigenvalue of sym(Pi Lambda) relative to Pi, for matrices that do not commute."""
    rng, given = np.random.default_rng(4), {"K_ld": 1.0, "K_md": 1.0}
    for side in "lm":
        root = rng.normal(size=(3, 3))
        given |= {f"Pi_{side}": root @ root.T + np.eye(3), f"Lambda_{side}": 9 * np.eye(3) + rng.normal(size=(3, 3))}
    gains = fjr.Gains(**given).checked(3)
    for beta, Pi, Lambda in ((gains.beta_l, gains.Pi_l, gains.Lambda_l), (gains.beta_m, gains.Pi_m, gains.Lambda_m)):
        assert beta == pytest.approx(eigh((Pi @ Lambda + Lambda.T @ Pi) / 2, Pi, eigvals_only=True)[0], rel=1e-12)


def test_linearised_plant_and_law_of_an_arm_with_full_matrices_are_derivatives_at_rest() -> None:
    """Central differences about an equilibrium, in units of each coordinate."""
    arm, gains = next((arm, gains) for arm, gains in LOOPS if arm.name == "planar-full")
    law, plant, q_l = loop_of(arm, gains).law, fjr.Plant(arm.robot), np.array([0.9, -0.4])
    points = equilibria_at(arm.robot, q_l[None])
    x, u, jets = points.x[0], points.u[0], np.vstack([q_l, np.zeros((4, 2))])
    steps = np.concatenate([np.full(4, 2e-4), np.diag(points.M_l[0]) * 2e-3, np.diag(arm.M_m) * 2e-3])
    A, B = (each[0] for each in plant_matrices(points))
    scale = np.outer(1 / steps, steps)
    seen = jacobian(lambda y: plant.derivative(y, u), x, steps)
    assert A * scale == pytest.approx(seen * scale, abs=1e-6 * np.max(np.abs(seen * scale)))
    assert plant.derivative(x, u + [1.0, 0.5]) == pytest.approx(B @ [1.0, 0.5], abs=1e-11)
    seen = jacobian(lambda y: law.command(y, jets), x, steps)
    closed = feedback(points, law.gains)[0]
    assert closed * steps == pytest.approx(seen * steps, abs=1e-6 * np.max(np.abs(seen * steps)))
