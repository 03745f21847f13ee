# SPDX-License-Identifier: Apache-2.0
"""The symbolic recursion agrees with Pinocchio on random chains, and its matrices satisfy their identities."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import PLANAR, Array
from core.oracles.chains import Chain, random_chain

CHAINS = [(n, seed) for n in range(1, 10) for seed in range(4)]
all_chains = pytest.mark.parametrize("chain", [pytest.param(c, id=f"{c[0]}-joints-{c[1]}") for c in CHAINS])


def numbers(chain: Chain, count: int) -> Array:
    return np.random.default_rng(chain.n).uniform(-2, 2, (count, chain.n))


def value(result: ca.DM) -> Array:
    array = result.full()
    return array.ravel() if array.shape[1] == 1 and array.shape[0] > 1 else array


def relative(left: Array, right: Array, scale: float = 0.0) -> float:
    """Return the largest difference relative to the largest entry, or to `scale` if that is larger."""
    left, right = np.asarray(left).reshape(np.shape(right)), np.asarray(right)
    return float(np.max(np.abs(left - right)) / max(np.max(np.abs(right)), scale, 1e-3))


def columns(product: Any, n: int) -> Array:
    """Return the matrix of a product that is linear in w."""
    return np.column_stack([product(e).full().ravel() for e in np.eye(n)])


@all_chains
def test_the_recursions_agree_with_pinocchio(chain: tuple[int, int]) -> None:
    """Inertia, Coriolis product, inertial torque, gravity, potential, kinetic gradient and workless forces."""
    c = random_chain(*chain)
    links, oracle, (q, other, v, w, a) = c.links, c.pinocchio, numbers(c, 5)
    M, C = oracle.M(q), oracle.C(q, v)
    found = links.M_l(q).full()
    assert np.array_equal(found, found.T)
    assert relative(found, M) < 1e-10
    assert relative(links.C(q, v, w), C @ w) < 1e-10
    assert relative(links.inertial_torque(q, v, w, a), M @ a + C @ w) < 1e-10
    assert relative(links.grad_P_l(q), oracle.grad_P(q)) < 1e-10
    here, there = oracle.P(q), oracle.P(other)
    assert relative(links.P_l(q) - links.P_l(other), np.array([[here - there]]), abs(here)) < 1e-10
    assert relative(links.grad_T(q, v), C.T @ v) < 1e-10
    symbols = [ca.SX.sym(name, c.n) for name in ("q", "v", "w")]
    workless = ca.Function("E", symbols, [links.E(*symbols)])
    assert relative(columns(lambda e: workless(q, v, e), c.n), -C.T) < 1e-10


@pytest.mark.parametrize("robot", [fjr.single_link(), fjr.planar_two_link(**PLANAR)], ids=["single", "planar"])
def test_the_bodies_of_a_closed_form_arm_have_its_inertia_and_coriolis_product(robot: fjr.Robot) -> None:
    q, v, w = np.random.default_rng(1).uniform(-2, 2, (3, robot.n))
    chain = fjr.serial_chain(robot.links.bodies)
    assert relative(chain.M_l(q), robot.M_l(q)) < 1e-14
    assert relative(value(chain.C(q, v, w)), robot.coriolis(q, v, w), 1.0) < 1e-13
