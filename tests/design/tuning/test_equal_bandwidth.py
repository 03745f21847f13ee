# SPDX-License-Identifier: Apache-2.0
"""Tuning of all laws to equal bandwidth: measured quantities agree with closed forms, and the rule is met."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import fjr_core as fjr
from core.oracles.cases import Arm, planar
from core.oracles.chains import arm7
from core.oracles.plain_loop import OTHERS
from fjr_core.config.scenario import Scenario, load_scenario, parse_scenario
from fjr_core.extensions.law_registry import LAWS
from fjr_core.law.gains import FASTEST_RATE, two_scale_gains
from fjr_core.law.interfaces import StaticLaw
from fjr_core.law.linearized import rest_position, slope_at_rest
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.planar_arms import urdf_of_links
from fjr_design.baselines import feedback_linearisation
from fjr_design.batch import ClosedLoop
from fjr_design.studies.trial import Trial, motion_demand
from fjr_design.tuning.equal_bandwidth import BaselineTarget, Tuning, baseline_target, tune, tuning
from fjr_msgs_py.scenarios import library
from fuzzing import refused


@cache
def joint(stiffness: float = 31.0) -> BaselineTarget:
    """Return the target of the paper's joint and initial state."""
    robot, start = fjr.single_link(stiffness=stiffness), (np.array([0.5, 0.5]), np.zeros(2))
    return BaselineTarget(robot, fjr.Sine(1.0, 1.0), fjr.PAPER_GAINS, start)


@cache
def two_link() -> BaselineTarget:
    return baseline_target(library.load("two_link", []))


CASES = {"k = 31": joint, "two links": two_link}
REACHED = {"pd_gravity", "pd_feedforward", "feedback_linearisation", "lqr", "friction_observer", "active_disturbance"}
CUT = {"backstepping", "torque_feedback", "torque_feedback_feedforward"}
cases = pytest.mark.parametrize("case", CASES)
names = pytest.mark.parametrize("name", OTHERS)


@cache
def found(case: str, name: str) -> Tuning:
    return tune(name, CASES[case]())


@cases
@names
def test_bandwidths_are_equal_and_peak_efforts_equal_where_reachable(case: str, name: str) -> None:
    t, y = found(case, name), CASES[case]()
    assert t.same_bandwidth
    assert "the same bandwidth" in t.sentence
    assert t.bandwidth == pytest.approx(y.bandwidth, rel=0.01)
    assert t.same_peak == (name in REACHED)
    assert ("saturated" in t.sentence) == (name in CUT)
    if t.same_peak:
        assert t.peak == pytest.approx(y.peak, rel=0.1)
    low, high = t.kind.damping_range
    assert low * 0.99 <= t.damping <= high * 1.01


@cases
@names
def test_peak_effort_of_the_run_is_the_first_effort(case: str, name: str) -> None:
    t, y = found(case, name), CASES[case]()
    x0 = y.robot.state(*np.split(y.start[0], 2), *np.split(y.start[1], 2))
    run = fjr.simulate(fjr.Plant(y.robot), t.law, y.reference, x0, 1.0, 1e-3)
    assert np.abs(run.u).max() == pytest.approx(t.peak, rel=0.02)


def half_the_elastic_mode(robot: fjr.Robot) -> float:
    """Return half the elastic mode of one joint with free link and motor [rad/s]."""
    inertia = 1 / (1 / robot.M_l(np.zeros(1))[0, 0] + 1 / robot.M_m[0, 0])
    return float(np.sqrt(robot.K[0, 0] / inertia) / 2)


@pytest.mark.parametrize("omega_zeta", [(20.0, 0.7), (35.0, 1.0), (50.0, 0.5)])
def test_bandwidth_agrees_with_the_closed_form(omega_zeta: tuple[float, float]) -> None:
    """Feedback linearisation: T(s) = A_0 / (s^4 + A_3 s^3 + A_2 s^2 + A_1 s + A_0), in two quadratic factors."""
    y, kind = joint(), LAWS["feedback_linearisation"]
    law = kind.make(y.robot, kind.tuning_rule(y.robot, y.q_0, *omega_zeta))
    omega, zeta = omega_zeta
    frequencies = np.linspace(1.0, 140.0, 400_000)
    s = 1j * frequencies
    fast = max(half_the_elastic_mode(y.robot), omega)
    factors = [(fast, feedback_linearisation.FAST_DAMPING), (omega, zeta)]
    gain = np.abs(np.prod([w**2 / (s**2 + 2 * d * w * s + w**2) for w, d in factors], axis=0))
    wanted = frequencies[np.argmax(gain < 2**-0.5)]
    assert y.bandwidth_of(law) == pytest.approx(wanted, rel=1e-3)


