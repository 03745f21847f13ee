# SPDX-License-Identifier: Apache-2.0
"""Measured signals: the options, and positions behind gears or from joint torques."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config.controller import BANDWIDTH, measurement, measurement_parameters, observer
from fjr_core.config.parameter import Values, complete
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.safety_settings import Settings
from fuzzing import refused
from tracking.tracked import TWO as LAW

K = np.array([[20.0, 4.0], [4.0, 10.0]])


def step_with(measurement: fjr.Measurement) -> ControlStep:
    observer = fjr.VelocityObserver(LAW.robot, 300.0) if measurement.observed else None
    reference = fjr.Sine([0.1, 0.1], 1.0)
    return ControlStep(LAW, reference, Settings(("a", "b")), observer, measurement=measurement)


def test_motor_angles_are_divided_by_the_gear_ratio_or_follow_from_the_joint_torques() -> None:
    step = step_with(fjr.Measurement(2, gear_ratio=np.array([100.0, -50.0])))
    given = ([1.0, 2.0], [200.0, -3.0], [5.0, 6.0], [400.0, 30.0])
    assert step.step(0, 0, *(np.array(values) for values in given))
    assert step.position.tolist() == [1.0, 2.0, 2.0, 0.06]
    assert step.velocity.tolist() == [5.0, 6.0, 4.0, -0.6]
    step, torque = step_with(fjr.Measurement(2, "observer", "torque", K=K)), np.array([3.0, -2.0])
    assert step.step(0, 0, np.array([1.0, 2.0]), torque, None, None)
    np.testing.assert_allclose(K @ (step.position[2:] - step.position[:2]), torque, rtol=1e-14)


SOFT, GEARED = fjr.Measurement(2, "observer", "torque", K=1e-3 * K), fjr.Measurement(2, gear_ratio=1e-3)
OVERFLOWS = {"torque": (SOFT, 1e308, 0.0), "angle": (GEARED, 1e308, 0.0), "velocity": (GEARED, 1.0, 1e308)}


@pytest.mark.parametrize("what", OVERFLOWS)
def test_a_conversion_that_overflows_gets_the_stop_effort(what: str) -> None:
    measurement, motor, dq_m = OVERFLOWS[what]
    step, rest = step_with(measurement), np.zeros(2)
    assert step.step(0, 0, rest, rest + motor, rest, rest + dq_m)
    assert step.controller.journal.count[step.lib.FJR_EFFORTS_NOT_FINITE] == 1
    assert not step.u.any()


ROBOT = fjr.planar_two_link(stiffness=(40.0, 30.0))


def values(**given: object) -> Values:
    own = {f"measurement.{name}": value for name, value in given.items()}
    return {**complete(measurement_parameters(2), own), "compile": False}


def test_options_reach_measurement_and_observer() -> None:
    default = measurement(values(), ROBOT)
    assert (default.velocity, default.motor) == ("measured", "position")
    assert observer(values(), ROBOT) is None
    given = values(velocity="observer", observer_bandwidth=80.0, motor="torque")
    found = measurement(given, ROBOT)
    assert (default.observed, default.by_torque, found.observed, found.by_torque) == (False, False, True, True)
    np.testing.assert_array_equal(found.K, np.diag([40.0, 30.0]))
    assert observer(given, ROBOT).bandwidth == 80.0
    assert observer(values(velocity="observer"), ROBOT).bandwidth == BANDWIDTH
    np.testing.assert_array_equal(measurement(values(gear_ratio=[100.0, -50.0]), ROBOT).gear_ratio, [100.0, -50.0])


BEHIND_GEAR = {"motor": "torque", "velocity": "observer", "gear_ratio": [2.0, 1.0]}
REFUSED = [
    ({"motor": "torque"}, "measurement.velocity is 'measured'", "expected 'observer'"),
    (BEHIND_GEAR, "measurement.gear_ratio is [2.0, 1.0]", "expected 1"),
    ({"gear_ratio": [0.0, 1.0]}, "measurement.gear_ratio is [0.0, 1.0]; expected no zeros"),
    ({"gear_ratio": [1.0, 1.0, 1.0]}, "has length 3; expected 2"),
    ({"velocity": "guessed"}, "expected one of measured, observer"),
    ({"motor": "none"}, "expected one of position, torque"),
    ({"observer_bandwidth": 0.0}, "expected 1.0 to 10000.0"),
]


def test_inconsistent_measurements_are_refused_in_one_sentence() -> None:
    for given, *words in REFUSED:
        refused(fjr.ParameterError, lambda given=given: measurement(values(**given), ROBOT), *words)
    refused(fjr.ParameterError, lambda: fjr.Measurement(1, velocity="some"), "velocity is 'some'; expected one of")
    refused(fjr.ParameterError, lambda: fjr.Measurement(1, "observer", "torque"), "expected the joint stiffness")
