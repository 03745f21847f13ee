# SPDX-License-Identifier: Apache-2.0
"""Robust action in the tracker and in the node: when its memory goes on, what it does to a loop, what is said of it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_controller.tracking.tracker import Tracker
from fjr_core.config.scenario import parse_scenario
from fjr_core.control.robust import Robust, RobustLaw
from fjr_msgs_py.messages.certificate import read_certificate
from nodes.harness import Ros, nanoseconds
from nodes.test_certificate import Hearer
from tracking.tracked import PERIOD, Loop, paper_law, sample, settings, two_link_law

MS = 1_000_000
SAMPLES = 700
LAW, SINE = paper_law(), fjr.Sine(1.0, 1.0)
ROBUST = Robust(residual_gain=60.0, motor_residual_gain=20.0, integral_gain=4.0, delay=1e-3)


def tracker(robust: Robust = ROBUST, **given: Any) -> Tracker:
    return Tracker(LAW, SINE, settings(**given), robust=robust)


def memory(of: Tracker) -> np.ndarray:
    """What the law is asked with."""
    assert of._memory is not None
    return of._memory._step.memory


def answers(of: Tracker, stamps: Any, **more: Any) -> list[float]:
    """Efforts for samples of a motion that is nobody's."""
    efforts = []
    for stamp in stamps:
        t = stamp * 1e-9
        command = of.answer(sample(stamp, 0.5 + 0.1 * np.sin(9 * t), 0.5 + 0.1 * np.sin(9 * t + 0.1), **more), stamp)
        assert command is not None
        efforts.append(float(command.u[0]))
    return efforts


@pytest.mark.parametrize("law", [LAW, two_link_law()], ids=["joint", "two_link"])
def test_the_loop_is_that_of_the_simulation(law: fjr.TrackingLaw) -> None:
    n = law.robot.n
    x0 = law.robot.state(np.full(n, 0.2), np.full(n, 0.2), np.zeros(n), np.zeros(n))
    reference = fjr.Sine(np.full(n, 0.5), np.full(n, 2.0))
    loop = Loop(law, reference, settings(n), x0, robust=ROBUST)
    loop.run(0.3)
    run = fjr.simulate(fjr.Plant(law.robot), RobustLaw(law, ROBUST), reference, x0, 0.2999, PERIOD * 1e-9)
    np.testing.assert_allclose(np.array(loop.efforts), run.u, rtol=1e-6, atol=1e-8)
    plain = fjr.simulate(fjr.Plant(law.robot), law, reference, x0, 0.2999, PERIOD * 1e-9)
    assert np.max(np.abs(run.u - plain.u)) > 1e-2


def test_a_repeated_or_an_older_sample_moves_nothing() -> None:
    one, other = tracker(), tracker()
    wanted = answers(one, range(0, 40 * MS, MS))
    found = answers(other, range(0, 20 * MS, MS))
    again = answers(other, [19 * MS, 19 * MS])
    assert again == [found[-1]] * 2
    assert other.answer(sample(5 * MS, 0.1, 0.1), 19 * MS) is None
    assert found + answers(other, range(20 * MS, 40 * MS, MS)) == wanted


@pytest.mark.parametrize("stamp", [0, 2_000 * MS, 90_000 * MS], ids=["jump back", "silence", "jump forward"])
def test_after_a_break_nothing_is_remembered(stamp: int) -> None:
    of = tracker(recovery_join_time=0.0)
    answers(of, range(1000 * MS, 1040 * MS, MS))
    assert memory(of).any()
    for arrival in (3_000 * MS, 3_001 * MS):
        assert of.answer(sample(stamp + arrival - 3_000 * MS, 0.5, 0.5), arrival) is not None
        assert not memory(of).any() or arrival > 3_000 * MS
        assert of._memory._step.dt[0] == (0.0 if arrival == 3_000 * MS else 1e-3)  # type: ignore[union-attr]


def test_with_other_gains_the_memory_goes_on() -> None:
    """A load that was learnt stays so: no step of the effort, and the law's own is not the one that knew nothing."""
    of, gains = tracker(), replace(fjr.PAPER_GAINS, Pi_l=20.001)
    efforts = answers(of, range(0, 400 * MS, MS))
    learnt = of._memory._step.next.copy()  # type: ignore[union-attr]
    of.use(LAW.with_gains(gains))
    efforts += answers(of, [400 * MS])
    np.testing.assert_array_equal(memory(of), learnt)
    steps = np.abs(np.diff(efforts[-12:]))
    assert steps[-1] < 2 * steps[:-1].max()


def test_a_repeated_sample_after_other_gains_is_asked_about_as_it_was() -> None:
    of = tracker()
    found = answers(of, range(0, 40 * MS, MS))
    of.use(LAW.with_gains(fjr.PAPER_GAINS))
    assert answers(of, [39 * MS]) == found[-1:]


def test_gains_that_are_too_large_are_told_with_the_robust_ones() -> None:
    of = tracker()
    with pytest.raises(fjr.GainsError, match=r"'gains\.\*' and 'robust\.\*' give an effort that is not finite"):
        of.use(LAW.with_gains(fjr.Gains(Lambda_l=1e200, Pi_l=1e100, K_ld=1.0, Lambda_m=1e200, Pi_m=1e100, K_md=1.0)))