@pytest.mark.parametrize("name", ["v_dpbc", "feedback_linearisation", "torque_feedback", "active_disturbance"])
def test_closed_loop_gain_at_the_bandwidth_is_0p7(name: str) -> None:
    """SciPy integrates the nonlinear loop with q_ld = a sin(w t) and zero derivatives."""
    y = joint()
    law, w, a = found("k = 31", name).law if name != "v_dpbc" else y.law, y.bandwidth, 1e-3
    plant = fjr.Plant(y.robot)

    def field(t: float, x: np.ndarray) -> np.ndarray:
        jets = np.zeros((5, 1))
        jets[0] = a * np.sin(w * t)
        return plant.derivative(x, law.command(x, jets))

    turns = 2 * np.pi / w * np.linspace(12, 16, 400)  # transients have decayed: the slowest rate is 4 1/s
    solution = solve_ivp(field, (0.0, turns[-1]), np.zeros(4), t_eval=turns, rtol=1e-7, atol=1e-10, method="Radau")
    amplitude = np.abs(np.ptp(solution.y[0])) / 2
    assert amplitude / a == pytest.approx(2**-0.5, rel=0.03)


def test_slopes_are_derivatives_of_the_effort() -> None:
    y = two_link()
    law = found("two links", "backstepping").law
    F, G = slope_at_rest(law, y.q_0)
    position, h = rest_position(y.robot, y.q_0), 1e-6
    jets = np.zeros((5, 2))
    jets[0] = y.q_0

    def effort(z: np.ndarray) -> np.ndarray:
        moved = jets.copy()
        moved[0] += z[8:]
        return law.measured_command(position + z[:4], z[4:8], moved)[0]

    columns = np.array([(effort(h * e) - effort(-h * e)) / (2 * h) for e in np.eye(10)]).T
    np.testing.assert_allclose(np.hstack([F, G]), columns, rtol=1e-5, atol=1e-5 * np.abs(columns).max())


def test_the_target_is_v_dpbc_with_the_given_gains() -> None:
    y = joint()
    t = tune("v_dpbc", y)
    assert t.same_bandwidth
    assert t.same_peak
    assert t.peak == pytest.approx(26.203, abs=1e-3)
    assert y.effort_limit == pytest.approx([26.203], abs=1e-3)  # of all commands
    assert isinstance(t.law, TrackingLaw)
    np.testing.assert_array_equal(t.law.gains.Pi_m, [[60.0]])
    assert t.sentence == "tuning target, with the gains of the scenario"


def test_effort_limit_without_initial_error_exceeds_the_demand_of_the_reference() -> None:
    robot, reference = fjr.single_link(), fjr.Sine(1.0, 2.0)
    on = (np.zeros(2), np.array([2.0, 2.0]))
    y = BaselineTarget(robot, reference, fjr.PAPER_GAINS, on)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    run = fjr.simulate(fjr.Plant(robot), law, reference, robot.state(0.0, 0.0, 2.0, 2.0), 5.0, 1e-3)
    assert y.effort_limit[0] >= 1.15 * np.abs(run.u[2000:]).max()


@pytest.mark.parametrize("name", ["pd_gravity", "torque_feedback", "singular_perturbation"])
def test_law_slower_than_the_target_is_reported(name: str) -> None:
    """On the soft joint of the paper, link and spring limit the bandwidth of motor-side laws."""
    t = tune(name, joint(3.1))
    assert not t.same_bandwidth
    assert t.bandwidth < 0.9 * t.target.bandwidth
    assert "the largest possible" in t.sentence
    assert np.linalg.eigvals(joint(3.1).loop(t.law)[0]).real.max() < 0


