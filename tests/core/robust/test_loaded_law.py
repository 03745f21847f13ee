# SPDX-License-Identifier: Apache-2.0
"""The law with load torques: agreement with an 80-digit oracle, and the exact rate of its storage."""

from __future__ import annotations

from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import LOOP_NAMES, LOOPS, Array, random_state
from core.oracles.loaded_oracle import LiteralLoadedLaw
from fjr_core.robust.law import OUTPUTS, loaded_expression

CLOSE = 1e-9  # relative to the sum of absolute terms or the largest entry; soft joints lose six digits by cancellation


@cache
def loaded(i: int) -> tuple[fjr.TrackingLaw, ca.Function]:
    arm, gains = LOOPS[i]
    law = fjr.TrackingLaw(arm.robot, gains.gains)
    return law, loaded_expression(law)


class Case:
    """A random instant of a loop of LOOPS: state, reference, torques, and the values of the law by name."""

    def __init__(self, i: int, seed: int, integrating: bool = True) -> None:
        self.arm, self.gains = LOOPS[i]
        rng, n = np.random.default_rng([i, seed]), self.arm.n
        self.x, self.jets = random_state(self.arm, rng, 0.5), rng.uniform(-1, 1, (5, n))
        self.known, self.matched = rng.uniform(-1, 1, (3, n)) * [[1.0], [3.0], [9.0]], rng.uniform(-1, 1, n)
        root = rng.uniform(-1, 1, (n, n)) + 2 * np.eye(n)
        self.integral, self.gain = rng.uniform(-1, 1, n), root @ root.T * (0.1 * integrating)
        self.torque, self.excess = rng.uniform(-1, 1, 2 * n), rng.uniform(-1, 1, n)
        self.oracle = LiteralLoadedLaw(self.arm, self.gains, self.known, self.gain, self.matched)

        law, function = loaded(i)
        velocity = np.concatenate(self.arm.robot.velocities(self.x))
        torques = (self.known.T, self.matched, self.integral, self.gain)
        found = function(self.x[: 2 * n], velocity, self.jets.T, law.gain_values, *torques)
        self.found: dict[str, Array] = {name: value.full().ravel() for name, value in zip(OUTPUTS, found, strict=True)}


def close(found: Array, wanted: Any) -> None:
    np.testing.assert_allclose(found, wanted, rtol=0, atol=CLOSE * np.max(np.abs(wanted)))


@pytest.mark.parametrize("i", range(len(LOOPS)), ids=LOOP_NAMES)
def test_effort_storage_and_port_match_80_digit_oracle(i: int) -> None:
    case = Case(i, 0)
    wanted = case.oracle.at(case.x, case.jets, case.integral)
    close(case.found["u"], wanted.u)
    close(case.found["V"], wanted.V)
    close(case.found["port_l"], wanted.port)


@pytest.mark.parametrize("i", range(len(LOOPS)), ids=LOOP_NAMES)
@pytest.mark.parametrize("integrating", [True, False])
def test_exact_rate_of_the_storage_under_any_torques(i: int, integrating: bool) -> None:
    """dV/dt = -dissipation + port_l' (d_l - w - integral) + s_m' (d_m - matched + B_m (u - u_law))."""
    case, n = Case(i, 1, integrating), LOOPS[i][0].n
    u = case.found["u"] + case.excess
    real = case.oracle.dV(case.x, case.jets, case.integral, u, case.torque)
    unknown_l = case.torque[:n] - case.known[0] - case.integral
    unknown_m = case.torque[n:] - case.matched + case.arm.B_m @ case.excess
    terms = np.concatenate(
        [-case.found["dissipation"], case.found["port_l"] * unknown_l, case.found["port_m"] * unknown_m]
    )
    assert abs(real - terms.sum()) <= CLOSE * np.abs(terms).sum()


@pytest.mark.parametrize("i", range(len(LOOPS)), ids=LOOP_NAMES)
def test_storage_with_integral_energy_decays_under_any_constant_torque(i: int) -> None:
    """V + (integral - d)' gain^-1 (integral - d) / 2 decays by the dissipation alone for an unknown constant d."""
    case = Case(i, 2)
    torque = np.concatenate([case.known[0] + 0.7, case.matched])
    real = case.oracle.dV(case.x, case.jets, case.integral, case.found["u"], torque)
    energy = (case.integral - 0.7) @ case.found["port_l"]  # the gain cancels: d(integral)/dt = gain * port
    total = np.abs(case.found["dissipation"]).sum() + abs(real) + abs(energy)
    assert abs(real + energy + case.found["dissipation"].sum()) <= CLOSE * total


@pytest.mark.parametrize("i", range(len(LOOPS)), ids=LOOP_NAMES)
def test_zero_load_torques_give_the_nominal_law(i: int) -> None:
    law, function = loaded(i)
    case, n = Case(i, 3), LOOPS[i][0].n
    velocity = np.concatenate(case.arm.robot.velocities(case.x))
    measured = (case.x[: 2 * n], velocity, case.jets.T, law.gain_values)
    u, V, *_ = function(*measured, np.zeros((n, 3)), np.zeros(n), np.zeros(n), np.zeros((n, n)))
    wanted_u, wanted_V = law.measured_expression(*measured)
    close(u.full(), wanted_u.full())
    close(V.full(), wanted_V.full())


@pytest.mark.parametrize("i", range(len(LOOPS)), ids=LOOP_NAMES)
def test_omitting_the_integral_equals_a_zero_integral(i: int) -> None:
    law, function = loaded(i)
    case, n = Case(i, 4), LOOPS[i][0].n
    velocity = np.concatenate(case.arm.robot.velocities(case.x))
    given = (case.x[: 2 * n], velocity, case.jets.T, law.gain_values, case.known.T, case.matched)
    *wanted, _ = function(*given, np.zeros(n), np.zeros((n, n)))
    for found, value in zip(loaded_expression(law, integrates=False)(*given), wanted, strict=True):
        close(found.full(), value.full())
