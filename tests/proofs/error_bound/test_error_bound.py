# SPDX-License-Identifier: Apache-2.0
"""Bound of the tracking error: holds in simulated runs, is reached by the worst torque, grows with every error."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

import fjr_core as fjr
from bench.error_bound import UncertainLoop, drawn, on_reference
from docs.pages import ROOT
from fjr_core.config.scenario import load_scenario
from fjr_core.extensions.law_registry import LAWS
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.simulation.deviations import DEVIATIONS
from fjr_design.baselines.feedback_linearisation import CompositeGains
from fjr_design.batch import ClosedLoop, Draws
from fjr_msgs_py.console.options import model_error
from fjr_msgs_py.scenarios import library
from fjr_proofs.check_rows import errors_bounded
from fjr_proofs.error_bound import ErrorBound, bound_errors
from fjr_proofs.error_bound.cells import cells_of
from fjr_proofs.error_bound.deviation_model import CentreMotion, DeviationModel
from fjr_proofs.error_bound.search import SOLVABLE, TORQUES, FactorBox, Search
from fjr_proofs.error_bound.tube import fixed_point, loop_gain, steady_motion
from fjr_proofs.error_bound.uncertain_robot import PARAMETERS, UncertainRobot

T = 1e-3
PLACE = (0.2, 0.0, 0.01)  # m, of a payload
SWING = fjr.Sine(1.0, 1.0)
STILL = fjr.Sine(0.0, 1.0)
TWO_LINK_GAINS = fjr.Gains(
    16.0, [[32.22, 4.272], [4.272, 4.229]], [[1.697, 0.225], [0.225, 0.2227]], 16.0, [40.0, 25.0], [0.32, 0.16]
)
TWO_LINK_SWING = fjr.Sine([0.5, 0.7], [2.0, 3.0], [0.3, 0.0])
FAST = fjr.Sine(0.1, 5 * np.pi)  # a period of 400 samples
TWO_LINK_FAST = fjr.Sine([0.2, 0.3], 2 * np.pi, [0.3, 0.0])

FACTORS = [name for name in PARAMETERS if DEVIATIONS[name].is_factor]


def joint(gravity: float = 0.8) -> fjr.TrackingLaw:
    return fjr.TrackingLaw(fjr.single_link(gravity_torque=gravity), fjr.PAPER_GAINS, compile=True)


def two_link() -> fjr.TrackingLaw:
    return fjr.TrackingLaw(fjr.planar_two_link(), TWO_LINK_GAINS, compile=True)


@cache
def paper(delay: float, prove: bool | None = None, **errors: float) -> ErrorBound:
    """Return the bound of the paper's joint along a reference with a short period."""
    return bound_errors(joint(), FAST, T, delay, errors, payload_position=PLACE, prove=prove)


OF_THE_LINKS = {
    "payload": 0.05,
    "payload_mass": 0.05,
    "payload_position": 0.01,
    "gravity_direction": 0.03,
    "link_central_inertia": 0.1,
}
CASES = [
    (joint, SWING, 0.4 * T, {"stiffness": 0.05, "motor_inertia": 0.05}),
    (joint, FAST, 1.4 * T, OF_THE_LINKS),
    (two_link, TWO_LINK_FAST, T, {"link_mass": [0.05, 0.02], "stiffness": [0.02, 0.02]}),
]
"""A joint and two links, samples beside the period and on it, delays below and above a sample."""
MORE = [
    (joint, SWING, T, {"payload": 0.2, "link_damping": 0.3, "motor_damping": 0.3, "gravity": 0.05}),
    (joint, FAST, 1.4 * T, {"stiffness": 0.2, "motor_inertia": 0.05}),
    (two_link, TWO_LINK_SWING, T, {}),
    (two_link, TWO_LINK_SWING, T, {"payload_mass": 0.1, "link_mass": 0.05, "motor_inertia": [0.1, 0.0]}),
]


