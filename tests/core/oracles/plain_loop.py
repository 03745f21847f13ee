# SPDX-License-Identifier: Apache-2.0
"""A law u(x, x, t) on its robot, with closed forms of the arm and differences along the flow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import factorial
from typing import Any

import numpy as np

import fjr_core as fjr
from core.oracles.cases import ARMS, Arm, Array
from core.oracles.oracle import stencil
from fjr_core.extensions.law_registry import LAWS
from fjr_core.law.interfaces import StaticLaw

Function = Callable[[Array, Array], Any]
"""A function of a state x (4n,) and jets (5, n)."""

OTHERS = tuple(name for name in LAWS if name != "v_dpbc")
STIFF = (ARMS[1], ARMS[-1])
"""A joint and two coupled ones whose springs can hold them upright."""


def standard_law(name: str, arm: Arm, omega: float = 20.0, zeta: float = 0.8) -> StaticLaw:
    """Return the law of this name with the gains of its tuning rule."""
    kind = LAWS[name]
    return kind.make(arm.robot, kind.tuning_rule(arm.robot, np.zeros(arm.n), omega, zeta))


@dataclass(frozen=True, eq=False)
class PlainLoop:
    """An arm under a law; the equations of the arm use the matrices of cases.py."""

    arm: Arm
    law: StaticLaw

    @cached_property
    def plant(self) -> fjr.Plant:
        return fjr.Plant(self.arm.robot)

    def parts(self, x: Array) -> tuple[Array, Array, Array, Array]:
        """Return q, theta, dq and dtheta."""
        q, theta, p_l, p_m = np.split(x, 4)
        return q, theta, np.linalg.solve(self.arm.links.M(q), p_l), np.linalg.solve(self.arm.M_m, p_m)

    def state(self, q: Array, theta: Array, dq: Array, dtheta: Array) -> Array:
        return np.concatenate([q, theta, self.arm.links.M(q) @ dq, self.arm.M_m @ dtheta])

    def effort(self, x: Array, jets: Array) -> Array:
        q, theta, dq, dtheta = self.parts(x)
        return self.law.measured_command(np.r_[q, theta], np.r_[dq, dtheta], jets)[0]

    def storage(self, x: Array, jets: Array) -> float:
        q, theta, dq, dtheta = self.parts(x)
        return self.law.measured_command(np.r_[q, theta], np.r_[dq, dtheta], jets)[1]

    def rate_of(self, f: Function, x: Array, jets: Array, djets: Array | None = None) -> Any:
        """Return the time derivative of f(x, jets) along the arm under the law."""
        dx = self.plant.derivative(x, self.effort(x, jets))
        if djets is None:
            djets = np.vstack([jets[1:], np.linspace(0.7, -0.4, self.arm.n)])  # the last row has no effect
        h = 0.004 / max(1.0, float(np.max(np.abs(dx[: 2 * self.arm.n]))))
        return stencil(lambda s: f(x + s * dx, jets + s * djets), h)

    def along(self, f: Function) -> Function:
        """Return the time derivative of f as a function, which can be differentiated again."""
        return lambda x, jets: self.rate_of(f, x, jets)

    def ddq(self, x: Array, jets: Array | None = None) -> Array:
        """Return the acceleration of the links [rad/s^2] from the equation of motion."""
        q, theta, dq, _ = self.parts(x)
        return np.linalg.solve(self.arm.links.M(q), self.arm.K @ (theta - q) - self.bias(q, dq))

    def bias(self, q: Array, dq: Array) -> Array:
        """Return C dq + D_l dq + grad P_l."""
        links = self.arm.links
        return links.C(q, dq) @ dq + self.arm.D_l @ dq + links.grad_P(q)

    def ddtheta(self, x: Array, u: Array) -> Array:
        """Return the acceleration of the motors [rad/s^2] under u."""
        q, theta, _, dtheta = self.parts(x)
        force = self.arm.B_m @ u - self.arm.D_m @ dtheta - self.arm.K @ (theta - q)
        return np.linalg.solve(self.arm.M_m, force)

    def equilibrium(self, q: Array) -> Array:
        """Return the equilibrium state with the links at q."""
        still = np.zeros(self.arm.n)
        return self.state(q, q + np.linalg.solve(self.arm.K, self.arm.links.grad_P(q)), still, still)

    def on_reference(self, jets: Array) -> tuple[Array, Array]:
        """Return state and effort with which the links follow the polynomial of the reference, by differences."""
        arm = self.arm

        def q(s: float, k: int = 0) -> Array:
            return np.asarray(sum(jets[i] * s ** (i - k) / factorial(i - k) for i in range(k, 5)))

        def tau(s: float) -> Array:
            return arm.links.M(q(s)) @ q(s, 2) + self.bias(q(s), q(s, 1))

        def theta(s: float) -> Array:
            return q(s) + np.linalg.solve(arm.K, tau(s))

        def dtheta(s: float) -> Array:
            return np.asarray(stencil(lambda r: theta(s + r), 0.02))

        torque = arm.M_m @ stencil(dtheta, 0.02) + arm.D_m @ dtheta(0) + tau(0)
        return self.state(q(0), theta(0), q(0, 1), dtheta(0)), np.linalg.solve(arm.B_m, torque)


def constant_jets(q: Array) -> Array:
    """Return the jets (5, n) of a constant reference q."""
    jets = np.zeros((5, len(q)))
    jets[0] = q
    return jets