def test_motor_side_laws_are_refused_if_springs_cannot_balance_gravity() -> None:
    arm: Arm = planar("soft", 3.1)
    y = BaselineTarget(arm.robot, fjr.Sine([0.5, 0.5], 1.0), two_link().gains)
    with pytest.raises(fjr.GainsError, match="pd_gravity is unstable for all natural frequencies"):
        tune("pd_gravity", y)
    assert tune("feedback_linearisation", y).same_bandwidth


ARM7_OFFSET = np.array([0.0, 0.5, 0.2, -1.2, -0.2, 0.8, 0.4])


def test_feedback_linearisation_with_two_time_scales_tracks_seven_joints() -> None:
    """The run takes 2 s at 1 kHz with the bandwidth of v-dPBC; four equal poles would leave tens of mrad."""
    arm, rate = arm7(), 14.0
    reference = fjr.Sine(np.full(7, 0.3), np.pi, ARM7_OFFSET, np.pi / 2)
    M = arm.robot.M_l(reference.jets(0.0)[0])
    gains = fjr.Gains(rate, rate**2 * M, rate * M, rate, np.diag(arm.K), rate * np.diag(arm.M_m))
    y = BaselineTarget(arm.robot, reference, gains)
    t = tune("feedback_linearisation", y)
    assert t.same_bandwidth
    x0 = arm.robot.state(*np.split(rest_position(arm.robot, y.q_0), 2), np.zeros(7), np.zeros(7))
    loop = ClosedLoop(arm.robot, t.law, reference, x0, 2.0, 1e-3, settle_after=1.0)
    nominal = Trial(loop, motion_demand(arm.robot, reference), y.effort_limit).metrics([{}])[0]
    assert nominal["rms"] < 5e-4  # rad


def least_damping(y: BaselineTarget, law: StaticLaw) -> float:
    """Return the smallest damping ratio of the linearised closed loop."""
    poles = np.linalg.eigvals(y.loop(law)[0])
    return float((-poles.real / np.abs(poles)).min())


def test_tuned_v_dpbc_doubles_the_damping_of_the_elastic_mode() -> None:
    """The reference is a stiff joint with K_md = beta M_m at equal bandwidth."""
    robot, beta = fjr.single_link(stiffness=3000.0, link_inertia=0.5, motor_inertia=0.2), 14.0
    M_l = robot.M_l(np.zeros(1))
    gains = fjr.Gains(beta, beta**2 * M_l, beta * M_l, beta, robot.K, beta * robot.M_m)
    y = BaselineTarget(robot, fjr.Sine(0.3, np.pi), gains)
    t = tune("v_dpbc", y, retune=True)
    assert isinstance(t.law, TrackingLaw)
    assert t.same_bandwidth
    assert t.sentence.startswith("the same bandwidth")
    assert least_damping(y, t.law) > 2 * least_damping(y, y.law)
    assert tune("v_dpbc", y).law is not t.law


def test_sample_rate_bounds_the_motor_damping_of_v_dpbc() -> None:
    robot = fjr.single_link(stiffness=3000.0, motor_inertia=0.2, motor_damping=0.01)
    for sample_period in (1e-3, 1e-2):
        gains = two_scale_gains(robot, np.zeros(1), 10.0, 0.3, sample_period)
        rate = float(np.asarray(gains.K_md)[0, 0] + 0.01) / 0.2
        assert rate == pytest.approx(min(0.6 * np.sqrt(3000.0 / 0.2), FASTEST_RATE / sample_period))
    with pytest.raises(fjr.GainsError, match=r"D_m damps the motors more than the damping ratio 0.3"):
        two_scale_gains(fjr.single_link(stiffness=31.0, motor_damping=50.0), np.zeros(1), 10.0, 0.3)


# --- parameters


def scenario(law: str) -> Scenario:
    return parse_scenario("one", f"/**/fjr_controller: {{ros__parameters: {{compile: false, law: {law}}}}}")


@pytest.mark.parametrize("name", ["lqr", "torque_feedback", "friction_observer"])
def test_law_type_selects_the_law_with_its_tuned_gains(name: str) -> None:
    made = scenario(f"{{type: {name}, start_error: [0.5]}}")
    np.testing.assert_allclose(made.law.gain_values, found("k = 31", name).law.gain_values, rtol=1e-9)
    with pytest.raises(fjr.ParameterError, match=f"'law.type' is '{name}'; expected 'v_dpbc'"):
        _ = made.tracking_law


