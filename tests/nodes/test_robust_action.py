# SPDX-License-Identifier: Apache-2.0
"""Robust action in the node: its effect on the loop and its entries in the diagnostics."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config.scenario import parse_scenario
from fjr_core.robust.law import RobustLaw
from nodes.harness import Ros, nanoseconds, read_certificate
from nodes.test_certificate import Hearer

SAMPLES = 700


def heard(ros: Ros, plant: dict[str, Any], controller: dict[str, Any], samples: int = SAMPLES) -> Hearer:
    """Run the paper's joint in lock-step for that many samples, from the start of the reference."""
    hearer = Hearer(ros, certificates=True)
    ros.controller(use_sim_time=True, compile=True, **controller)
    begin = {"initial_link_position": [0.0], "initial_motor_position": [0.0]}
    begin |= {"initial_link_velocity": [1.0], "initial_motor_velocity": [1.0]}
    ros.plant(lockstep=True, compile=True, **begin, **plant)
    ros.until(lambda: len(hearer.errors) > samples, "the samples")
    return hearer


def error(plant: dict[str, Any], controller: dict[str, Any]) -> float:
    """Return the RMS of q_l - q_ld [rad] over the last 200 samples."""
    ros = Ros()
    try:
        found = heard(ros, plant, controller).errors[SAMPLES - 200 : SAMPLES]
    finally:
        ros.close()
    return float(np.sqrt(np.mean([message.position[0] ** 2 for message in found])))


@pytest.mark.parametrize(
    ("plant", "robust", "factor"),
    [
        ({"robot__gravity_torque": [1.4]}, {"robust__residual_gain": [60.0]}, 5),
        ({"robot__gravity_torque": [1.4]}, {"robust__integral_gain": [15.0]}, 5),
        ({"imperfections__motor_coulomb_friction": [0.05]}, {"robust__motor_residual_gain": [60.0]}, 3),
        ({"imperfections__motor_coulomb_friction": [0.05]}, {"robust__motor_integral_gain": [15.0]}, 2),
        ({"imperfections__command_delay": 0.001}, {"robust__delay": 0.001}, 10),
    ],
    ids=["residual", "integral", "motor residual", "motor integral", "delay"],
)
def test_each_parameter_reduces_its_error(plant: dict[str, Any], robust: dict[str, Any], factor: float) -> None:
    plain, better = (error(plant, given) for given in ({}, robust))
    assert plain > factor * better


def test_the_hold_time_changes_the_prediction() -> None:
    found = []
    for hold in (0.001, 0.002):
        ros = Ros()
        try:
            hearer = heard(ros, {}, {"robust__delay": 0.001, "robust__hold": hold}, 50)
            found.append([command.effort[0] for command in hearer.commands[:50]])
        finally:
            ros.close()
    assert found[0] != found[1]


def test_two_runs_are_bit_identical() -> None:
    runs = []
    robust = {"robust__residual_gain": [60.0], "robust__integral_gain": [4.0], "robust__delay": 0.001}
    for _ in range(2):
        ros = Ros()
        try:
            hearer = heard(ros, {"robot__gravity_torque": [1.4]}, robust, 400)
            runs.append({nanoseconds(command): command.effort[0] for command in hearer.commands})
        finally:
            ros.close()
    both = sorted(set(runs[0]) & set(runs[1]))
    assert len(both) > 300
    assert [runs[0][stamp] for stamp in both] == [runs[1][stamp] for stamp in both]


def test_no_diagnosis_with_a_disturbance_estimate(ros: Ros) -> None:
    hearer = heard(ros, {"robot__gravity_torque": [1.4]}, {"robust__residual_gain": [60.0]})
    ros.until(lambda: len(hearer.verdicts()) > 1, "a verdict")
    assert {verdict for verdict, _ in hearer.verdicts()} == {"unknown"}
    statuses = [s for message in hearer.diagnostics for s in message.status if s.name.endswith(": certificate")]
    assert "V does not include the disturbance estimate (robust.* is enabled)" in statuses[-1].message
    _, values = read_certificate(hearer.certificates[-1])
    assert np.isfinite(values).all()
    assert values.bound == -1


def test_prediction_has_no_diagnosis_but_a_storage_with_rates(ros: Ros) -> None:
    hearer = heard(ros, {}, {"robust__delay": 0.001})
    ros.until(lambda: len(hearer.verdicts()) > 1, "a verdict")
    assert {verdict for verdict, _ in hearer.verdicts()} == {"unknown"}
    statuses = [s for message in hearer.diagnostics for s in message.status if s.name.endswith(": certificate")]
    assert statuses[-1].message == "no diagnosis: the effort is the law's for a predicted state (robust.delay)"
    _, values = read_certificate(hearer.certificates[-1])
    assert np.isfinite(values).all()
    assert values.bound == -1


def test_a_scenario_builds_the_law_of_the_parameters() -> None:
    text = "/**/fjr_controller:\n  ros__parameters:\n    robust: {residual_gain: [30.0], delay: 0.002, hold: 0.002}\n"
    scenario = parse_scenario("robust", text)
    assert isinstance(scenario.sampled_law, RobustLaw)
    assert scenario.sampled_law.robust.residual_gain == 30.0
    assert scenario.sampled_law.lead == 0.003
    assert scenario.warnings == ("fjr_controller: parameter 'robust.hold' is 0.002 s; the states' period is 0.001 s",)
    assert len(scenario.simulate(0.05).u) == 51
    slow = parse_scenario("slow", text.replace("residual_gain: [30.0], delay: 0.002", "integral_gain: [5.0]"))
    assert slow.warnings == scenario.warnings
    with pytest.raises(fjr.ParameterError, match="parameter 'robust.integral_gain': integral_gain is "):
        parse_scenario("bad", text.replace("residual_gain: [30.0]", "integral_gain: [-1.0]"))


def test_robust_parameters_are_refused_with_another_law(ros: Ros) -> None:
    text = "/**:\n  ros__parameters:\n    law: {type: pd_gravity}\n    robust: {residual_gain: [30.0]}\n"
    sentence = r"parameters 'robust\.\*' with 'law\.type' 'pd_gravity': .* for the law v_dpbc"
    with pytest.raises(fjr.ParameterError, match=sentence):
        parse_scenario("bad", text)
    with pytest.raises(fjr.ParameterError, match=sentence):
        ros.controller(law__type="pd_gravity", robust__residual_gain=[30.0])
