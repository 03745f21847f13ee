# SPDX-License-Identifier: Apache-2.0
"""Exact identities of the closed loop as residuals: |left - right| over the sum of the absolute terms.

The left sides are differences along the flow through `effort`, `evaluate`, `Plant.derivative` and
`VirtualSystem.derivative`; the right sides use the matrices of cases.py. The functions accept any law with `effort`
and `evaluate`, also the misprinted ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np

import fjr_core as fjr
from core.oracles.cases import Arm, Array, GainSet, Point, random_point
from core.oracles.oracle import inverse, jacobian, stencil

TOLERANCE = 1e-10


def residual(left: Array, *terms: Array) -> float:
    """Return the largest |left - sum of terms| over the sum of the absolute terms, by norms over the components."""
    scale = sum(np.max(np.abs(term)) for term in (left, *terms))
    return float(np.max(np.abs(left - sum(terms))) / scale) if scale else 0.0


@dataclass(frozen=True, eq=False)
class Loop:
    """A robot under a law, any object with `effort` and `evaluate`."""

    arm: Arm
    gains: GainSet
    law: Any

    @cached_property
    def plant(self) -> fjr.Plant:
        return fjr.Plant(self.arm.robot)

    @cached_property
    def virtual(self) -> fjr.VirtualSystem:
        return fjr.VirtualSystem(self.arm.robot)

    def errors(self, x_v: Array, x: Array, jets: Array) -> Array:
        """Return (q_tilde_l, q_tilde_m, sigma_l, sigma_m), (4n,)."""
        e = self.law.evaluate(x_v, x, jets)
        return np.concatenate([e.q_tilde_l, e.q_tilde_m, e.sigma_l, e.sigma_m])

    def storage(self, x_v: Array, x: Array, jets: Array) -> float:
        return float(self.law.evaluate(x_v, x, jets).V)

    def field(self, x_v: Array, p: Point) -> Array:
        """Return the closed-loop virtual vector field at x_v."""
        return self.virtual.derivative(x_v, p.x, self.law.effort(x_v, p.x, p.jets, p.omega))

    def rate_of(self, f: Any, p: Point) -> Any:
        """Return the time derivative of f(x_v, x, jets) along the closed-loop virtual field and the plant under p.u."""
        dx_v, dx = self.field(p.x_v, p), self.plant.derivative(p.x, p.u)
        n = self.arm.n
        fastest = np.max(np.abs([dx[:n], dx_v[:n], dx[n : 2 * n], dx_v[n : 2 * n]]))
        h = 0.006 * self.arm.grain / max(1.0, float(fastest))
        return stencil(lambda s: f(p.x_v + s * dx_v, p.x + s * dx, p.jets + s * p.djets), h)


@cache
def loop_of(arm: Arm, gains: GainSet) -> Loop:
    """Return the robot under the law of fjr_core, built once."""
    return Loop(arm, gains, fjr.TrackingLaw(arm.robot, gains.gains))


def on_reference(arm: Arm, gains: GainSet) -> tuple[Point, Array]:
    """Return a measured state on the reference and the virtual state with all errors zero, solved block by block."""
    law, p = loop_of(arm, gains).law, random_point(arm, 30)
    M = arm.links.M(p.x[: arm.n])
    q_lv, p_lv, zero = p.jets[0], M @ p.jets[1], np.zeros(arm.n)
    q_mv = law.evaluate(np.concatenate([q_lv, q_lv, p_lv, zero]), p.x, p.jets).q_md
    sigma_m = law.evaluate(np.concatenate([q_lv, q_mv, p_lv, zero]), p.x, p.jets).sigma_m
    return p, np.concatenate([q_lv, q_mv, p_lv, -sigma_m])


def closed_form(loop: Loop, p: Point) -> tuple[Array, Array, Array]:
    """Return M_l(q_l), C(q_l, dq_l) and E_l = -C' by the closed forms of cases.py."""
    q_l, _, p_l, _ = np.split(p.x, 4)
    M = loop.arm.links.M(q_l)
    C = loop.arm.links.C(q_l, np.linalg.solve(M, p_l))
    return M, C, -C.T


def error_dynamics(loop: Loop, p: Point) -> dict[str, float]:
    """Return the residuals of the four closed-loop error equations by name."""
    a, g = loop.arm, loop.gains
    e_l, e_m, sigma_l, sigma_m = np.split(loop.errors(p.x_v, p.x, p.jets), 4)
    de_l, de_m, dsigma_l, dsigma_m = np.split(loop.rate_of(loop.errors, p), 4)
    M, _, E = closed_form(loop, p)
    s_l, s_m = inverse(M) @ sigma_l, inverse(a.M_m) @ sigma_m
    q_lv, q_mv, _, _ = np.split(p.x_v, 4)
    at, wanted = q_mv - q_lv, loop.law.evaluate(p.x_v, p.x, p.jets).q_md - q_lv
    K = a.K + np.diag(a.cubic * (at**2 + at * wanted + wanted**2))
    return {
        "q_tilde_l": residual(de_l, s_l, -g.phi_l(e_l)),
        "sigma_l": residual(
            dsigma_l, -E @ s_l, -(a.D_l + g.K_ld) @ s_l, -g.Pi_l @ e_l, a.spring(at), -a.spring(wanted)
        ),
        "q_tilde_m": residual(de_m, s_m, -g.phi_m(e_m), -inverse(g.Pi_m) @ K.T @ s_l),
        "sigma_m": residual(dsigma_m, -(a.D_m + g.K_md) @ s_m, -g.Pi_m @ e_m, p.omega),
    }