def class_of(
    law: fjr.TrackingLaw, reference: Reference, delay: float, errors: dict[str, Any], duration: float | None = None
) -> UncertainLoop:
    """Return the loop for 4 s, or for a period of a fast motion after 1 s in which its transients decay."""
    lasting = duration or {FAST: 1.4, TWO_LINK_FAST: 2.0}.get(reference, 4.0)
    return UncertainLoop(law, reference, T, delay, errors, 1.0, lasting, PLACE)


@pytest.mark.parametrize(
    ("law", "reference", "delay", "errors", "searches"),
    [*((*case, 0) for case in CASES), *(pytest.param(*case, 1, marks=pytest.mark.full) for case in (*CASES, *MORE))],
)
def test_no_robot_within_the_errors_exceeds_a_proven_bound_which_is_at_most_twice_as_large(
    law, reference, delay, errors, searches
) -> None:
    """Half of the drawn robots have every error at an end of its range; `make test-all` searches for worse ones."""
    made = law()
    bound = bound_errors(made, reference, T, delay, errors, payload_position=PLACE)
    loop = class_of(made, reference, delay, errors)
    steady, whole = drawn(loop, 40 if errors else 1)
    found = loop.worst(searches, 3, bound.position) if searches and errors else []
    seen = np.max([*found, steady.max(axis=0)], axis=0)
    assert bound.proven
    assert np.all(seen <= bound.position)
    assert np.all(whole.max(axis=0) <= bound.from_start)
    assert np.all(bound.position <= bound.from_start)
    assert np.all(bound.position <= 2.1 * seen)


def test_a_transient_beyond_the_steady_bound_stays_within_that_from_the_start() -> None:
    """The links of a slow law settle in a second, several periods of the reference."""
    law, errors = fjr.TrackingLaw(fjr.single_link(), fjr.Gains(2.0, 1.0, 0.02, 15.0, 60.0, 0.3)), {"stiffness": 0.05}
    bound = bound_errors(law, FAST, T, 0.0, errors)
    _, whole = drawn(class_of(law, FAST, 0.0, errors), 10)
    assert bound.proven
    assert bound.position < whole.max() <= bound.from_start <= 1.2 * whole.max()


@pytest.mark.full
@pytest.mark.parametrize("errors", [{}, {"payload": 0.01}])
def test_runs_of_seven_joints_stay_within_the_proven_bound(errors: dict[str, float]) -> None:
    made = load_scenario(ROOT / "ros2_ws/src/fjr_bringup/scenarios/arm7.yaml")
    law = fjr.TrackingLaw(made.robot, made.gains, compile=True)
    bound = bound_errors(law, made.reference, T, T, errors, prove=True)
    seen = drawn(class_of(law, made.reference, T, errors, 3.0), 50 if errors else 1)[0].max(axis=0)
    assert bound.proven
    assert np.all(seen <= bound.position)
    assert largest_storage(law, made.reference, errors.get("payload", 0.0)) <= bound.storage
    assert np.all(bound.position <= 2 * seen)


def largest_storage(law: fjr.TrackingLaw, reference: Reference, payload: float) -> float:
    """Return the largest V [J] from 2.5 s on of runs with payloads up to one sign and the other, one sample late."""
    robot, factors = law.robot, 1 + payload * np.array([-1.0, 0.3, 1.0])
    x0 = robot.state(*on_reference(robot, reference)[:4])
    loop = ClosedLoop(robot, law, reference, x0, 5.0, T)
    _, run = loop.recorded(Draws(len(factors), link_inertia=factors, gravity=factors, delay=T))
    settled = [(m, t) for states in run.measured for m, t in zip(states[2500::17], run.t[2500::17], strict=True)]
    return max(law.measured_command(*np.split(m, 2), reference.jets(t))[1] for m, t in settled)


