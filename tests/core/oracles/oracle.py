# SPDX-License-Identifier: Apache-2.0
"""Two oracles that are independent of the time derivatives in the law.

`stencil`: derivative of a function of one variable in double precision, through public methods only.
`LiteralLaw`: equations (30)-(43) as printed, with or without the errata, on closed-form robots in 80-digit
arithmetic; each time derivative is a central difference along the flow, nested three deep.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import wraps
from typing import Any

import mpmath
import numpy as np

from core.oracles.cases import Arm, Array, GainSet

WEIGHTS = np.array([5 / 6, -5 / 21, 5 / 84, -5 / 504, 1 / 1260])
"""Weights of the central first derivative of order ten at offsets of 1 to 5 steps."""


def stencil(f: Callable[[float], Any], h: float) -> Any:
    """Return f'(0) to order h^10; f returns a number or an array."""
    return sum(w * (np.asarray(f(k * h)) - np.asarray(f(-k * h))) for k, w in enumerate(WEIGHTS, 1)) / h


def jacobian(f: Callable[[Array], Array], x: Array, steps: Array) -> Array:
    """Return df/dx by the stencil, column by column; `steps`, shaped like x, are the steps of the coordinates."""
    columns = [stencil(lambda s, e=e: f(x + s * e), h) for e, h in zip(np.eye(len(x)), steps, strict=True)]
    return np.stack(columns, axis=-1)


mp = mpmath.MPContext()
mp.dps = 80
STEP = mp.mpf(10) ** -12  # nested three or four deep: truncation 1e-24, rounding below 1e-30


def exact(value: Any) -> Array:
    """Convert doubles to 80-digit numbers without rounding."""
    return np.vectorize(mp.mpf, otypes=[object])(np.asarray(value, dtype=float))


def inverse(A: Array) -> Array:
    """Return the inverse of a matrix of floats, or by cofactors of a 1x1 or 2x2 matrix of other numbers."""
    if A.dtype != object:
        return np.linalg.inv(A)
    if A.shape == (1, 1):
        return np.array([[1 / A[0, 0]]])
    (a, b), (c, d) = A
    return np.array([[d, -b], [-c, a]]) / (a * d - b * c)


class LiteralPlant:
    """Plant (36) from its Hamiltonian by differences, and virtual system (38), in 80 digits."""

    def __init__(self, arm: Arm) -> None:
        self.n, self.links = arm.n, arm.links
        self.K, self.M_m, self.D_l, self.D_m, self.B_m = map(exact, (arm.K, arm.M_m, arm.D_l, arm.D_m, arm.B_m))
        self.cubic, self.torsion = exact(arm.cubic), arm.torsion

    def split(self, x: Array) -> list[Array]:
        return np.split(x, 4)

    def M_l(self, q_l: Array) -> Array:
        return self.links.M(q_l, mp)

    def H(self, x: Array) -> Any:
        q_l, q_m, p_l, p_m = self.split(x)
        zeta = q_m - q_l
        kinetic = p_l @ inverse(self.M_l(q_l)) @ p_l + p_m @ inverse(self.M_m) @ p_m
        weight = kinetic / 2 + self.links.P(q_l, mp)
        if self.torsion is not None:
            return weight + sum(self.torsion.each(self.torsion.energy, zeta))
        return weight + zeta @ self.K @ zeta / 2 + self.cubic @ zeta**4 / 4

    def spring(self, zeta: Array) -> Array:
        if self.torsion is not None:
            return self.torsion.each(self.torsion.torque, zeta)
        return self.K @ zeta + self.cubic * zeta**3

    def deflection(self, tau: Array) -> Array:
        """Return the root of spring(zeta) = tau by Newton's method, which is monotone from outside the root."""
        if self.torsion is not None:
            return self.torsion.each(self.torsion.deflection, tau, [mp] * self.n)
        zeta = inverse(self.K) @ tau
        for _ in range(200 if np.any(self.cubic) else 0):
            zeta = zeta - (self.spring(zeta) - tau) / (np.diag(self.K) + 3 * self.cubic * zeta**2)
        return zeta

    def compliance(self, zeta: Array) -> Array:
        if self.torsion is not None:
            return np.diag(1 / self.torsion.each(self.torsion.tangent, zeta))
        if not np.any(self.cubic):
            return inverse(self.K)
        return np.diag(1 / (np.diag(self.K) + 3 * self.cubic * zeta**2))

    def secant(self, a: Array, b: Array) -> Array:
        """Return the stiffness between two deflections, the quotient of differences if the springs harden."""
        if not np.any(self.cubic) and self.torsion is None:
            return self.K
        return np.diag((self.spring(a) - self.spring(b)) / (a - b))

    def E(self, x: Array) -> Array:
        """Return E_l = S_H - dM_l/2 = -C' with the Christoffel matrix C."""
        q_l, _, p_l, _ = self.split(x)
        return -self.links.C(q_l, inverse(self.M_l(q_l)) @ p_l, mp).T

    def derivative(self, x: Array, u: Array) -> Array:
        steps = STEP * np.eye(4 * self.n, dtype=int)
        gradient = np.array([(self.H(x + e) - self.H(x - e)) / (2 * STEP) for e in steps])
        force_l, force_m, dq_l, dq_m = self.split(gradient)
        return np.concatenate([dq_l, dq_m, -force_l - self.D_l @ dq_l, -force_m - self.D_m @ dq_m + self.B_m @ u])

    def virtual(self, x_v: Array, x: Array, u: Array) -> Array:
        q_lv, q_mv, p_lv, p_mv = self.split(x_v)
        dq_lv, dq_mv = inverse(self.M_l(x[: self.n])) @ p_lv, inverse(self.M_m) @ p_mv
        spring = self.spring(q_mv - q_lv)
        dp_lv = -self.links.grad_P(q_lv, mp) + spring - (self.E(x) + self.D_l) @ dq_lv
        return np.concatenate([dq_lv, dq_mv, dp_lv, -spring - self.D_m @ dq_mv + self.B_m @ u])