def test_a_lower_limit_does_not_change_what_acted() -> None:
    of = tracker()
    u = answers(of, range(0, 10 * MS, MS))[-1]
    assert abs(u) > 0.01
    of.settings(settings(effort=(0.01,)))
    answers(of, [10 * MS])
    assert of._memory._step.sent[0] == u  # type: ignore[union-attr]


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e200])
def test_what_is_not_finite_never_leaves_and_is_forgotten(bad: float) -> None:
    of = tracker()
    answers(of, range(0, 40 * MS, MS))
    command = of.answer(sample(40 * MS, bad, 0.5), 40 * MS)
    assert command is not None
    assert np.isfinite(command.u).all()
    efforts = answers(of, range(41 * MS, 60 * MS, MS))
    assert np.isfinite(efforts).all()
    assert np.isfinite(memory(of)).all()


def test_the_memory_moves_on_by_the_effort_that_left() -> None:
    of = tracker(effort=(0.5,), effort_rate=(100.0,))
    answers(of, range(0, 10 * MS, MS))
    for stamp in range(10 * MS, 15 * MS, MS):
        before = of._efforts.sent.copy()
        answers(of, [stamp])
        np.testing.assert_array_equal(of._memory._step.sent, before)  # type: ignore[union-attr]
        assert abs(before[0]) <= 0.5


def test_while_stopped_nothing_is_remembered() -> None:
    of = tracker(tracking_error=(0.4,))
    answers(of, range(0, 40 * MS, MS))
    of.answer(sample(40 * MS, -1.0, -1.0), 40 * MS)
    assert of.reason
    of.resume()
    of.answer(sample(41 * MS, 0.5, 0.5), 41 * MS)
    assert of._memory._step.dt[0] == 0  # type: ignore[union-attr]


# --- over ROS


def heard(ros: Ros, plant: dict[str, Any], controller: dict[str, Any], samples: int = SAMPLES) -> Hearer:
    """The paper's joint in lock-step for that many samples, from where the reference begins."""
    hearer = Hearer(ros, certificates=True)
    ros.controller(use_sim_time=True, compile=True, **controller)
    begin = {"initial_link_position": [0.0], "initial_motor_position": [0.0]}
    begin |= {"initial_link_velocity": [1.0], "initial_motor_velocity": [1.0]}
    ros.plant(lockstep=True, compile=True, **begin, **plant)
    ros.until(lambda: len(hearer.errors) > samples, "the samples")
    return hearer


def error(plant: dict[str, Any], controller: dict[str, Any]) -> float:
    """Root of the mean square of q_l - q_ld [rad] over the last of them."""
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
def test_each_parameter_does_what_it_says(plant: dict[str, Any], robust: dict[str, Any], factor: float) -> None:
    plain, better = (error(plant, given) for given in ({}, robust))
    assert plain > factor * better


def test_the_period_of_the_states_counts() -> None:
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


def test_the_certificate_says_that_it_is_not_judged(ros: Ros) -> None:
    hearer = heard(ros, {"robot__gravity_torque": [1.4]}, {"robust__residual_gain": [60.0]})
    ros.until(lambda: len(hearer.verdicts()) > 1, "a verdict")
    assert {verdict for verdict, _ in hearer.verdicts()} == {"unknown"}
    statuses = [s for message in hearer.diagnostics for s in message.status if s.name.endswith(": certificate")]
    assert "counts on torques beside its model (robust.*)" in statuses[-1].message
    _, values = read_certificate(hearer.certificates[-1])
    assert np.isfinite(values).all()
    assert values.bound == -1


def test_prediction_alone_has_a_storage_and_its_rates(ros: Ros) -> None:
    hearer = heard(ros, {}, {"robust__delay": 0.001})
    ros.until(lambda: len(hearer.verdicts()) > 1, "a verdict")
    assert {verdict for verdict, _ in hearer.verdicts()} == {"unknown"}
    statuses = [s for message in hearer.diagnostics for s in message.status if s.name.endswith(": certificate")]
    assert statuses[-1].message == "no diagnosis: the effort is the law's for a predicted state (robust.delay)"
    _, values = read_certificate(hearer.certificates[-1])
    assert np.isfinite(values).all()
    assert values.bound == -1


def test_a_scenario_builds_what_the_parameters_say() -> None:
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


def test_a_law_that_takes_no_robust_action_is_told_with_the_parameters(ros: Ros) -> None:
    text = "/**:\n  ros__parameters:\n    law: {type: pd_gravity}\n    robust: {residual_gain: [30.0]}\n"
    sentence = r"parameters 'robust\.\*' with 'law\.type' 'pd_gravity': .* for the law v_dpbc"
    with pytest.raises(fjr.ParameterError, match=sentence):
        parse_scenario("bad", text)
    with pytest.raises(fjr.ParameterError, match=sentence):
        ros.controller(law__type="pd_gravity", robust__residual_gain=[30.0])
