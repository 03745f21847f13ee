# SPDX-License-Identifier: Apache-2.0
"""The law with known link torques and integral action in 80 digits; each derivative is a difference."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from core.oracles.cases import Arm, Array, GainSet
from core.oracles.oracle import STEP, Instant, LiteralLaw, exact, inverse, mp, remembered


class LiteralLoadedLaw(LiteralLaw):
    """The law at x_v = x with z = (x, integral, s); known (3, n): Taylor coefficients of the known link torque."""

    def __init__(self, arm: Arm, gains: GainSet, known: Array, gain: Array, matched: Array) -> None:
        super().__init__(arm, gains)
        self.known, self.gain, self.omega = exact(known), exact(gain), -exact(matched)

    def at(self, x: Array, jets: Array, integral: Array) -> Instant:
        """Return the values of the law for state, jets of the reference and value of the integral."""
        law = self.along_reference(jets)
        return Instant(law, np.concatenate([exact(x), exact(integral), [mp.mpf(0)]]))

    def states(self, z: Array) -> tuple[Array, Array, Any]:
        return z[: 4 * self.n], z[: 4 * self.n], z[-1]

    def external(self, z: Array) -> Array:
        w = sum(self.known[i] * z[-1] ** i / mp.factorial(i) for i in range(3))
        return np.asarray(w + z[4 * self.n : 5 * self.n])

    def d(self, e: Callable[[Array], Array], z: Array, port: Array | None = None) -> Array:
        """Differentiate along the model of the law; the rate of the integral is gain * port."""
        rate = exact(np.zeros(self.n)) if port is None else self.gain @ port
        return self.along(e, z, np.concatenate([self.flow(z), rate, [mp.mpf(1)]]))

    @remembered
    def flow(self, z: Array) -> Array:
        dx = self.plant.derivative(z[: 4 * self.n], exact(np.arange(self.n) - 0.7))
        dx[2 * self.n : 3 * self.n] += self.external(z)
        return dx

    def along(self, e: Callable[[Array], Array], z: Array, dz: Array) -> Any:
        return (e(z + STEP * dz) - e(z - STEP * dz)) / (2 * STEP)

    def by_momentum(self, e: Callable[[Array], Array], z: Array) -> Array:
        """Return de/dp_l, (n, n) for a vector e and (n,) for a number."""
        units = [exact(np.eye(5 * self.n + 1)[2 * self.n + i]) for i in range(self.n)]
        return np.stack([self.along(e, z, unit) for unit in units], axis=-1)

    @remembered
    def u_l(self, z: Array) -> Array:
        return super().u_l(z) - self.external(z)

    @remembered
    def first_port(self, z: Array) -> Array:
        """Return the part of dV/dp_l that is available for q_md."""
        return inverse(self.M(z)) @ self.sigma_l(z) - self.by_momentum(self.q_md, z).T @ self.Pi_m @ self.q_tilde_m(z)

    @remembered
    def v_mr(self, z: Array) -> Array:
        e, (q_l, q_m, _, _) = self.q_tilde_m(z), self.plant.split(z[: 4 * self.n])
        K = self.plant.secant(q_m - q_l, self.q_md(z) - q_l)
        coupling = inverse(self.Pi_m) @ K.T @ inverse(self.M(z)) @ self.sigma_l(z)
        return self.d(self.q_md, z, self.first_port(z)) - self.Lambda_m @ e - self.Gamma_m @ e**3 - coupling

    def port(self, z: Array) -> Array:
        """Return dV/dp_l of the storage."""
        return self.by_momentum(self.V, z)

    def u(self, z: Array) -> Array:
        q_l, q_m, _, _ = self.plant.split(z[: 4 * self.n])
        slope = self.by_momentum(self.v_mr, z)
        port = self.first_port(z) - slope.T @ self.sigma_m(z)
        lag = slope @ self.gain @ self.plant.compliance(self.q_md(z) - q_l) @ self.Pi_m @ self.q_tilde_m(z)
        dv_mr, s_m = self.d(self.v_mr, z, port), inverse(self.plant.M_m) @ self.sigma_m(z)
        u_mff = self.plant.M_m @ (dv_mr + lag) + self.plant.spring(q_m - q_l) + self.plant.D_m @ self.v_mr(z)
        u_mfb = -self.Pi_m @ self.q_tilde_m(z) - self.K_md @ s_m + self.omega
        return inverse(self.plant.B_m) @ (u_mff + u_mfb)

    def dV(self, x: Array, jets: Array, integral: Array, u: Array, torque: Array) -> float:
        """Return dV/dt along the actual motion under u and torques (2n,); the rate of the integral is gain * port.

        jets (6, n): the reference with its fifth derivative. The known torque follows its polynomial.
        """
        law = self.along_reference(jets)
        z = np.concatenate([exact(x), exact(integral), [mp.mpf(0)]])
        dx = self.plant.derivative(exact(x), exact(u))
        dx[2 * self.n :] += exact(torque)
        return float(law.along(law.V, z, np.concatenate([dx, self.gain @ law.port(z), [mp.mpf(1)]])))
