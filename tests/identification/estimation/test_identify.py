# SPDX-License-Identifier: Apache-2.0
"""Known joints are found again with intervals that contain the truth; what records cannot reveal is not guessed."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.elastic_joint import TRUTH, ElasticJoint, exact, integrated, multi_sine, usual_record
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, Estimate, Identification
from fjr_identification.estimation.estimation_problem import Estimation
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.motion_record import MotionRecord, record_of_samples
from fjr_identification.estimation.parameters import KINDS, IdentifyOptions, prior_of
from fjr_identification.estimation.validation import hold_out
from fjr_identification.estimation.verdicts import inflation

NOISE = 2e-5  # rad
LINEAR = ElasticJoint().linear()


def robot_like(joint: ElasticJoint) -> fjr.Robot:
    """Return the robot with the right link and wrong springs and motors."""
    return fjr.single_link(
        stiffness=1.4 * joint.K,
        motor_inertia=0.8 * joint.B,
        link_inertia=joint.M,
        gravity_torque=joint.load,
        link_damping=0.0,
        motor_damping=0.0,
    )


def noisy(
    u: Array, link: Array | None, motor: Array | None, dt: float, torque: Array | None = None, noise: float = NOISE
) -> MotionRecord:
    random = np.random.default_rng(7)
    nothing = np.full_like(u, np.nan)
    q_l, q_m = (nothing if each is None else each + noise * random.standard_normal(len(u)) for each in (link, motor))
    columns = (u, q_l, q_m, nothing if torque is None else torque)
    return MotionRecord("a record", ("joint1",), dt, *(each[:, None] for each in columns))


def sensed(joint: ElasticJoint, q_l: Array, q_m: Array) -> Array:
    """Return what a torque sensor measures of the usual record, at the time of the motor."""
    k = np.arange(len(q_m))
    torque = joint.K * (q_m - np.interp(k - joint.skew / 4e-3, k, q_l) - joint.offset)
    return np.asarray(torque + 2e-3 * np.random.default_rng(3).standard_normal(len(k)))


def linear_record(frequencies: list[float], amplitude: float, noise: float = NOISE) -> MotionRecord:
    """Return a record of a motor that starts and ends smoothly, so that it excites these frequencies only."""
    dt, joint = 2e-3, replace(LINEAR, skew=1.5e-3, delay=2.5e-3)
    t = np.arange(1500) * dt
    u = multi_sine(t, np.array(frequencies), amplitude, 2) * np.sin(np.pi * t / t[-1]) ** 4
    return noisy(u, None, exact(joint, u, dt, 5e-4)[1], dt, noise=noise)


def found_in(record: MotionRecord, joint: ElasticJoint, **options: object) -> dict[str, Estimate]:
    robot = robot_like(joint)
    found = identify([record], robot, prior_of(robot), IdentifyOptions(**options))  # type: ignore[arg-type]
    return {each.name: each for each in found.estimates}


@cache
def usual_identification() -> Identification:
    """Return what is identified from the usual record."""
    robot = robot_like(ElasticJoint())
    return identify([noisy(*usual_record(), 4e-3)], robot, prior_of(robot))


def test_all_parameters_of_a_joint_are_found_within_their_intervals() -> None:
    found = {each.name: each for each in usual_identification().estimates}
    for name, field in TRUTH.items():
        true, estimate = getattr(ElasticJoint(), field), found[name]
        sd = (estimate.high - estimate.low) / 3.92
        assert abs(estimate.value - true) < 3 * sd, name
        assert estimate.verdict == IDENTIFIED, name
    assert found["joint_stiffness"].value == pytest.approx(31.0, rel=1e-3)
    assert found["motor_inertia"].value == pytest.approx(0.004, rel=1e-3)


@pytest.mark.parametrize("every", [pytest.param(2, marks=pytest.mark.full), 5])
def test_a_log_slower_than_the_controller_gives_stiffness_inertia_and_delay(every: int) -> None:
    """The effort changes each millisecond and is logged each second or fifth time; without `held` it acts too early."""
    dt, robot = 1e-3, robot_like(ElasticJoint())
    u = multi_sine(np.arange(3000) * dt, np.array([0.3, 0.8, 2.1, 5.3, 9.7, 17.0, 29.0]), 0.35, 1)
    sides = [side[::every, None] for side in integrated(ElasticJoint(), u, dt)]
    q_l, q_m = sides + NOISE * np.random.default_rng(11).standard_normal((2, len(sides[0]), 1))
    t, nothing = every * dt * np.arange(len(q_l)), np.full_like(q_l, np.nan)
    found = {}
    for held in (dt, np.inf):
        record, notes = record_of_samples("a log", ("joint1",), t, [q_l, q_m, u[::every, None], nothing], held)
        assert len(notes) == (held == dt)
        found[held] = {each.name: each for each in identify([record], robot, prior_of(robot)).estimates}
    for name, true in {"joint_stiffness": 31.0, "motor_inertia": 0.004, "effort_delay": 2.6e-3}.items():
        estimate, plain = (found[held][name] for held in (dt, np.inf))
        assert abs(estimate.value - true) < 3 * (estimate.high - estimate.low) / 3.92, name
        assert plain.high < true, name
    assert found[np.inf]["effort_delay"].value == pytest.approx(2.6e-3 - (every - 1) / 2 * dt, abs=1e-5)


HARD = ElasticJoint(cubic=31.0 / 0.02**2)  # twice the torque of a straight spring at 20 mrad


def test_a_spring_that_hardens_is_found_with_its_curve() -> None:
    found = found_in(noisy(*usual_record(joint=HARD), 4e-3), HARD, cubic_stiffness=True)
    for name, true in {"joint_stiffness": HARD.K, "cubic_stiffness": HARD.cubic, "motor_inertia": HARD.B}.items():
        estimate = found[name]
        assert abs(estimate.value - true) < 3 * (estimate.high - estimate.low) / 3.92, name
        assert estimate.verdict == IDENTIFIED, name


def test_a_straight_spring_has_no_curve_and_a_torque_sensor_does_not_measure_one() -> None:
    u, q_l, q_m = usual_record()
    found = found_in(noisy(u, q_l, q_m, 4e-3), ElasticJoint(), cubic_stiffness=True)
    assert found["cubic_stiffness"].low <= 0.0 or found["cubic_stiffness"].value < 0.02 * HARD.cubic
    assert found["joint_stiffness"].value == pytest.approx(31.0, rel=0.02)
    record = noisy(u, q_l, q_m, 4e-3, sensed(ElasticJoint(), q_l, q_m))
    with pytest.raises(fjr.StateError, match="cubic_stiffness is of records with joint torque sensors"):
        found_in(record, ElasticJoint(), cubic_stiffness=True)


def test_two_records_give_narrower_intervals_than_one_and_those_of_other_joints_are_refused() -> None:
    robot = robot_like(ElasticJoint())
    both = identify([noisy(*usual_record(seed), 4e-3) for seed in (0, 1)], robot, prior_of(robot))
    widths = [[each.high - each.low for each in found.estimates] for found in (usual_identification(), both)]
    assert np.median(np.array(widths[1]) / np.array(widths[0])) < 0.8
    with pytest.raises(fjr.FjrError, match="expected the 2 of the robot"):
        identify([noisy(*usual_record(), 4e-3)], fjr.planar_two_link(), prior_of(fjr.planar_two_link()))


def test_without_gravity_the_motor_side_reveals_the_stiffness_by_its_resonance_alone_and_not_the_offset() -> None:
    found = found_in(linear_record([0.4, 1.1, 5.0, 15.0, 17.0], 0.15), LINEAR)
    stiffness = found["joint_stiffness"]
    assert stiffness.verdict == IDENTIFIED
    assert stiffness.low < LINEAR.K < stiffness.high
    assert "link_skew" not in found
    assert found["offset"].verdict == UNKNOWN
    assert "measure the link" in found["offset"].reason
    stiffness = found_in(linear_record([0.4, 0.9], 0.01, noise=5e-4), LINEAR)["joint_stiffness"]
    assert stiffness.verdict == UNKNOWN
    assert stiffness.value == stiffness.prior == pytest.approx(1.4 * LINEAR.K)
    assert "excite the joint near its resonance" in stiffness.reason


def test_without_the_motor_position_the_offset_is_not_told_however_wide_its_prior_and_many_the_segments(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(KINDS, "offset", replace(KINDS["offset"], width=0.1))
    for limit in ("SHORTEST", "LONGEST"):
        monkeypatch.setattr(f"{Estimation.__module__}.{limit}", 0.2)  # s
    joint, robot, (u, q_l, q_m) = ElasticJoint(), robot_like(ElasticJoint()), usual_record()
    record = noisy(u, q_l, None, 4e-3, sensed(joint, q_l, q_m), noise=2e-6)
    found = identify([record], robot, prior_of(robot))
    assert found.value("joint_stiffness") == pytest.approx(joint.K, rel=0.02)
    offset = next(each for each in found.estimates if each.name == "offset")
    assert (offset.verdict, offset.value) == (UNKNOWN, 0.0)
    assert "measure the motor" in offset.reason


def test_correlated_scores_widen_the_intervals_and_white_ones_do_not() -> None:
    random = np.random.default_rng(0)
    white = random.standard_normal((4000, 2))
    slow = np.repeat(random.standard_normal((1000, 2)), 4, axis=0)
    posterior = np.eye(2) / 4000
    np.testing.assert_allclose(inflation(white, posterior), 1.0, atol=0.1)
    assert np.all(inflation(slow, posterior) > 1.4)


def test_draws_of_an_identification_respect_signs() -> None:
    found = usual_identification()
    names = [each.name for each in found.estimates]
    draws = found.draws(500, 2)
    assert np.all(draws[:, [names.index(name) for name in ("joint_stiffness", "motor_inertia", "link_damping")]] >= 0)
    spread = draws[:, names.index("joint_stiffness")].std()
    stiffness = found.estimates[names.index("joint_stiffness")]
    assert spread == pytest.approx((stiffness.high - stiffness.low) / 3.92, rel=0.15)


LATE = 2  # samples by which the link encoder is read later


def test_the_deflection_of_another_record_is_predicted_better_than_by_rigid_joints_or_no_skew() -> None:
    robot, found = robot_like(ElasticJoint()), usual_identification()
    prior = prior_of(robot)
    record = noisy(*usual_record(1), 4e-3)
    wrong = replace(found, estimates=tuple(replace(e, value=e.prior) for e in found.estimates))
    shares = [hold_out(each, record, robot, prior, IdentifyOptions()).shares[0, 0] for each in (found, wrong)]
    assert shares[0] < 0.1
    assert shares[1] > 0.2
    late = replace(record, q_l=np.vstack([record.q_l[:LATE], record.q_l[:-LATE]]))
    skewed = tuple(
        replace(e, value=e.value - LATE * record.dt) if e.name == "link_skew" else e for e in found.estimates
    )
    compared = hold_out(replace(found, estimates=skewed), late, robot, prior, IdentifyOptions())
    model, rigid, no_skew = compared.shares[0]
    assert model < min(0.1, no_skew / 2, rigid / 2)


def test_a_torque_that_depends_on_the_position_is_found() -> None:
    joint = ElasticJoint()
    found = found_in(noisy(*usual_record(), 4e-3), replace(joint, load=0.0), position_torque="joint1")
    assert found["position_torque_sin1"].value == pytest.approx(joint.load, rel=0.01)
    assert found["joint_stiffness"].value == pytest.approx(joint.K, rel=0.01)