def storage_terms(loop: Loop, p: Point) -> tuple[float, ...]:
    """Return the five terms of dV/dt."""
    a, g = loop.arm, loop.gains
    e_l, e_m, sigma_l, sigma_m = np.split(loop.errors(p.x_v, p.x, p.jets), 4)
    s_l, s_m = inverse(closed_form(loop, p)[0]) @ sigma_l, inverse(a.M_m) @ sigma_m
    return (
        -e_l @ g.Pi_l @ g.phi_l(e_l),
        -s_l @ (a.D_l + g.K_ld) @ s_l,
        -e_m @ g.Pi_m @ g.phi_m(e_m),
        -s_m @ (a.D_m + g.K_md) @ s_m,
        s_m @ p.omega,
    )


def storage_rate(loop: Loop, p: Point) -> float:
    """Return the residual of the exact dV/dt."""
    return residual(loop.rate_of(loop.storage, p), *storage_terms(loop, p))


def coordinate_steps(loop: Loop, p: Point) -> Array:
    """Return steps of the stencil in x: 0.05 rad, and inertia times 5 rad/s (the law is quadratic in momenta)."""
    M = closed_form(loop, p)[0]
    angle = np.full(loop.arm.n, 0.05)
    return loop.arm.grain**1.5 * np.concatenate([angle, angle, np.diag(M) * 5, np.diag(loop.arm.M_m) * 5])


def generator(loop: Loop, p: Point) -> Array:
    """Return A = (Theta J + dTheta) Theta^-1 in the coordinates (q_tilde_l, q_tilde_m, sigma_l, sigma_m)."""
    steps = coordinate_steps(loop, p)

    def theta(x_v: Array, x: Array, jets: Array) -> Array:
        return jacobian(lambda y: loop.errors(y, x, jets), x_v, steps)

    J = jacobian(lambda y: loop.field(y, p), p.x_v, steps)
    Theta, dTheta = theta(p.x_v, p.x, p.jets), loop.rate_of(theta, p)
    return (Theta @ J + dTheta) @ np.linalg.inv(Theta)


def block_diagonal(*blocks: Array) -> Array:
    n = len(blocks[0])
    D = np.zeros((n * len(blocks), n * len(blocks)))
    for i, block in enumerate(blocks):
        D[n * i : n * (i + 1), n * i : n * (i + 1)] = block
    return D


def metric(loop: Loop, p: Point) -> tuple[Array, Array]:
    """Return P = diag(Pi_l, Pi_m, M_l^-1, M_m^-1) and its time derivative (dM_l = C + C')."""
    M, C, _ = closed_form(loop, p)
    zero = np.zeros_like(M)
    P = block_diagonal(loop.gains.Pi_l, loop.gains.Pi_m, inverse(M), inverse(loop.arm.M_m))
    return P, block_diagonal(zero, zero, -inverse(M) @ (C + C.T) @ inverse(M), zero)


def interconnection(arm: Arm, coupling: Array) -> Array:
    """Return J_v as printed in eq. (44), with the blocks of eq. (49): `coupling` and minus its transpose."""
    zero, one = np.zeros((arm.n, arm.n)), np.eye(arm.n)
    return np.block([
        [zero, zero, one, zero],
        [zero, zero, -coupling.T, one],
        [-one, coupling, zero, zero],
        [zero, -one, zero, zero],
    ])  # fmt: skip


def structure_as_printed(arm: Arm, gains: GainSet, p: Point, coupling: Array) -> tuple[Array, Array]:
    """Return J_v and R_v as printed in eq. (44), with E_l in R_v."""
    loop = loop_of(arm, gains)
    e_l, e_m, *_ = np.split(loop.errors(p.x_v, p.x, p.jets), 4)
    R_v = block_diagonal(
        gains.dphi_l(e_l) @ inverse(gains.Pi_l),
        gains.dphi_m(e_m) @ inverse(gains.Pi_m),
        closed_form(loop, p)[2] + arm.D_l + gains.K_ld,
        arm.D_m + gains.K_md,
    )
    return interconnection(arm, coupling), R_v


def sym(A: Array) -> Array:
    return (A + A.T) / 2


def metric_residual(P: Array, left: Array, *terms: Array) -> float:
    """Return the residual of quadratic forms in coordinates where the metric P is the identity."""
    W = np.linalg.inv(np.linalg.cholesky(P))
    return residual(*(W @ term @ W.T for term in (left, *terms)))
