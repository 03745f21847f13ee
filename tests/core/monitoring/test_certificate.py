# SPDX-License-Identifier: Apache-2.0
"""The certificate gives V and H with exact rates under any effort; the oracle differentiates public functions."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fjr_core as fjr
from core.oracles.cases import LOOP_NAMES, LOOPS, Arm, Array, GainSet, planar, random_point
from core.oracles.oracle import jacobian, stencil
from core.oracles.properties import TOLERANCE, loop_of, residual
from fjr_core.monitoring.certificate import Certificate

loops = pytest.mark.parametrize(("arm", "gains"), LOOPS, ids=LOOP_NAMES)


def measured(arm: Arm, x: Array) -> tuple[Array, Array]:
    """Return positions and velocities (2n,), with the closed-form inertia."""
    q_l, q_m, p_l, p_m = np.split(x, 4)
    return np.concatenate([q_l, q_m]), np.concatenate(
        [np.linalg.solve(arm.links.M(q_l), p_l), np.linalg.solve(arm.M_m, p_m)]
    )


def at(balance: Certificate, position: Array, velocity: Array, jets: Array, u: Array | None = None) -> SimpleNamespace:
    """Return the certificate at one instant."""
    series = balance.along(position[None], velocity[None], jets[None], None if u is None else u[None])
    return SimpleNamespace(**{each.name: getattr(series, each.name)[0] for each in fields(series)})


def along_the_plant(arm: Arm, f: object) -> tuple[Array, object]:
    """Return a random point and the rate of f(x, jets) along the plant under the effort of that point."""
    p, plant = random_point(arm, 40), fjr.Plant(arm.robot)
    dx = plant.derivative(p.x, p.u)
    h = 0.006 * arm.grain / max(1.0, float(np.max(np.abs(dx[: 2 * arm.n]))))
    return p, stencil(lambda s: f(p.x + s * dx, p.jets + s * p.djets), h)


@loops
def test_rate_of_V_under_any_effort(arm: Arm, gains: GainSet) -> None:
    """dV/dt = -dissipation + s_m' B_m (u - u_law) for an arbitrary effort u, by default that of the law."""
    law = loop_of(arm, gains).law
    p, wanted = along_the_plant(arm, lambda x, jets: law.evaluate(x, x, jets).V)
    sample = at(Certificate(law), *measured(arm, p.x), p.jets, p.u)
    e = law.evaluate(p.x, p.x, p.jets)
    pushed = np.linalg.solve(arm.M_m, e.sigma_m) @ arm.B_m @ (p.u - e.u)
    assert residual(sample.u_law, e.u) <= 1e-12
    assert pytest.approx(e.V, rel=1e-12) == sample.V
    assert abs(sample.dV - wanted) <= TOLERANCE * (abs(e.dissipation) + abs(pushed))
    assert residual(np.array(sample.dV), np.array(-e.dissipation), np.array(pushed)) <= 1e-12
    assert at(Certificate(law), *measured(arm, p.x), p.jets).dV == pytest.approx(-e.dissipation, rel=1e-10)


@loops
def test_power_balance_of_H(arm: Arm, gains: GainSet) -> None:
    p, wanted = along_the_plant(arm, lambda x, _: arm.robot.hamiltonian(x))
    sample = at(Certificate(loop_of(arm, gains).law), *measured(arm, p.x), p.jets, p.u)
    assert abs(sample.supplied - sample.dissipated - wanted) <= TOLERANCE * (abs(sample.supplied) + sample.dissipated)
    assert pytest.approx(arm.robot.hamiltonian(p.x), rel=1e-12) == sample.H
    assert sample.dissipated > 0


@loops
def test_slope_of_V_is_its_gradient_in_measured_positions_and_velocities(arm: Arm, gains: GainSet) -> None:
    balance, p = Certificate(loop_of(arm, gains).law), random_point(arm, 44)
    n, state = arm.n, np.concatenate(measured(arm, p.x))

    def V(state: Array) -> Array:
        return np.array(at(balance, state[: 2 * n], state[2 * n :], p.jets).V)

    seen = at(balance, state[: 2 * n], state[2 * n :], p.jets).slope
    assert residual(seen, jacobian(V, state, np.full(4 * n, 2e-3 * arm.grain**0.5))) <= 1e-9


@pytest.mark.parametrize("of_the_law", [False, True])
def test_mean_rate_of_V_over_a_step_is_of_third_order(of_the_law: bool) -> None:
    """V(t + h) - V(t) = h held_rate + O(h^3) under an effort held over h, or under that of the law at each instant."""
    arm, p = planar("31", 31.0), random_point(planar("31", 31.0), 47)
    law, plant = fjr.TrackingLaw(arm.robot, fjr.PAPER_GAINS), fjr.Plant(arm.robot)
    jets = np.array([p.jets[0], *np.zeros((4, arm.n))])

    def motion(_: float, x: Array) -> Array:
        return plant.derivative(x, law.evaluate(x, x, jets).u if of_the_law else p.u)

    def error(h: float) -> float:
        after = solve_ivp(motion, (0.0, h), p.x, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
        position, velocity = map(np.array, zip(*(measured(arm, x) for x in (p.x, after)), strict=True))
        u = np.full((2, arm.n), np.nan) if of_the_law else np.tile(p.u, (2, 1))
        series = Certificate(law).along(position, velocity, np.tile(jets, (2, 1, 1)), u)
        return abs(float(series.V[1] - series.V[0] - h * series.held_rate(u)[0]))

    assert error(2e-4) / error(1e-4) == pytest.approx(8.0, rel=0.1)


@pytest.mark.parametrize("k", [0, 1])
def test_zero_instants_and_one_are_allowed_and_have_no_step(k: int) -> None:
    balance = Certificate(fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS))
    series = balance.along(np.zeros((k, 2)), np.zeros((k, 2)), np.zeros((k, 5, 1)))
    assert series.V.shape == (k,)
    assert series.held_rate(np.zeros((k, 1))).shape == (0,)