@pytest.mark.parametrize(
    ("law", "reference", "payload"),
    [(joint, SWING, 0.2), pytest.param(two_link, TWO_LINK_SWING, 0.0, marks=pytest.mark.full)],
)
def test_V_of_settled_runs_stays_within_its_bound(law, reference, payload) -> None:
    made = law()
    bound = bound_errors(made, reference, T, T, {"payload": payload})
    seen = largest_storage(made, reference, payload)
    assert bound.proven
    assert seen <= bound.storage
    assert bound.storage < 10 * seen or not payload


def test_a_law_without_storage_has_no_bound_of_V() -> None:
    law = LAWS["singular_perturbation"].make(fjr.single_link(), CompositeGains(K_p=100.0, K_v=20.0, K_f=0.1))
    bound = bound_errors(law, SWING, T, 0.0, {"payload": 0.01})
    assert bound.found
    assert np.isnan(bound.storage)


def test_the_centre_of_a_tube_is_the_steady_motion_of_the_simulated_late_loop() -> None:
    law, payload = joint(), 1.2
    model, heaviest = DeviationModel(law, UncertainRobot(law.robot, {"payload": payload - 1})), np.array([-1.0])
    assert model.uncertain.of_joints("payload", heaviest) == pytest.approx(payload)
    centre = steady_motion(model, cells_of(SWING, T, verified=True, most=100), heaviest, T)
    x0 = law.robot.state(*on_reference(law.robot, SWING)[:4])
    loop = ClosedLoop(law.robot, law, SWING, x0, 4.0, T)
    _, run = loop.recorded(Draws(1, link_inertia=payload, gravity=payload, delay=T))
    settled = run.t > 2.0
    positions = centre.path.reference.jets(run.t[settled])[:, 0]
    error = np.abs(run.x[0, settled, :1] - positions).max()
    assert error < 1e-3 * np.abs(positions - SWING.jets(run.t[settled])[:, 0]).max()


def linear_step(robot: fjr.Robot) -> Array:
    """Return the map (4, 6) of a joint without gravity from (q_l, q_m, dq_l, dq_m), torque and effort to T later."""
    M, M_m, K, D, D_m = (float(each[0, 0]) for each in (robot.M_l([0.0]), robot.M_m, robot.K, robot.D_l, robot.D_m))
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-K / M, K / M, -D / M, 0], [K / M_m, -K / M_m, 0, -D_m / M_m]])
    whole = np.zeros((6, 6))
    whole[:4, :4], whole[2, 4], whole[3, 5] = A, 1 / M, 1 / M_m
    return np.asarray(expm(whole * T)[:4])


def response(law: fjr.TrackingLaw, torques: np.ndarray, robot: fjr.Robot | None = None) -> np.ndarray:
    """Return q_l at the samples of a joint without gravity at rest, under link torques that change at the samples.

    robot: that of the law by default.
    """
    step, z, positions = linear_step(robot or law.robot), np.zeros(4), [0.0]
    for torque in torques:
        u, _ = law.measured_command(z[:2], z[2:], np.zeros((5, 1)))
        z = step @ [*z, torque, u[0]]
        positions.append(z[0])
    return np.array(positions)


def test_the_worst_torque_of_a_linear_joint_nearly_reaches_the_bound() -> None:
    law, samples = joint(gravity=0.0), 1500
    impulse = np.diff(response(law, np.append(np.ones(1), np.zeros(samples))), prepend=0.0).cumsum()[1:]
    worst = 0.3 * np.sign(impulse[::-1])
    seen = response(law, worst[-samples:])[-1]
    (bound,) = bound_errors(law, STILL, T, 0.0, {"link_torque": 0.3}).position
    assert seen <= bound <= 1.05 * seen