def test_frequency_damping_and_sample_rate_set_the_gains_if_not_tuned() -> None:
    """The fast poles are half the elastic mode, or slower where the sample rate bounds them."""
    omega, zeta = 30.0, 0.5
    given = f"type: feedback_linearisation, tuned: false, natural_frequency: {omega}, damping_ratio: {zeta}"
    for rate in (1e3, 100.0):
        made = scenario(f"{{{given}, sample_rate: {rate}}}")
        fast = min(half_the_elastic_mode(made.robot), feedback_linearisation.FASTEST_POLE * rate)
        A = made.law.arrays  # type: ignore[attr-defined]
        assert A["A_0"] == pytest.approx((omega * fast) ** 2)
        assert A["A_3"] == pytest.approx(2 * zeta * omega + 2 * feedback_linearisation.FAST_DAMPING * fast)
    assert fast < half_the_elastic_mode(made.robot)


FILES = """
/**:
  ros__parameters:
    joints: [a]
    robot: {model: urdf, urdf: arm.urdf, joint_stiffness: [100.0], motor_inertia: [0.02], link_damping: [0.1],
            motor_damping: [0.02]}
    gains: {Lambda_l: [10.0], Pi_l: [20.0], K_ld: [2.0], Lambda_m: [10.0], Pi_m: [100.0], K_md: [0.5]}
    reference: {type: file, file: {path: motion.csv}}
    law: {type: pd_gravity}
    compile: false
"""


@pytest.mark.parametrize("changes", ["arm.urdf", "motion.csv"])
def test_a_file_that_changes_under_its_name_is_tuned_anew(changes: str, tmp_path: Path) -> None:
    """A notebook loads the same scenario again after the URDF, or the motion, was edited."""
    for mass, start in ((1.0, 0.0), (3.0, 1.0)):
        heavier = mass if changes == "arm.urdf" else 1.0
        links = fjr.single_link(link_inertia=0.08 * heavier, gravity_torque=2.5 * heavier).links
        (tmp_path / "arm.urdf").write_text(urdf_of_links("arm", ["a"], links.bodies))
        place = start if changes == "motion.csv" else 0.0
        rows = (f"{t:.2f},{place + 0.2 * np.sin(t) ** 4}" for t in np.arange(0.0, 4.0, 0.05))
        (tmp_path / "motion.csv").write_text("time,a\n" + "\n".join(rows) + "\n")
        (tmp_path / "one.yaml").write_text(FILES)
        made = load_scenario(tmp_path / "one.yaml")
        wanted = tune("pd_gravity", baseline_target(made)).law
        np.testing.assert_allclose(made.law.gain_values, wanted.gain_values, rtol=1e-9)


def test_start_error_changes_the_tuning() -> None:
    dampings = [
        tuning(scenario(f"{{type: lqr, start_error: [{error}]}}").controller_values).damping for error in (0.1, 0.5)
    ]
    assert abs(dampings[0] - dampings[1]) > 1e-3


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("{type: pid}", "law.type' is 'pid'; expected one of v_dpbc"),
        ("{type: lqr, start_error: [0.1, 0.2]}", "law.start_error' has length 2; expected 1"),
        ("{natural_frequency: -1.0}", "law.natural_frequency' holds -1.0"),
        ("{type: pd_gravity, tuned: false, natural_frequency: 0.1}", "law.type' is 'pd_gravity': K_p"),
        ("{tuned: 1}", "law.tuned"),
    ],
)
def test_invalid_parameters_are_refused_in_one_sentence(law: str, words: str) -> None:
    refused(fjr.ParameterError, lambda: scenario(law), words)


def test_a_target_without_effort_causes_no_division_by_zero() -> None:
    y = BaselineTarget(fjr.single_link(stiffness=31.0), fjr.Sine(0.0, 1.0), fjr.PAPER_GAINS, (np.zeros(2), np.zeros(2)))
    target = tune("v_dpbc", y)
    assert y.peak == 0
    assert target.same_peak
    assert not replace(target, peak=1e-3).same_peak
