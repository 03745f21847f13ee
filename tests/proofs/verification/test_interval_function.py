# SPDX-License-Identifier: Apache-2.0
"""Values of CasADi functions lie in their enclosures on boxes, also where rounding decides."""

from __future__ import annotations

import casadi as ca
import mpmath
import numpy as np
import pytest

from fjr_core.errors import StateError
from fjr_core.numerics.intervals import Interval
from fjr_proofs.verification.interval_function import IntervalFunction


def example(x: list, sin, cos) -> list:  # type: ignore[no-untyped-def, type-arg]
    a, b, c = x
    first = sin(a * b) / (2 + c * c) - cos(b + b) * a
    return [first, 1 / (3 + first) - (-c) * c * c, a + 0.1, first]


def enclosing() -> IntervalFunction:
    x = ca.SX.sym("x", 3)
    return IntervalFunction(ca.Function("f", [x], [ca.vertcat(*example(ca.vertsplit(x), ca.sin, ca.cos))]))


def test_values_at_points_in_the_boxes_lie_in_the_enclosures() -> None:
    rng = np.random.default_rng(0)
    box = Interval(rng.uniform(-1, 1, (3, 50)), rng.uniform(0, 0.2, (3, 50)))
    found = enclosing()(box)[0]
    for _ in range(20):
        x = box.mid + rng.uniform(-1, 1, box.mid.shape) * box.rad
        values = np.array(example(list(x), np.sin, np.cos))
        assert np.all(np.abs(values - found.mid) <= found.rad)


def test_exact_values_lie_in_the_enclosures_of_single_points() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-1, 1, (3, 40))
    found = enclosing()(Interval.exact(points))[0]
    with mpmath.workdps(40):
        for k, point in enumerate(points.T):
            exact = example([mpmath.mpf(v) for v in point], mpmath.sin, mpmath.cos)
            exact[2] = mpmath.mpf(point[0]) + mpmath.mpf(0.1)
            for i, value in enumerate(exact):
                assert abs(value - mpmath.mpf(found.mid[i, k])) <= mpmath.mpf(found.rad[i, k])
    assert found.rad.max() < 1e-13


def test_unknown_operations_and_divisors_around_zero_are_refused() -> None:
    x = ca.SX.sym("x")
    with pytest.raises(StateError, match=r"contains OP_EXP; expected OP_ADD"):
        IntervalFunction(ca.Function("f", [x], [ca.exp(x)]))
    with np.errstate(divide="ignore"), pytest.raises(ZeroDivisionError):
        IntervalFunction(ca.Function("f", [x], [1 / x]))(Interval(np.zeros((1, 1)), np.ones((1, 1))))