@pytest.mark.parametrize(("error", "size"), [("payload", 0.7), ("link_mass", 0.6)])
def test_the_worst_torque_on_the_lightest_robot_stays_within_the_bound(error: str, size: float) -> None:
    """A torque accelerates a light robot more than its model; the loop of this one nearly oscillates.

    The equations are divided by the factor of a payload; that of a mass is a mismatch of the inertia.
    """
    gains, samples = fjr.Gains(5.5, 350.0, 14.0, 35.0, 60.0, 0.16), 3000
    law = fjr.TrackingLaw(fjr.single_link(gravity_torque=0.0), gains, compile=True)
    light = fjr.single_link(gravity_torque=0.0, link_inertia=(1 - size) * 0.031)
    impulse = response(law, np.append(np.ones(1), np.zeros(samples)), light)[1:]
    seen = response(law, 0.1 * np.sign(impulse[::-1]), light)[-1]
    bound = bound_errors(law, STILL, T, 0.0, {error: size, "link_torque": 0.1})
    assert bound.proven
    assert seen <= bound.position <= 1.2 * seen


def test_a_constant_torque_leaves_the_error_of_the_closed_form() -> None:
    """At rest the spring carries the torque, K zeta = -d, and the effort F_q y + F_zeta zeta = K zeta holds it."""
    law, d = joint(gravity=0.0), 0.2
    K = float(law.robot.K[0, 0])
    F_q, F_zeta = (
        law.measured_command(position, [0.0, 0.0], np.zeros((5, 1)))[0][0] for position in ([1.0, 1.0], [0.0, 1.0])
    )
    error = (K - F_zeta) * (-d / K) / F_q
    assert response(law, np.full(3000, d))[-1] == pytest.approx(error, rel=1e-4)
    (bound,) = bound_errors(law, STILL, T, 0.0, {"link_torque": d}).position
    assert abs(error) <= bound <= 1.4 * abs(error)


@pytest.mark.parametrize("name", TORQUES)
def test_twice_the_torque_doubles_the_bound_of_a_linear_joint(name: str) -> None:
    once, twice = (bound_errors(joint(gravity=0.0), STILL, T, T, {name: d}).position for d in (0.1, 0.2))
    assert twice == pytest.approx(2 * once, rel=1e-6)


@pytest.mark.parametrize("factor", [0.95, 1.05])
def test_a_robot_of_another_weight_rests_within_its_bound(factor: float) -> None:
    """At rest the spring carries the weight, and the effort of the law holds the spring."""
    law, at = joint(), 0.5
    K, weight = float(law.robot.K[0, 0]), ca.Function("g", [q := ca.SX.sym("q")], [law.robot.links.grad_P_l(q)])
    jets = np.zeros((5, 1))
    jets[0] = at

    def unbalanced(q_l: float) -> float:
        torque = factor * float(weight(q_l))
        return float(law.measured_command([q_l, q_l + torque / K], [0.0, 0.0], jets)[0][0]) - torque

    error = abs(brentq(unbalanced, at - 0.1, at + 0.1) - at)
    bound = bound_errors(law, fjr.Sine(0.0, 1.0, offset=at), T, T, {"gravity": 0.05})
    assert bound.proven
    assert error <= bound.position[0] <= 1.1 * error


def test_stated_errors_are_those_of_the_robot_file_times_a_number_of_standard_deviations() -> None:
    said = ("link_coulomb_friction:=0.01", "link_torque:=0.02", "link_mass:=0.01", "joint_stiffness:=0.005")
    fast = [f"reference.frequency:=[{5 * np.pi}]", "reference.amplitude:=[0.1]"]  # a period of 400 samples
    scenario = library.load("paper_k31", [*fast, *(f"robot.deviations.{each.replace(':=', ':=[')}]" for each in said)])
    found = errors_bounded(scenario, {"stated": 2.0, "link_damping": 0.02}, 1.0, prove=False).values
    expected = {"link_mass": [0.02], "stiffness": [0.01], "link_damping": 0.02, "link_torque": 0.06}
    assert found["errors"] == {name: pytest.approx(size) for name, size in expected.items()}
    bound = bound_errors(scenario.law, scenario.reference, T, T, expected, prove=False)
    assert found["position"]["joint1"] == pytest.approx(bound.position[0])
    with pytest.raises(fjr.ParameterError, match="'stated' has 3 numbers; expected one"):
        errors_bounded(scenario, {"stated": [1.0, 2.0, 3.0]}, 1.0)


