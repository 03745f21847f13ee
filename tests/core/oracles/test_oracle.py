# SPDX-License-Identifier: Apache-2.0
"""The oracles agree with closed forms and are self-consistent."""

from __future__ import annotations

import numpy as np
import pytest

from core.oracles import oracle
from core.oracles.cases import ARMS, LOOPS, Arm, GainSet, linear, random_point, random_state
from core.oracles.oracle import LiteralLaw, LiteralPlant, exact, jacobian, mp, stencil


def test_stencil_has_order_ten() -> None:
    errors = [abs(stencil(lambda s: np.sin(s + 1), h) - np.cos(1)) for h in (0.6, 0.3)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(10, abs=0.2)


def test_jacobian_of_a_map() -> None:
    x = np.array([0.3, -1.2])
    seen = jacobian(lambda y: np.array([np.sin(y[0]) * y[1], y[1] ** 3, y[0]]), x, np.full(2, 0.05))
    assert seen == pytest.approx(np.array([[np.cos(0.3) * -1.2, np.sin(0.3)], [0, 3 * 1.44], [1, 0]]), abs=1e-12)


def numerical_christoffel(arm: Arm, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Return C_ij = sum_k (dM_ij/dq_k + dM_ik/dq_j - dM_jk/dq_i) v_k / 2."""
    dM = jacobian(lambda y: arm.links.M(y).ravel(), q, np.full(arm.n, 0.05)).reshape(arm.n, arm.n, arm.n)
    return np.einsum("ijk,k->ij", dM + dM.swapaxes(1, 2) - dM.transpose(2, 1, 0), v) / 2


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_hand_written_arms_are_consistent(arm: Arm) -> None:
    rng = np.random.default_rng(5)
    q, v = rng.uniform(-2, 2, (2, arm.n))
    assert arm.links.C(q, v) == pytest.approx(numerical_christoffel(arm, q, v), abs=1e-12)
    gradient = jacobian(lambda y: np.array([arm.links.P(y)]), q, np.full(arm.n, 0.05))[0]
    assert arm.links.grad_P(q) == pytest.approx(gradient, rel=1e-12)


@pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
def test_literal_plant_equals_the_literal_virtual_system_on_the_diagonal(arm: Arm) -> None:
    plant, x = LiteralPlant(arm), exact(random_state(arm, np.random.default_rng(6)))
    u = exact(np.arange(1, arm.n + 1))
    difference = plant.derivative(x, u) - plant.virtual(x, x, u)
    assert max(abs(d) for d in difference) < mp.mpf(10) ** -20


@pytest.mark.parametrize(("arm", "gains"), LOOPS[-1:], ids=["planar-full-full"])
def test_literal_law_is_independent_of_its_step(arm: Arm, gains: GainSet, monkeypatch: pytest.MonkeyPatch) -> None:
    p = random_point(arm, 7)
    before = LiteralLaw(arm, gains).effort(p.x_v, p.x, p.jets)
    monkeypatch.setattr(oracle, "STEP", oracle.STEP * 1000)
    assert LiteralLaw(arm, gains).effort(p.x_v, p.x, p.jets) == pytest.approx(before, rel=1e-14)


def test_literal_law_at_equilibrium_has_its_closed_form() -> None:
    """At equilibrium on a constant reference, all errors vanish and u balances the gravity torque."""
    arm = ARMS[2]
    q_ld = np.array([0.4, -0.9])
    g = arm.links.grad_P(q_ld)
    x = np.concatenate([q_ld, q_ld + g / 31.0, np.zeros(4)])
    e = LiteralLaw(arm, linear(2)).evaluate(x, x, np.vstack([q_ld, np.zeros((4, 2))]))
    assert e.u == pytest.approx(g, rel=1e-14)
    assert abs(e.V) < 1e-28
