# SPDX-License-Identifier: Apache-2.0
"""Terms that the model lacks are those of least squares; stiffnesses come with their deflections, or with a bound."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from core.oracles.elastic_joint import ElasticJoint, integrated, multi_sine, usual_record
from fjr_core.model.joints import JointSample
from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, UNKNOWN, Estimate, Identification
from fjr_identification.estimation.estimation_problem import Estimation
from fjr_identification.estimation.filtered_fit import filtered_estimates, filtered_fit
from fjr_identification.estimation.lack_of_fit import Rows, Seen, deflections, seen, slipping_elements, withheld
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import IdentifyOptions, prior_of
from fjr_identification.estimation.verdicts import Estimates
from fjr_identification.page import springs_seen as lines
from fjr_msgs_py.scenarios import library
from fjr_plant.lock_step import START
from fjr_plant.simulated_robot import simulated
from identification.estimation.test_identify import robot_like
from physics.coverage import read
from physics.draws import Case, Draws, drawn
from physics.sensors import Encoder, Sensors

DRAWS = 3
STIFFER, NOISE = 1e5, 1e-5  # times as stiff; rad of the encoders


@pytest.mark.parametrize("columns", [0, 3])
@pytest.mark.parametrize("added", [1, 2])
def test_a_term_is_that_of_least_squares_with_all_columns(columns: int, added: int) -> None:
    random = np.random.default_rng(columns + added)
    X, T, errors = (random.standard_normal(shape) for shape in ((200, columns), (200, added), 200))
    term = Rows(errors, X, np.arange(200) // 20).term(T)
    both = np.hstack([X, T])
    fitted = np.linalg.lstsq(both, errors, rcond=None)[0]
    np.testing.assert_allclose(term.c, fitted[columns:], atol=1e-12)
    assert term.log_stiffness == pytest.approx(fitted[0] if columns else 0.0)
    before = errors - X @ np.linalg.lstsq(X, errors, rcond=None)[0]
    assert 1 - term.share == pytest.approx(np.sum((errors - both @ fitted) ** 2) / np.sum(before**2))


def test_a_term_without_effect_seldom_stands_out_and_one_with_effect_does() -> None:
    ratios = []
    for seed in range(200):
        random = np.random.default_rng(seed)
        X, T, noise = (random.standard_normal(shape) for shape in ((240, 3), (240, 1), 240))
        rows = [Rows(noise + effect * T[:, 0], X, np.arange(240) // 20) for effect in (0.0, 1.0)]
        ratios.append([each.term(T).ratio for each in rows])
    without, with_effect = np.array(ratios).T
    assert np.mean(without > 2.2) < 0.12
    assert np.min(with_effect) > 5


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_an_encoder_of_a_joint_that_turns_far_is_eccentric_only_if_it_is(seed: int) -> None:
    """A filter changes the sine of a motion of several turns otherwise than the motion, by 1e-3 of the deflection."""
    joint, dt = ElasticJoint(skew=0.0, offset=0.0), 4e-3
    u = multi_sine(np.arange(1000) * dt, np.array([0.35, 0.9, 1.7, 3.1]), 0.7, seed)
    link, motor = integrated(joint, u, dt)
    noise = NOISE * np.random.default_rng(seed).standard_normal((2, len(u)))
    robot = robot_like(joint)
    said = []
    for eccentricity in (0.0, 1e-3):
        columns = u, link + noise[0], motor + eccentricity * np.sin(motor + 0.7) + noise[1], np.full_like(u, np.nan)
        record = MotionRecord("a record", ("joint1",), dt, *(each[:, None] for each in columns))
        setup = Estimation([record], robot, prior_of(robot), IdentifyOptions())
        said.append(seen(setup, filtered_fit(setup, setup.coordinates.mean))["joint1"].wrong)
    assert said == ["", "q_m - q_l depends on the position: an encoder is eccentric"]


@pytest.mark.parametrize(("level", "over"), [(0.05, 0.01), (0.08, 0.005), (0.15, 0.01)])
def test_friction_that_falls_with_the_speed_is_no_kinematic_error_of_the_gear(level: float, over: float) -> None:
    """Stribeck's, half as large again near rest, on the link of the paper's joint with encoders of 19 bits."""
    sizes = {"link_coulomb_friction": level, "link_static_friction": 1.5 * level, "friction_smoothing_velocity": over}
    sizes |= {"link_encoder_bits": 19.0, "motor_encoder_bits": 19.0}
    loop = library.load("paper_k31", [f"imperfections.{name}:=[{size}]" for name, size in sizes.items()])
    (robot, _), step = simulated(loop.plant_values, loop.plant, loop.x0), loop.control_step(simulated=True)
    rows = []
    for k in range(12_000):
        (q_l, q_m), (dq_l, dq_m) = (each.reshape(2, 1) for each in robot.measure()[:2])
        command = step.command(JointSample(k * 1_000_000 + START, q_l, q_m, dq_l, dq_m), k * 1_000_000)
        assert command is not None
        robot.u = command.u.copy()
        rows.append((q_l, q_m, robot.u))
        robot.advance_to((k + 1) * 1_000_000)
    q_l, q_m, u = np.array(rows).transpose(1, 0, 2)
    record = MotionRecord("a record", ("joint1",), 1e-3, u, q_l, q_m, np.full_like(u, np.nan))
    setup = Estimation([record], loop.robot, prior_of(loop.robot), IdentifyOptions(threads=1))
    assert seen(setup, filtered_fit(setup, setup.coordinates.mean))["joint1"].wrong == ""


def test_what_is_wrong_with_a_prismatic_joint_is_said_in_its_units() -> None:
    joint, dt, said = ElasticJoint(cubic=31.0 / 0.02**2), 4e-3, []
    u, link, motor = usual_record(joint=joint)
    columns = u, link, motor, np.full_like(u, np.nan)
    record = MotionRecord("a record", ("joint1",), dt, *(each[:, None] for each in columns))
    for slides in (False, True):
        robot = replace(robot_like(joint), prismatic=(slides,))
        setup = Estimation([record], robot, prior_of(robot), IdentifyOptions())
        found = seen(setup, filtered_fit(setup, setup.coordinates.mean))
        said.append(found["joint1"].wrong)
        still = replace(setup, records=[replace(record, u=0 * record.u, q_l=0 * record.q_l, q_m=0 * record.q_m)])
        said.append(filtered_estimates(still, still.coordinates.mean).estimates[1].reason)
    spring, rest, of_slide, rest_of_slide = said
    assert re.fullmatch(r"the spring is not linear: .* N m/rad at .* mrad, .* N m/rad at .* mrad", spring)
    assert of_slide == spring.replace("N m/rad", "N/m").replace("mrad", "mm")
    assert rest == "the joint stands still (it moves 0 rad); move it"
    assert rest_of_slide == rest.replace("rad", "m")


def test_a_slipping_element_loses_the_work_of_a_parallelogram_in_each_cycle() -> None:
    amplitude, slips = 3.0, np.array([0.5, 1.0, 4.0])
    zeta = amplitude * np.sin(np.linspace(0, 6 * np.pi, 6001))
    w = slipping_elements(zeta, slips)
    lost = np.sum((w[2000:-1] + w[2001:]) / 2 * np.diff(zeta[2000:])[:, None], axis=0) / 2
    np.testing.assert_allclose(lost, 4 * slips * np.maximum(amplitude - slips, 0.0), atol=1e-3)


@cache
def draws() -> Draws:
    """Return draws of one joint, whose sides are read at once by exact encoders."""
    exact = Sensors(Encoder(0.0), Encoder(0.0))
    return drawn(Case(largest_skew=0.0, duration=4.0, sensors=exact), 1, DRAWS, 41)


def of_draw(i: int, stiffer: float = 1.0) -> Estimation:
    """Return the record of a draw, whose deflection is smaller by a factor, with noise of encoders."""
    record, nominal = read(draws(), i)
    offset, noise = draws().arm.offset[i], np.random.default_rng(i).normal(0.0, NOISE, (2, *record.q_l.shape))
    q_m = record.q_l + (record.q_m - record.q_l - offset) / stiffer + offset
    record = replace(record, q_l=record.q_l + noise[0], q_m=q_m + noise[1])
    return Estimation([record], nominal.robot, prior_of(nominal.robot), IdentifyOptions(threads=1))


def bound(i: int, stiffer: float) -> float:
    """Return what the stiffness of a draw exceeds, 0 if it is known from both sides."""
    setup = of_draw(i, stiffer)
    return seen(setup, filtered_fit(setup, setup.coordinates.mean))["joint0"].at_least


@pytest.mark.parametrize("i", range(DRAWS))
def test_a_stiffness_comes_with_the_deflections_that_were_driven_and_a_very_large_one_with_a_bound(i: int) -> None:
    """Compliances up to 1e3 times smaller are right, though linear interpolation errs by more than they deflect."""
    setup, driven = of_draw(i), np.quantile(draws().deflections(i)[0], (0.01, 0.99))
    z = setup.coordinates.of_values({**setup.prior, **draws().truth(i)})
    np.testing.assert_allclose(deflections(setup, z, 0), driven, atol=2 * NOISE)
    K = float(draws().arm.stiffness[i, 0])
    assert 1e3 * K < bound(i, STIFFER) < STIFFER * K
    assert bound(i, 1e2) == bound(i, 1e3) == 0.0


def test_the_result_says_where_a_stiffness_was_seen_and_what_an_unknown_one_exceeds() -> None:
    setup, told = of_draw(0), []
    for verdict, least in ((IDENTIFIED, 1.5), (UNKNOWN, 2e7), (UNKNOWN, 0.0)):
        K = Estimate("joint_stiffness", "joint0", "N m/rad", 2.0, 1.0, 3.0, 2.0, verdict)
        z = setup.coordinates.of_values({**setup.prior, **draws().truth(0)})
        told += withheld(setup, Estimates((K,), z, np.eye(1)), {"joint0": Seen("", least)}).estimates
    result = Identification(("joint0",), tuple(told), (0,), (LOG,), np.zeros(1), np.eye(1))
    again = Identification.from_dict(json.loads(json.dumps(result.as_dict())))
    low, high = (f"{1e3 * end:.3g}" for end in deflections(setup, z, 0))
    where = f"seen at deflections of {low} to {high} mrad"
    assert lines(again) == [f"joint_stiffness of joint0: {bound}{where}" for bound in ("", "at least 2e+07 N m/rad, ")]