def test_an_error_under_its_former_name_is_reported(capsys: pytest.CaptureFixture[str]) -> None:
    assert model_error("link_inertia=0.1") == model_error("link_central_inertia=0.1")
    assert "--error link_inertia is deprecated; use link_central_inertia" in capsys.readouterr().err


def test_relative_errors_are_given_as_shares_or_in_percent() -> None:
    assert model_error("link_mass=20%") == model_error("link_mass=0.2")
    assert model_error("stiffness=10%,0.2,5.5%") == ("stiffness", [0.1, 0.2, 0.055])


@pytest.mark.parametrize("prove", [False, pytest.param(None, marks=pytest.mark.full)], ids=["sampled", "proven"])
def test_delay_and_every_error_enlarge_the_bound(prove: bool | None) -> None:
    assert paper(0.0, prove).position < paper(T, prove).position
    for name in {*PARAMETERS, *TORQUES} - {"payload_position", "link_central_inertia"}:
        assert paper(T, prove, **{name: 0.05}).position > paper(T, prove).position, name


def test_no_robot_with_a_delay_within_its_error_exceeds_the_bound() -> None:
    made, errors = joint(), {"payload": 0.1}
    bound = bound_errors(made, FAST, T, 0.5 * T, errors | {"delay": 0.5})
    assert bound.proven
    for delay in (0.0, 0.3 * T, T):
        steady, whole = drawn(class_of(made, FAST, delay, errors), 20)
        assert np.all(steady <= bound.position)
        assert np.all(whole <= bound.from_start)
        assert np.all(bound.position <= 1.5 * steady.max())


@pytest.mark.parametrize("scale", [0.9, 1.1])
def test_bounds_reproduce_themselves_where_the_loop_gain_is_below_1(scale: float) -> None:
    """The mismatch of a joint, scaled to this loop gain."""
    law = joint()
    search = Search(DeviationModel(law, UncertainRobot(law.robot, {"stiffness": 0.2})), SWING, T, T, np.zeros(2), True)
    linear = search.linear(np.zeros(1))
    problem = search.problem(linear, -np.ones(1), np.ones(1))
    assert problem is not None
    (whole,) = problem.ranges.of_factors(4, problem.steady.lines)
    size = scale / loop_gain(linear, problem.gains, whole)
    scaled = whole._replace(unknown=np.full(4, 1e-3), **{name: size * getattr(whole, name) for name in "XMBF"})
    assert loop_gain(linear, problem.gains, scaled) == pytest.approx(scale, rel=1e-9)
    assert (fixed_point(linear, problem.gains, scaled) is not None) == (scale < 1)


def test_motions_between_samples_exceed_those_at_their_ends_by_no_more_than_stated() -> None:
    """The linear model of a cell, under an effort that is held and torques that jump between their bounds."""
    linear, steps = (
        Search(DeviationModel(two_link()), TWO_LINK_FAST, T, T, np.zeros(4), True).linear(np.zeros(0)),
        50,
    )
    A, links, (B, E) = linear.A[7], linear.links, (inputs[7] for inputs in linear.inputs)
    step = expm(T / steps * np.block([[A, np.eye(8)], [np.zeros((8, 16))]]))
    rng, reached = np.random.default_rng(0), np.zeros(2)
    for w in rng.uniform(0, 1, 20):
        crest = rng.normal(size=8)  # in the middle of the sample, where the accelerations are largest
        crest -= np.linalg.pinv(A[links] @ A) @ (A[links] @ A @ crest)
        y, u, course = expm(-T / 2 * A) @ crest, rng.normal(size=2), []
        for torque in rng.choice([-w, w], (steps, 6)):
            course.append(y)
            y = step[:8, :8] @ y + step[:8, 8:] @ (B @ u + E @ torque)
        course.append(y)
        found, ends = np.abs(course), np.abs([course[0], course[-1]]).max(axis=0)
        accelerations = np.abs(course @ A[links].T)
        rate = np.max([np.abs(A @ end + B @ u) for end in (course[0], y)], axis=0) + w * np.abs(E).sum(axis=1)
        between, bulge = linear.between_samples(rate, w * np.abs(A[links] @ E).sum(axis=1))
        assert np.all(found <= ends + between)
        assert np.all(accelerations <= accelerations[[0, -1]].max(axis=0) + bulge)
        beyond = found - ends, accelerations - accelerations[[0, -1]].max(axis=0)
        reached = np.maximum(
            reached, [np.max(more / most) for more, most in zip(beyond, (between, bulge), strict=True)]
        )
    assert np.all(reached > 0.1), "the test tries them"


