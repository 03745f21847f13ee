# SPDX-License-Identifier: Apache-2.0
"""The step reads motor angles before a gear, or joint torques, as the motor positions q_m."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.safety_settings import Settings
from tracking.tracked import two_link_law

LAW = two_link_law()
K = np.array([[20.0, 4.0], [4.0, 10.0]])


def step_with(measurement: fjr.Measurement) -> ControlStep:
    observer = fjr.VelocityObserver(LAW.robot, 300.0) if measurement.observed else None
    reference = fjr.Sine([0.1, 0.1], 1.0)
    return ControlStep(LAW, reference, Settings(("a", "b")), observer, measurement=measurement)


def test_motor_angles_and_velocities_are_divided_by_the_gear_ratio() -> None:
    step = step_with(fjr.Measurement(2, gear_ratio=np.array([100.0, -50.0])))
    given = ([1.0, 2.0], [200.0, -3.0], [5.0, 6.0], [400.0, 30.0])
    assert step.step(0, 0, *(np.array(values) for values in given))
    assert step.position.tolist() == [1.0, 2.0, 2.0, 0.06]
    assert step.velocity.tolist() == [5.0, 6.0, 4.0, -0.6]


def test_motor_positions_follow_from_the_joint_torques() -> None:
    step, torque = step_with(fjr.Measurement(2, "observer", "torque", K=K)), np.array([3.0, -2.0])
    assert step.step(0, 0, np.array([1.0, 2.0]), torque, None, None)
    np.testing.assert_allclose(K @ (step.position[2:] - step.position[:2]), torque, rtol=1e-14)


@pytest.mark.parametrize(
    ("measurement", "motor", "dq_m"),
    [
        (fjr.Measurement(2, "observer", "torque", K=1e-3 * K), 1e308, 0.0),
        (fjr.Measurement(2, gear_ratio=1e-3), 1e308, 0.0),
        (fjr.Measurement(2, gear_ratio=1e-3), 1.0, 1e308),
    ],
    ids=["torque", "angle", "velocity"],
)
def test_a_conversion_that_overflows_gets_the_stop_effort(
    measurement: fjr.Measurement, motor: float, dq_m: float
) -> None:
    step, rest = step_with(measurement), np.zeros(2)
    assert step.step(0, 0, rest, rest + motor, rest, rest + dq_m)
    assert step.controller.journal.count[step.lib.FJR_EFFORTS_NOT_FINITE] == 1
    assert not step.u.any()
