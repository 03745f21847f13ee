# SPDX-License-Identifier: Apache-2.0
"""The law with load torques: agreement with an oracle in 80 digits, and the exact rate of its storage."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import LOOP_NAMES, LOOPS, Arm, Array, GainSet, random_state
from core.oracles.oracle import STEP, Instant, LiteralLaw, exact, inverse, mp, remembered
from fjr_core.robust.law import OUTPUTS, loaded_expression

CLOSE = 1e-9  # relative to the sum of absolute terms or the largest entry; soft joints lose six digits by cancellation
NAMES = ("single-3.1-cubic", "planar-31-hard-cubic", "planar-full-full")
loops = pytest.mark.parametrize("i", [LOOP_NAMES.index(name) for name in NAMES], ids=NAMES)


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


@cache
def loaded(i: int) -> tuple[fjr.TrackingLaw, ca.Function]:
    arm, gains = LOOPS[i]
    law = fjr.TrackingLaw(arm.robot, gains.gains)
    return law, loaded_expression(law)


class Case:
    """A random instant of a loop of LOOPS: state, reference, torques, and the values of the law by name."""

    def __init__(self, i: int, seed: int) -> None:
        self.arm, self.gains = LOOPS[i]
        rng, n = np.random.default_rng([i, seed]), self.arm.n
        self.x, self.jets = random_state(self.arm, rng, 0.5), rng.uniform(-1, 1, (5, n))
        self.known, self.matched = rng.uniform(-1, 1, (3, n)) * [[1.0], [3.0], [9.0]], rng.uniform(-1, 1, n)
        root = rng.uniform(-1, 1, (n, n)) + 2 * np.eye(n)
        self.integral, self.gain = rng.uniform(-1, 1, n), 0.1 * root @ root.T
        self.torque, self.excess = rng.uniform(-1, 1, 2 * n), rng.uniform(-1, 1, n)
        self.oracle = LiteralLoadedLaw(self.arm, self.gains, self.known, self.gain, self.matched)

        self.law, self.function = loaded(i)
        velocity = np.concatenate(self.arm.robot.velocities(self.x))
        self.measured = self.x[: 2 * n], velocity, self.jets.T, self.law.gain_values
        found = self.function(*self.measured, self.known.T, self.matched, self.integral, self.gain)
        self.found: dict[str, Array] = {name: value.full().ravel() for name, value in zip(OUTPUTS, found, strict=True)}


def close(found: Array, wanted: Any) -> None:
    np.testing.assert_allclose(found, wanted, rtol=0, atol=CLOSE * np.max(np.abs(wanted)))


@loops
def test_effort_storage_and_port_match_80_digit_oracle(i: int) -> None:
    case = Case(i, 0)
    wanted = case.oracle.at(case.x, case.jets, case.integral)
    close(case.found["u"], wanted.u)
    close(case.found["V"], wanted.V)
    close(case.found["port_l"], wanted.port)


@loops
def test_exact_rate_of_the_storage_under_any_torques(i: int) -> None:
    """dV/dt = -dissipation + port_l' (d_l - w - integral) + s_m' (d_m - matched + B_m (u - u_law))."""
    case, n = Case(i, 1), LOOPS[i][0].n
    u = case.found["u"] + case.excess
    real = case.oracle.dV(case.x, case.jets, case.integral, u, case.torque)
    unknown_l = case.torque[:n] - case.known[0] - case.integral
    unknown_m = case.torque[n:] - case.matched + case.arm.B_m @ case.excess
    terms = np.concatenate(
        [-case.found["dissipation"], case.found["port_l"] * unknown_l, case.found["port_m"] * unknown_m]
    )
    assert abs(real - terms.sum()) <= CLOSE * np.abs(terms).sum()


@loops
def test_storage_with_integral_energy_decays_under_any_constant_torque(i: int) -> None:
    """V + (integral - d)' gain^-1 (integral - d) / 2 decays by the dissipation alone for an unknown constant d."""
    case = Case(i, 2)
    torque = np.concatenate([case.known[0] + 0.7, case.matched])
    real = case.oracle.dV(case.x, case.jets, case.integral, case.found["u"], torque)
    energy = (case.integral - 0.7) @ case.found["port_l"]  # the gain cancels: d(integral)/dt = gain * port
    total = np.abs(case.found["dissipation"]).sum() + abs(real) + abs(energy)
    assert abs(real + energy + case.found["dissipation"].sum()) <= CLOSE * total


@loops
def test_without_load_the_law_is_the_nominal_one_and_without_integral_it_is_that_of_a_zero_integral(i: int) -> None:
    case, n = Case(i, 3), LOOPS[i][0].n
    none = np.zeros(n), np.zeros((n, n))
    u, V, *_ = case.function(*case.measured, np.zeros((n, 3)), np.zeros(n), *none)
    nominal_u, nominal_V = case.law.measured_expression(*case.measured)
    close(u.full(), nominal_u.full())
    close(V.full(), nominal_V.full())
    given = (*case.measured, case.known.T, case.matched)
    *wanted, _ = case.function(*given, *none)
    for found, value in zip(loaded_expression(case.law, integrates=False)(*given), wanted, strict=True):
        close(found.full(), value.full())
