# SPDX-License-Identifier: Apache-2.0
"""Each row of the check of the wiring in C is that of its equations in NumPy (core/oracles/wiring.py)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles import wiring
from core.oracles.wiring import Rows, Window, torque_tolerance
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import c_library
from fjr_core.runtime.library import HEADER, c_code, constant, sizes, text
from fjr_monitor.diagnosis.fault_isolation import WiringCheck

ROW = """
int row_of(const struct fjr_model* m, const struct fjr_wiring* w, const double* constant, int row, double* y, double* x,
           double* S, double* freedom);
"""
WRAPPER = """
int row_of(const struct fjr_model* m, const struct fjr_wiring* w, const double* constant, int row, double* y, double* x,
           double* S, double* freedom) {
  const struct wires v = as_measured();
  struct fjr_comparison c;
  struct arm arm;
  struct sides s;
  take_signals(w, &c);
  copy(c.constant, constant, N);
  if (!evaluate_arm(m, &c, &v, &arm)) return 0;
  if (row < 2 * N)
    torque_row(m, &c, &v, &arm, row, 1, &s);
  else
    speed_row(&c, row - 2 * N, &s);
  copy(y, s.y, s.m), copy(x, s.x, s.m);
  for (int i = 0; i < s.m; ++i) copy(S + i * s.m, s.S[i], s.m);
  *freedom = s.freedom;
  return s.m;
}
"""


def coupled(a: float, b: float) -> Array:
    return np.array([[a, 0.2 * b], [0.2 * b, b]])


LINKS = fjr.planar_two_link().links
COUPLED = fjr.Robot(
    LINKS, coupled(0.02, 0.01), coupled(40, 25), coupled(0.2, 0.1), coupled(0.01, 0.02), coupled(1, 0.8)
)
DIAGONAL = replace(COUPLED, K=np.diag([40.0, 25.0]))
Z = np.array([[0.02, 0.03], [0.05, 0.06], [0.11, 0.12]])
ROBOTS = {
    "full matrices": COUPLED,
    "cubic": replace(DIAGONAL, cubic=np.array([4e3, 5e3])),
    "torsion": replace(DIAGONAL, torsion=np.array([Z, Z * [40.0, 25.0] * [[1.2], [2.0], [2.5]]])),
}


def motion(states: int) -> Window:
    """Return a noisy motion with deflections on each piece of the springs, at uneven times."""
    rng = np.random.default_rng(states)
    t = np.cumsum(rng.uniform(0.8e-3, 1.2e-3, states))
    angle = np.outer(t, [30.0, 50.0, 40.0, 60.0]) + [0.3, 1.0, 2.0, 4.0]
    q = np.array([0.9, 0.7, 0.95, 0.8]) * np.sin(angle) / 6 + 1e-5 * rng.normal(size=(states, 4))
    dq = np.gradient(q, t, axis=0) + 0.1 * rng.normal(size=(states, 4))
    return Window(t, q, dq, rng.normal(0.0, 3.0, (states, 2)))


class RowsInC:
    """Rows of the states that a check has seen."""

    def __init__(self, robot: fjr.Robot, seen: Window) -> None:
        self.n, check = robot.n, WiringCheck(robot, ("a", "b"))
        self.library = c_library("wiring_rows", text(HEADER) + ROW, c_code() + WRAPPER, sizes(robot.n, 1), ["-O1"])
        for t, *values in zip(seen.t, seen.q, seen.dq, seen.u, strict=True):
            q, dq, u = (check._ffi.from_buffer("double[]", each.copy()) for each in values)
            check._lib.fjr_wiring_see(check.state, t, q, dq)
            check._lib.fjr_wiring_sent(check.state, u)
        pointers = {"fjr_model": check._model, "fjr_wiring": check.state}
        self.structs = [
            self.library.ffi.cast(f"struct {kind} *", int(check._ffi.cast("uintptr_t", pointer)))
            for kind, pointer in pointers.items()
        ]
        self.check = check  # owns what the structures point to

    def row(self, constant: Array, number: int, m: int) -> tuple[Array, Array, Array, float]:
        """Return y, x (m,), the upper triangle of S (m, m), and the degrees of freedom of its noise."""
        arrays = y, x, S, freedom = [np.zeros(shape) for shape in (m, m, (m, m), 1)]
        given, *found = (self.library.ffi.from_buffer("double[]", each) for each in (constant, *arrays))
        assert self.library.lib.row_of(*self.structs, given, number, *found) == m
        return y, x, np.triu(S), float(freedom[0])


@pytest.mark.parametrize("states", [9, 21, 27])
@pytest.mark.parametrize("name", ROBOTS)
def test_both_sides_of_each_row_and_their_covariance_are_those_of_the_equations(name: str, states: int) -> None:
    """Rows of torques have a component for each interval of the last 21 states, those of speeds slow motion."""
    robot, seen = ROBOTS[name], motion(states)
    window = Window(seen.t[-21:], seen.q[-21:], seen.dq[-21:], seen.u[-21:])
    constant, in_c = torque_tolerance(robot, window.q[0]), RowsInC(robot, seen)
    for first, rows in ((0, Rows.torques(robot, window, constant)), (4, Rows.velocities(window))):
        for row, (wanted_y, wanted_x, root) in enumerate(zip(rows.y, rows.x, rows.root, strict=True)):
            y, x, S, freedom = in_c.row(constant, first + row, len(wanted_y))
            sign = np.where((y * wanted_y < 0) & (first > 0), -1.0, 1.0)  # the polynomials of time have either
            np.testing.assert_allclose(sign * y, wanted_y, rtol=1e-9, atol=1e-11 * np.abs(y).max())
            np.testing.assert_allclose(sign * x, wanted_x, rtol=1e-9, atol=1e-11 * np.abs(x).max())
            wanted = np.triu(np.linalg.inv(root.T @ root))
            np.testing.assert_allclose(np.outer(sign, sign) * S, wanted, rtol=1e-6, atol=1e-9 * wanted.max())
            assert freedom == pytest.approx(rows.freedom)


def test_a_comparison_that_suspects_no_joint_takes_one_operation_for_each_row() -> None:
    """A robot at rest with the noise of its sensors."""
    check, rng, operations = WiringCheck(COUPLED, ("a", "b")), np.random.default_rng(0), []
    for k in range(40):
        q, dq, u = (check._ffi.from_buffer("double[]", size * rng.normal(size=4)) for size in (1e-6, 1e-3, 0.0))
        check._lib.fjr_wiring_see(check.state, 1e-3 * k, q, dq)
        operations.append(check._lib.fjr_wiring_compare(check._model, check.state))
        check._lib.fjr_wiring_sent(check.state, u)
    assert set(operations) == {0, 4 * 2}


NUMBERS = (
    *("TOLERANCE", "SCALE", "LAGS", "LAG", "LATE", "WEIGHT", "OFFSET", "SHIFT", "ROUNDING", "DOUBT", "FREEDOM", "REST"),
    *("FEWEST", "EARLY", "RARER", "CONFIRMED", "LOADED", "EVIDENCE", "CLEARER", "FILTERED", "FAILS", "FITS", "FOLLOWS"),
    *("CLOSER", "COARSE"),
)


def test_the_numbers_of_the_check_are_those_of_its_equations() -> None:
    for name in NUMBERS:
        assert constant(name) == pytest.approx(getattr(wiring, name), rel=1e-15), name


@pytest.mark.parametrize("function", ["dynamics", "gravity"])
def test_a_window_in_which_a_function_of_the_arm_fails_is_not_compared(function: str) -> None:
    check, seen = WiringCheck(COUPLED, ("a", "b")), motion(40)
    fails = check._ffi.callback("fjr_function", lambda *_: 1)
    setattr(check._model, function, fails)
    for t, q, dq in zip(seen.t, seen.q, seen.dq, strict=True):
        assert check.see(t, q, dq) is None
    assert not any(check.state.comparison.misfit)
    assert not any(check.state.right)


@pytest.mark.parametrize("function", ["dynamics", "gravity"])
def test_a_comparison_that_goes_on_ends_without_a_fault_if_a_function_of_the_arm_fails(function: str) -> None:
    """All hypotheses have been tried, and one explains the window."""
    check = WiringCheck(COUPLED, ("a", "b"))
    fails = check._ffi.callback("fjr_function", lambda *_: 1)
    setattr(check._model, function, fails)
    state, comparison = check.state, check.state.comparison
    state.comparing, state.waiting, comparison.full, comparison.best.count = 1, 1, 1, 1
    comparison.next = 3 * 2 * 2 + 1  # sides times pairs, and all efforts
    check._lib.fjr_wiring_compare(check._model, state)
    assert not state.comparing
    assert not state.fault.count
