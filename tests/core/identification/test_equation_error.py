# SPDX-License-Identifier: Apache-2.0
"""Filtered least squares stand in for a simulation that does not fit, with intervals of their own and without trust."""

from __future__ import annotations

import numpy as np
import pytest

from core.identification.test_identify import NOISE, found_in, noisy, robot_like
from core.oracles.elastic_joint import ElasticJoint, usual_record
from fjr_core.identification import gauss_newton
from fjr_core.identification.equation_error import LINK, MOTOR, equation_error
from fjr_core.identification.estimation_problem import Estimation
from fjr_core.identification.parameters import Options, Prior
from fjr_core.identification.result import UNKNOWN, WEAK

JOINT = ElasticJoint()


def setup_of(noise: float = NOISE) -> Estimation:
    robot = robot_like(JOINT)
    return Estimation([noisy(*usual_record(), 4e-3, noise=noise)], robot, Prior.of(robot), Options())


def test_a_fit_that_does_not_converge_gives_way_to_filtered_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gauss_newton, "MOST_ITERATIONS", 0)
    found = found_in(noisy(*usual_record(), 4e-3), JOINT)
    assert {each.verdict for each in found.values()} <= {WEAK, UNKNOWN}
    stiffness = found["joint_stiffness"]
    assert stiffness.verdict == WEAK
    assert "filtered least squares" in stiffness.reason
    assert stiffness.low < JOINT.K < stiffness.high
    assert stiffness.value == pytest.approx(JOINT.K, rel=0.05)


def test_steps_are_short_on_both_sides_wherever_the_start_puts_the_friction() -> None:
    setup = setup_of()
    motions, start = setup.start()
    parts = []
    for link, motor in ((0.1, 0.0), (0.0, 0.1)):
        values = {**start, "link_coulomb_friction": np.array([link]), "motor_coulomb_friction": np.array([motor])}
        parts.append(setup.problem(setup.coordinates, values, motions).segments[0].effort.slow_parts)
    np.testing.assert_array_equal(*parts)
    assert np.all(parts[0] > 1)


def test_blocks_add_up_to_the_information_of_the_record() -> None:
    setup = setup_of()
    motions, start = setup.start()
    z, names = setup.coordinates.of_values(start), [name for name, _ in setup.coordinates.free]
    parts = equation_error(setup, motions, z)
    H, g = sum(part.H for part in parts), sum(part.g for part in parts)
    link, motor = ([names.index(name) for name in side] for side in (LINK, MOTOR))
    assert len(parts) == 4
    assert not np.any(H[np.ix_(link[2:], motor[:4])])
    assert np.all(np.diag(H) > 0)
    step = np.linalg.solve(H[np.ix_(motor[:3], motor[:3])], g[motor[:3]])
    assert np.all(np.abs(step) < 1e-3 * setup.coordinates.width[motor[:3]])
