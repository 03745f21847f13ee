# SPDX-License-Identifier: Apache-2.0
"""Errors of the filtered equations, their fit, and where it replaces a simulation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.elastic_joint import ElasticJoint, multi_sine, usual_record
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import IDENTIFIED, LOG, UNKNOWN, WEAK
from fjr_identification.estimation import optimise
from fjr_identification.estimation.estimation_problem import Estimation
from fjr_identification.estimation.filtered_fit import (
    FilteredEquations,
    Side,
    confounded,
    equation_error,
    filtered_fit,
    simulation_start,
)
from fjr_identification.estimation.identify import MOST, displacement, identify
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import KINDS, SMOOTHING, IdentifyOptions, prior_of
from identification.estimation.test_identify import NOISE, found_in, noisy, robot_like

JOINT = ElasticJoint()


def setup_of(noise: float = NOISE) -> Estimation:
    robot = robot_like(JOINT)
    return Estimation([noisy(*usual_record(), 4e-3, noise=noise)], robot, prior_of(robot), IdentifyOptions())


def test_a_fit_that_does_not_converge_gives_way_to_filtered_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optimise, "MOST_ITERATIONS", 0)
    start = setup_of().prior
    monkeypatch.setattr(f"{identify.__module__}.simulation_start", lambda setup, z: {**setup.prior, **start})
    found = found_in(noisy(*usual_record(), 4e-3), JOINT)
    assert {each.verdict for each in found.values()} <= {WEAK, UNKNOWN}
    stiffness = found["joint_stiffness"]
    assert stiffness.verdict == WEAK
    assert "filtered least squares" in stiffness.reason
    assert stiffness.low < JOINT.K < stiffness.high
    assert stiffness.value == pytest.approx(JOINT.K, rel=0.05)


def test_steps_are_short_on_both_sides_wherever_the_start_puts_the_friction() -> None:
    setup = setup_of()
    longest = []
    for link, motor in ((0.1, 0.0), (0.0, 0.1)):
        friction = {"link_coulomb_friction": np.array([link]), "motor_coulomb_friction": np.array([motor])}
        values = setup.prior | friction
        found = setup.problem(values).segments[0].effort.steps(values)
        assert found is not None
        longest.append(found["rest"])
    np.testing.assert_array_equal(*longest)
    assert np.all(longest[0] < 4e-3)


def test_efforts_in_other_units_with_the_input_gain_that_undoes_them_change_neither_priors_nor_steps() -> None:
    record, load, found = setup_of().records[0], {"motor_load_friction": np.array([0.3])}, []
    for gain in (1.0, -50.0):
        robot = replace(robot_like(JOINT), B_m=np.array([[gain]]))
        options = IdentifyOptions(load_friction=True)
        setup = Estimation([replace(record, u=record.u / gain)], robot, prior_of(robot), options)
        values = setup.prior | load
        steps = setup.problem(values).segments[0].effort.steps(values)
        assert steps is not None
        found.append(np.concatenate([setup.coordinates.width, *steps.values()]))
    np.testing.assert_allclose(*found)


def test_the_fit_and_the_share_of_each_side_are_near_the_truth_and_blocks_add_up_to_its_information() -> None:
    setup = setup_of()
    z = filtered_fit(setup, setup.coordinates.mean)
    assert np.all(z[list(confounded(setup))] == 0.0)
    fitted, shared = setup.coordinates.parameters(z), simulation_start(setup, z)
    assert fitted["joint_stiffness"][0] == pytest.approx(JOINT.K, rel=0.02)
    assert fitted["motor_inertia"][0] == pytest.approx(JOINT.B, rel=0.05)
    assert fitted["motor_damping"][0] == pytest.approx(JOINT.D_l + JOINT.D_m, rel=0.2)
    late = JOINT.D_l / JOINT.K
    assert fitted["link_skew"][0] == pytest.approx(JOINT.skew - late, abs=5e-4)
    assert shared["link_skew"][0] == pytest.approx(JOINT.skew, abs=5e-4)
    parts = equation_error(setup, z)
    H, g = sum(part.H for part in parts), sum(part.g for part in parts)
    assert len(parts) == 4
    turning = [k for k, (name, _) in enumerate(setup.coordinates.free) if name == SMOOTHING]
    assert np.all(np.delete(np.diag(H), turning) > 0)
    at_bound = np.flatnonzero(setup.coordinates.nonnegative & (z == 0))  # as a lag that is not there
    fitted = [k for k in range(len(z)) if k not in (*confounded(setup), *turning, *at_bound)]
    step = np.linalg.solve(H[np.ix_(fitted, fitted)] + np.diag(setup.coordinates.width[fitted] ** -2.0), g[fitted])
    away = (setup.coordinates.mean - z)[fitted] / setup.coordinates.width[fitted]
    assert np.all(np.abs(step) < setup.coordinates.width[fitted] * (0.01 + np.abs(away)))


def test_derivatives_of_both_sides_equal_central_differences() -> None:
    robot = fjr.planar_two_link()
    t = 4e-3 * np.arange(300)
    q = np.column_stack([multi_sine(t, np.array([0.9, 2.1]), 0.5, seed) for seed in (1, 2)])
    record = MotionRecord("a record", ("a", "b"), 4e-3, 3 * q, q, 1.1 * q, np.full_like(q, np.nan))
    setup = Estimation([record], robot, prior_of(robot), IdentifyOptions(position_torque="b", payload=True))
    names, width = setup.coordinates.free, setup.coordinates.width
    z = setup.coordinates.mean + 0.1 * width * np.random.default_rng(3).standard_normal(len(width))
    z = np.where([KINDS[name].coordinate == LOG for name, _ in names], z, np.abs(z))

    def sides(at: Array) -> list[Side]:
        equations = FilteredEquations(setup, at)
        return [side for j in range(2) for side in (*equations.links(j), *equations.motors(j))]

    found = sides(z)
    for k, name in enumerate(names):
        if name[0] == SMOOTHING:  # not fitted to a filtered motion
            continue
        step = 1e-4 * width[k] * np.eye(len(z))[k]
        differences = [
            (before.errors - after.errors) / (2 * step[k])
            for before, after in zip(sides(z - step), sides(z + step), strict=True)
        ]
        for side, difference in zip(found, differences, strict=True):
            error = side.columns.get(name, np.zeros_like(difference)) - difference
            tolerance = 0.2 if name[0] in ("link_skew", "effort_delay") else 1e-5
            assert np.linalg.norm(error) <= 1e-9 + tolerance * np.linalg.norm(difference), name


def test_torques_that_the_model_lacks_are_not_simulated() -> None:
    robot, (u, q_l, q_m) = robot_like(JOINT), usual_record()
    honest = noisy(u, q_l, q_m, 4e-3)
    ripple = 0.3 * np.std(u) * multi_sine(4e-3 * np.arange(len(u)), np.array([0.7, 1.3]), 1.0, 5)
    wrong = replace(honest, u=honest.u + ripple[:, None])
    relative = []
    for record in (honest, wrong):
        setup = Estimation([record], robot, prior_of(robot), IdentifyOptions())
        relative.append(displacement(setup, filtered_fit(setup, setup.coordinates.mean)))
    assert relative[0][0] < 0.1 * MOST
    assert relative[1][0] > MOST
    found = found_in(wrong, JOINT)
    assert found["joint_stiffness"].value == pytest.approx(JOINT.K, rel=0.05)
    assert "filtered least squares" in found["joint_stiffness"].reason


def test_a_link_damping_four_times_too_large_does_not_keep_the_motion_from_being_simulated() -> None:
    robot = fjr.single_link(stiffness=25.0, motor_inertia=0.005, link_damping=4 * JOINT.D_l)
    found = {each.name: each for each in identify([noisy(*usual_record(), 4e-3)], robot, prior_of(robot)).estimates}
    for name, true in (("joint_stiffness", JOINT.K), ("motor_inertia", JOINT.B), ("link_damping", JOINT.D_l)):
        assert found[name].verdict == IDENTIFIED
        assert found[name].value == pytest.approx(true, rel=5e-3)