def remembered(value: Callable[[Any, Array], Any]) -> Callable[[Any, Array], Any]:
    """Keep the values of a method of LiteralLaw by the digits of z: differences of several terms meet there."""

    @wraps(value)
    def kept(self: LiteralLaw, z: Array) -> Any:
        key = value.__qualname__, *(number._mpf_ for number in z)
        if key not in self.memory:
            self.memory[key] = value(self, z)
        return self.memory[key]

    return kept


class Instant:
    """A law at one instant: `u`, `u_l`, `q_md`, `q_tilde_l`, .. `V` as doubles."""

    def __init__(self, law: LiteralLaw, z: Array) -> None:
        self.law, self.z = law, z

    def __getattr__(self, name: str) -> Array:
        return np.asarray(getattr(self.law, name)(self.z)).astype(float)


class LiteralLaw:
    """The law with the public methods `effort` and `evaluate` of fjr.TrackingLaw.

    printed: misprints to keep: "gravity" (33) and "spring" (42) at the measured state, "coupling" (40) with M_l',
    "phi_m" (40) with the error of the links, "q_md" with the measured q_l, "B_m" (42) without its inverse.
    """

    def __init__(self, arm: Arm, gains: GainSet, printed: tuple[str, ...] = ()) -> None:
        self.arm, self.plant, self.printed, self.n = arm, LiteralPlant(arm), printed, arm.n
        for name in ("Lambda_l", "Pi_l", "K_ld", "Lambda_m", "Pi_m", "K_md", "Gamma_l", "Gamma_m"):
            setattr(self, name, exact(getattr(gains, name)))

    def effort(self, x_v: Array, x: Array, jets: Array, omega: Any = 0.0) -> Array:
        return self.evaluate(x_v, x, jets, omega).u

    def evaluate(self, x_v: Array, x: Array, jets: Array, omega: Any = 0.0) -> Instant:
        """Return the lazily computed values of the law at z = (x_v, x, s), s being the elapsed time."""
        law = self.along_reference(jets)
        law.omega = exact(np.broadcast_to(omega, (self.n,)))
        return Instant(law, np.concatenate([exact(x_v), exact(x), [mp.mpf(0)]]))

    def along_reference(self, jets: Array) -> Any:
        """Return a copy for a reference, which remembers nothing yet."""
        law = copy.copy(self)
        law.jets, law.memory = exact(jets), {}
        return law

    def states(self, z: Array) -> tuple[Array, Array, Any]:
        return z[: 4 * self.n], z[4 * self.n : 8 * self.n], z[-1]

    def q_ld(self, s: Any, k: int) -> Array:
        """Return the k-th derivative of the Taylor polynomial of the reference at time s."""
        return sum(self.jets[i] * s ** (i - k) / mp.factorial(i - k) for i in range(k, 5))

    def d(self, e: Callable[[Array], Array], z: Array) -> Array:
        """Return the total time derivative of e along the flow, which does not depend on the input of the plant."""
        dz = self.flow(z)
        return (e(z + STEP * dz) - e(z - STEP * dz)) / (2 * STEP)

    @remembered
    def flow(self, z: Array) -> Array:
        x_v, x, _ = self.states(z)
        u = exact(np.arange(self.n) - 0.7)
        return np.concatenate([self.plant.virtual(x_v, x, u), self.plant.derivative(x, -u), [mp.mpf(1)]])

    @remembered
    def M(self, z: Array) -> Array:
        return self.plant.M_l(self.states(z)[1][: self.n])

    # link stage, (30)-(33)

    def q_tilde_l(self, z: Array) -> Array:
        x_v, _, s = self.states(z)
        return x_v[: self.n] - self.q_ld(s, 0)

    def v_lr(self, z: Array) -> Array:
        e = self.q_tilde_l(z)
        return self.q_ld(self.states(z)[2], 1) - self.Lambda_l @ e - self.Gamma_l @ e**3

    @remembered
    def p_lr(self, z: Array) -> Array:
        return self.M(z) @ self.v_lr(z)

    def sigma_l(self, z: Array) -> Array:
        return self.plant.split(self.states(z)[0])[2] - self.p_lr(z)

    @remembered
    def u_l(self, z: Array) -> Array:
        x_v, x, _ = self.states(z)
        gravity_at = x if "gravity" in self.printed else x_v
        u_lff = self.d(self.p_lr, z) + self.plant.links.grad_P(gravity_at[: self.n], mp)
        u_lff = u_lff + (self.plant.E(x) + self.plant.D_l) @ self.v_lr(z)
        return u_lff - self.Pi_l @ self.q_tilde_l(z) - self.K_ld @ inverse(self.M(z)) @ self.sigma_l(z)

    # motor stage, (39)-(42)

    @remembered
    def q_md(self, z: Array) -> Array:
        x_v, x, _ = self.states(z)
        return (x if "q_md" in self.printed else x_v)[: self.n] + self.plant.deflection(self.u_l(z))

    def q_tilde_m(self, z: Array) -> Array:
        return self.plant.split(self.states(z)[0])[1] - self.q_md(z)

    @remembered
    def v_mr(self, z: Array) -> Array:
        e = self.q_tilde_l(z) if "phi_m" in self.printed else self.q_tilde_m(z)
        weight = self.M(z).T if "coupling" in self.printed else inverse(self.M(z))
        q_lv, q_mv, _, _ = self.plant.split(self.states(z)[0])
        K = self.plant.secant(q_mv - q_lv, self.q_md(z) - q_lv)
        coupling = inverse(self.Pi_m) @ K.T @ weight @ self.sigma_l(z)
        return self.d(self.q_md, z) - self.Lambda_m @ e - self.Gamma_m @ e**3 - coupling

    def p_mr(self, z: Array) -> Array:
        return self.plant.M_m @ self.v_mr(z)

    def sigma_m(self, z: Array) -> Array:
        return self.plant.split(self.states(z)[0])[3] - self.p_mr(z)

    def u(self, z: Array) -> Array:
        x_v, x, _ = self.states(z)
        q_l, q_m, _, _ = self.plant.split(x if "spring" in self.printed else x_v)
        u_mff = self.d(self.p_mr, z) + self.plant.spring(q_m - q_l) + self.plant.D_m @ self.v_mr(z)
        s_m = inverse(self.plant.M_m) @ self.sigma_m(z)
        u_mfb = -self.Pi_m @ self.q_tilde_m(z) - self.K_md @ s_m + self.omega
        return u_mff + u_mfb if "B_m" in self.printed else inverse(self.plant.B_m) @ (u_mff + u_mfb)

    def V(self, z: Array) -> Any:
        """Return the storage (43)."""
        e_l, e_m, s_l, s_m = self.q_tilde_l(z), self.q_tilde_m(z), self.sigma_l(z), self.sigma_m(z)
        position = e_l @ self.Pi_l @ e_l + e_m @ self.Pi_m @ e_m
        return (position + s_l @ inverse(self.M(z)) @ s_l + s_m @ inverse(self.plant.M_m) @ s_m) / 2
