# SPDX-License-Identifier: Apache-2.0
"""Other laws in the node: baselines, and robust action."""

from __future__ import annotations

import numpy as np
import pytest
from rclpy.parameter import Parameter

import fjr_core as fjr
from fjr_core.config.law import control_law
from fjr_core.config.scenario import parse_scenario
from fjr_core.extensions.law_registry import LAWS
from fjr_core.robust.law import RobustLaw
from nodes.harness import Peer, Ros, read_certificate, stamped
from nodes.test_certificate import running


@pytest.mark.parametrize("name", [name for name in LAWS if name != "v_dpbc"])
def test_publishes_the_effort_of_the_selected_law_without_a_certificate(ros: Ros, peer: Peer, name: str, capfd) -> None:
    node = ros.controller(law__type=name, law__start_error=[0.5])
    law = control_law(node.values, fjr.single_link()).sampled
    memory, sent = law.memory, 0.0
    for k in range(5):
        t, position, velocity = 0.001 * k, [0.5 - 0.01 * k, 0.5 + 0.02 * k], [0.1 * k, -0.1 * k]
        command = peer.ask(stamped(t, position, velocity))
        jets, dt = fjr.Sine(1.0, 1.0).jets(t).T, 0.001 if k else 0.0
        expected, _, memory = law.step_function(position, velocity, jets, law.gain_values, memory, sent, dt)
        sent = command.effort[0]
        np.testing.assert_allclose(sent, float(expected), rtol=1e-8)
    assert f"the law {name} has no certificate: none is published" in capfd.readouterr().err
    assert node.count_publishers("fjr_controller/certificate") == 0
    (result,) = node.set_parameters([Parameter("gains.K_ld", value=[1.2])])
    assert not result.successful
    assert result.reason == f"parameters 'gains.*' are of the law v_dpbc; the law is {name}"
    assert node.set_parameters([Parameter("reference.amplitude", value=[0.5])])[0].successful


def test_gravity_hold_uses_the_motor_damping_of_the_law(ros: Ros, peer: Peer) -> None:
    node = ros.controller(
        law__type="pd_gravity", on_stop="gravity_hold", limits__tracking_error=[0.1], recovery__join_time=0.0
    )
    law = control_law(node.values, fjr.single_link())
    command = peer.ask(stamped(0.0, 0.5, [0.0, 0.3]))
    wanted = 0.8 * np.sin(0.5) - law.hold_damping[0, 0] * 0.3
    assert command.effort[0] == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("robust", "sentence"),
    [
        ({"robust__residual_gain": [60.0]}, "V does not include the disturbance estimate (robust.*"),
        ({"robust__delay": 0.001}, "no diagnosis: the effort is the law's for a predicted state (robust.delay)"),
    ],
    ids=["estimate", "prediction"],
)
def test_robust_action_has_no_diagnosis_but_a_storage_with_rates(ros: Ros, robust, sentence: str) -> None:
    hearer = running(ros, 1, {}, robust, certificates=True)
    assert {verdict for verdict, _ in hearer.verdicts()} == {"unknown"}
    assert sentence in hearer.verdict_messages()[-1]
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
    with pytest.raises(fjr.ParameterError, match="with 'law.type' 'friction_observer': .* of 0"):
        parse_scenario("bad", text.replace("robust:", "law: {type: friction_observer}\n    robust:"))
