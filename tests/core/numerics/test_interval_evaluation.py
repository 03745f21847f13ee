# SPDX-License-Identifier: Apache-2.0
"""Interval evaluation: boxes contain the values of all points, and shrink to the value with their argument."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fjr_core.numerics.interval_evaluation import Box, enclosure

x, y = ca.SX.sym("x", 2), ca.SX.sym("y")
FUNCTION = ca.Function(
    "every_operation",
    [x, y],
    [
        ca.densify(ca.vertcat(ca.sin(x[0]) * x[1] - y, ca.cos(x[1] * y) / (2 + x[0] ** 2), -x[0] + x[0], 1 / (y + 9))),
        ca.densify(ca.jacobian(ca.sin(x) * ca.cos(y), x)),
    ],
)


def boxes(middle: np.ndarray, radius: float) -> list[Box]:
    return [Box.around(part, np.full(part.shape, radius)) for part in (middle[:2, None], middle[2:, None])]


@given(st.lists(st.floats(-8, 8), min_size=3, max_size=3), st.floats(0, 2), st.integers(0, 2**32))
def test_boxes_contain_the_values_of_every_point(middle: list[float], radius: float, seed: int) -> None:
    at = np.array(middle).clip(-6, 6)
    found = enclosure(FUNCTION, *boxes(at, radius))
    for share in np.random.default_rng(seed).uniform(-1, 1, (20, 3)):
        point = at + radius * share
        for box, value in zip(found, FUNCTION(point[:2], point[2]), strict=True):
            exact = value.full().ravel("F")
            assert np.all(box.lower[:, 0] <= exact)
            assert np.all(exact <= box.upper[:, 0])


def test_a_box_of_one_point_is_as_narrow_as_rounding() -> None:
    for box in enclosure(FUNCTION, *boxes(np.array([0.3, -1.2, 0.7]), 0.0)):
        assert np.all(box.upper - box.lower < 1e-13)


@pytest.mark.parametrize("ends", [(-0.1, 0.2), (3.0, 3.3), (0.5, 7.0), (-4.0, -3.0), (0.5, 1.0), (6.0, 13.0)])
def test_the_range_of_a_cosine_is_exact(ends: tuple[float, float]) -> None:
    angle = ca.SX.sym("angle")
    (found,) = enclosure(ca.Function("cosine", [angle], [ca.cos(angle)]), Box(*(np.array([[end]]) for end in ends)))
    values = np.cos(np.linspace(*ends, 100_001))
    assert found.lower.item() == pytest.approx(values.min(), abs=1e-8)
    assert found.upper.item() == pytest.approx(values.max(), abs=1e-8)


def test_a_divisor_that_may_vanish_is_refused() -> None:
    z = ca.SX.sym("z")
    with pytest.raises(ZeroDivisionError):
        enclosure(ca.Function("inverse", [z], [1 / z]), Box(np.array([[-1.0]]), np.array([[1.0]])))