def test_a_box_is_divided_into_equal_parts_as_often_as_its_gains_ask_for() -> None:
    low, high, effects = np.array([[-1.0, 0.0, 2.0], [1.0, 0.01, 6.0], [2.0, 9.0, 1.5]])
    boxes = [
        FactorBox(low, high, *[effects] * 5, 0.0, SOLVABLE * np.array(gains))  # type: ignore[arg-type]
        for gains in ([1.0, 1.0, 1.0], [1.0, 8.0, 1.1], [3.0, 8.0, 1.1])
    ]
    assert [len(box.divided()) for box in boxes] == [2, 4, 8]
    ends = boxes[-1].divided()
    assert len({(*a, *b) for a, b in ends}) == 8
    assert all(b - a == pytest.approx([0.5, 0.01, 2.0]) for a, b in ends), "the second is narrow"
    assert sum(np.prod(b - a) for a, b in ends) == pytest.approx(np.prod(high - low))
    assert np.all([np.min([a for a, _ in ends], axis=0) == low, np.max([b for _, b in ends], axis=0) == high])


class Closed(Search):
    """A division whose parts have tubes up to a width of 1, and from the start up to 0.5."""

    def _solved(self, low: Array, high: Array, start: CentreMotion | None) -> FactorBox:
        width = np.full(2 * self.model.n, np.max(high - low))
        tube, from_start = (np.where(width <= most, width, np.inf) for most in (1.0, 0.5))
        return FactorBox(low, high, start, np.zeros(len(low)), width, tube, from_start)  # type: ignore[arg-type]


@pytest.mark.parametrize(("asked", "seconds", "parts"), [(False, np.inf, 4), (True, 0.0, 4), (True, np.inf, 16)])
def test_a_box_is_divided_for_a_bound_from_the_start_if_a_proof_is_asked_for(
    asked: bool, seconds: float, parts: int
) -> None:
    law, box = joint(), (-np.ones(2), np.ones(2))
    model = DeviationModel(law, UncertainRobot(law.robot, {"stiffness": 0.2, "link_mass": 0.1}))
    boxes = Closed(model, SWING, T, T, np.zeros(2), verified=True, asked=asked, seconds=seconds).boxes(*box)
    assert len(boxes) == parts
    assert sum(each.volume(*box) for each in boxes) == pytest.approx(1.0)
    assert all(each.has_tube for each in boxes)
    assert all(each.has_all_bounds == (parts == 16) for each in boxes)


def test_errors_too_large_for_a_tube_give_no_bound() -> None:
    found = paper(T, link_torque=100.0)
    assert not found.found
    assert not found.proven
    assert np.all(np.isinf(found.position))


@pytest.mark.parametrize(
    ("reference", "errors"),
    [(fjr.Sine(0.1, 25.0), dict.fromkeys(FACTORS, 0.3)), (STILL, {"payload": 0.9, "link_mass": 0.9})],
    ids=["millions of parts", "links nearly without inertia"],
)
def test_several_large_errors_are_bounded_or_have_no_bound(reference: Reference, errors: dict[str, float]) -> None:
    found = bound_errors(joint(), reference, T, 5 * T, errors)
    assert found.found == np.all(np.isfinite(found.position))


def test_an_unstable_loop_has_no_bound() -> None:
    assert not paper(20 * T).found


def test_a_bound_without_a_proof_is_sampled() -> None:
    sampled = paper(T, prove=False)
    assert not sampled.proven
    assert sampled.position <= paper(T).position <= 1.5 * sampled.position


def test_a_bound_on_links_from_a_description_is_proven() -> None:
    law = joint()
    arm = replace(law.robot, links=replace(law.robot.links, M_l_vertices=None))
    assert bound_errors(fjr.TrackingLaw(arm, fjr.PAPER_GAINS), SWING, T, T).proven


class Saturated(fjr.TrackingLaw):
    """The law with a smooth limit of its effort, which has no Taylor model."""

    def measured_expression(self, *arguments: ca.SX) -> tuple[ca.SX, ca.SX]:
        u, V = super().measured_expression(*arguments)
        return 20.0 * ca.tanh(u / 20.0), V


def test_a_bound_of_a_law_with_other_operations_is_sampled() -> None:
    found = bound_errors(Saturated(fjr.single_link(gravity_torque=0.8), fjr.PAPER_GAINS), STILL, T, 0.0)
    assert found.found
    assert not found.proven


def test_a_reference_that_ends_is_bounded_from_samples() -> None:
    bound = bound_errors(joint(), fjr.Spline([0.0, 1.0, 2.0], [[0.0], [0.5], [0.0]]), T, T, {"payload": 0.05})
    assert bound.found
    assert not bound.proven


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((SWING, 0.0, 0.0), "expected"),
        ((SWING, np.nan, 0.0), "expected"),
        ((SWING, T, -T), "expected"),
        ((SWING, T, 0.0, {"payloads": 0.1}), "error 'payloads' is unknown; expected some of payload, "),
        ((SWING, T, 0.0, {"payload": -0.1}), "error 'payload' is -0.1; expected 0 to 0.9"),
        ((SWING, T, 0.0, {"stiffness": [0.1, 0.1]}), r"error 'stiffness' is \[0.1, 0.1\]; expected one number$"),
        ((SWING, T, 0.0, {"payload_position": 0.1}), "error 'payload_position' is given alone; expected one with"),
        ((SWING, T, 0.0, {"stiffness": 1.5}), "error 'stiffness' is 1.5; expected 0 to 0.9"),
        ((SWING, T, 0.8 * T, {"delay": 0.4}), "error 'delay' is 0.4; expected 0 to 0.2, beside a delay of 0.8 samples"),
        ((SWING, T, 0.0, {"gravity_direction": 4.0}), "error 'gravity_direction' is 4.0; expected 0 to 0.9"),
        ((SWING, T, 0.0, {"link_torque": np.nan}), "error 'link_torque' is nan; expected 0 to inf"),
        ((fjr.Sine(0.5, 0.01), T), "neither a common period nor an end within 60 s"),
        ((fjr.MultiSine([[0.3], [0.1]], [[1.0], [np.sqrt(2)]]), T), "neither a common period nor an end within 60 s"),
    ],
)
def test_what_cannot_be_bounded_is_refused(arguments: tuple[Any, ...], words: str) -> None:
    with pytest.raises(fjr.FjrError, match=words):
        bound_errors(joint(), *arguments)


def test_time_that_is_over_ends_the_division() -> None:
    errors = {"stiffness": 0.3}
    whole, cut = (bound_errors(joint(), FAST, T, T, errors, prove=False, seconds=s) for s in (np.inf, 1e-9))
    assert whole.parts > 1
    assert cut.parts == 1
    assert np.all(cut.position >= whole.position)
