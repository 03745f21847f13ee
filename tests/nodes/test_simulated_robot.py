# SPDX-License-Identifier: Apache-2.0
"""The simulated robot equals the plant without imperfections; changes keep its motion, and stiff ones are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config.nodes import all_parameters
from fjr_core.config.parameter import complete
from fjr_core.config.plant import (
    channel_errors,
    imperfection_parameters,
    period_jitter,
    plant_parameters,
    sensor_errors,
)
from fjr_core.config.plant import imperfections as build_imperfections
from fjr_core.simulation.imperfections import Imperfections, SensorErrors
from fjr_plant.simulated_robot import SimulatedRobot

INNER = 250_000  # ns
START = {"q_l": [0.4], "q_m": [0.5], "dq_l": [0.3], "dq_m": [-0.2]}


def simulated(
    imperfections: Imperfections | None = None, robot: fjr.Robot | None = None, **options: Any
) -> SimulatedRobot:
    robot = robot or fjr.single_link()
    x0 = robot.state(*START.values())
    integrator = options.pop("integrator", "rk4")
    made = SimulatedRobot(fjr.Plant(robot, integrator), x0, INNER, imperfections, **options)
    made.warm_up()
    return made


def run(robot: SimulatedRobot, milliseconds: int = 40) -> np.ndarray:
    """Return all measurements, every millisecond, under a varying effort."""
    rows = []
    for k in range(robot.time // 1_000_000 + 1, robot.time // 1_000_000 + milliseconds + 1):
        robot.u = np.array([2.0 * np.sin(0.3 * k)])
        robot.advance_to(k * 1_000_000)
        rows.append(np.concatenate(robot.measure()))
    return np.array(rows)


def test_ideal_robot_is_bit_identical_to_the_plant() -> None:
    robot, plant = simulated(), fjr.Plant(fjr.single_link())
    x = fjr.single_link().state(*START.values())
    for k in range(1, 41):
        robot.u = np.array([0.3 * k])
        robot.advance_to(k * 1_000_000)
        for _ in range(4):
            x = plant.step(x, [0.3 * k], INNER * 1e-9)
        assert np.array_equal(robot.x, x)
    position, velocity, effort = robot.measure()
    assert np.array_equal(position, x[:2])
    assert np.array_equal(velocity, np.concatenate(fjr.single_link().velocities(x)))
    assert np.array_equal(effort, [(31.0 * np.diff(x[:2]))[0], 0.3 * 40])


def test_integration_never_exceeds_the_requested_time() -> None:
    robot = simulated(Imperfections(1, coulomb_m=0.1))
    robot.advance_to(INNER * 3 - 1)
    assert robot.time == INNER * 2


NOISY = SensorErrors(1, bits_l=14, position_m=1e-4, velocity_l=0.01)
BAD = Imperfections(
    1,
    coulomb_m=0.05,
    static_m=0.1,
    smoothing=0.05,
    cubic=100,
    hysteresis=0.1,
    slip=0.02,
    ripple=0.1,
    effort_limit=1.5,
    lag=2e-3,
)


FRICTIONS = ("coulomb_l", "coulomb_m", "load_l", "load_m")  # the last two under the weight of the link


def test_run_after_a_reset_is_bit_identical() -> None:
    robot = simulated(BAD, sensor_errors=NOISY, seed=3)
    first = run(robot)
    robot.external = np.array([0.4])
    run(robot, 5)
    robot.reset()
    assert robot.time == 0
    assert not robot.u.any()
    assert not robot.external.any()
    assert np.array_equal(run(robot), first)
    assert np.array_equal(run(simulated(BAD, sensor_errors=NOISY, seed=3)), first)
    assert not np.array_equal(run(simulated(BAD, sensor_errors=NOISY, seed=4)), first)


def test_a_reset_with_a_payload_begins_with_the_same_velocities() -> None:
    robot = simulated(Imperfections(1, payload_mass=0.5, payload_position=(0.2, 0, 0)))
    for _ in range(2):
        position, velocity, _ = robot.measure()
        np.testing.assert_allclose([*position, *velocity], [0.4, 0.5, 0.3, -0.2], rtol=1e-13)
        assert robot.x[2] == pytest.approx((0.031 + 0.5 * 0.2**2) * 0.3)
        run(robot, 3)
        robot.reset()


def test_payload_changes_without_a_jump_of_the_motion() -> None:
    robot = simulated()
    run(robot, 10)
    before = robot.x.copy()
    seen = [np.concatenate(robot.measure())]
    for mass, position in ((0.5, (0.2, 0.0, 0.0)), (0.5, (0.1, 0.1, 0.0)), (0.0, (0.1, 0.1, 0.0))):
        robot.change(Imperfections(1, payload_mass=mass, payload_position=position))
        seen.append(np.concatenate(robot.measure()))
    np.testing.assert_allclose(seen, np.broadcast_to(seen[0], np.shape(seen)), rtol=1e-12)
    np.testing.assert_allclose(robot.x, before, rtol=1e-12)


def test_changed_robot_continues_like_one_built_with_the_new_values() -> None:
    robot, other = simulated(), simulated(BAD)
    run(robot, 10)
    robot.change(BAD)
    other.x, other.pointer.time, other.u = robot.x, robot.time, robot.u
    other._actuator_torque, other._sliders = robot.u, np.diff(robot.x[:2])
    assert np.array_equal(run(robot, 10), run(other, 10))
    robot.change(Imperfections(1))
    other.change(Imperfections(1))
    assert np.array_equal(run(robot, 10), run(other, 10))


def test_enabled_lag_starts_from_the_acting_torque() -> None:
    robot = simulated(Imperfections(1, effort_limit=1.0))
    robot.u = np.array([3.0])
    robot.advance_to(4 * INNER)
    robot.change(Imperfections(1, lag=0.01))
    assert robot.measure()[2][1] == 1.0
    robot.advance_to(8 * INNER)
    assert robot.measure()[2][1] == pytest.approx(3 - 2 * np.exp(-0.1), rel=1e-12)


def test_hysteresis_begins_without_torque_and_keeps_it_at_later_changes() -> None:
    robot = simulated()
    run(robot, 10)
    before = robot.measure()[2][0]
    for torque, slip in ((0.2, 1e-3), (0.2, 1e-3), (0.4, 2e-3)):  # twice the torque at twice the deflection: as stiff
        robot.change(Imperfections(1, hysteresis=torque, slip=slip))
        assert robot.measure()[2][0] == pytest.approx(before, rel=1e-12)
        run(robot, 3)
        robot._sliders = np.diff(robot.x[:2]) - 5e-4
        before = robot.measure()[2][0]
        assert before == pytest.approx(31.0 * np.diff(robot.x[:2])[0] + 0.1, rel=1e-12)
    run(robot, 20)
    robot.reset()
    assert robot.measure()[2][0] == pytest.approx(3.1, rel=1e-12)


def test_acting_torque_is_measured() -> None:
    for imperfections, applied in (
        (None, 2.0),
        (Imperfections(1, effort_limit=0.7), 0.7),
        (Imperfections(1, lag=1), 0),
    ):
        robot = simulated(imperfections)
        robot.u = np.array([2.0])
        assert robot.measure()[2][1] == applied


@pytest.mark.parametrize(
    ("stiff", "sentence"),
    [
        *(({name: 1.0, "smoothing": 1e-4}, "friction damps with .*friction_smoothing_velocity") for name in FRICTIONS),
        ({"hysteresis": 1.0, "slip": 1e-6}, "^springs with hysteresis oscillate at .*; expected at most 1.08e"),
    ],
)
def test_imperfections_too_stiff_for_the_step_are_refused_without_any_change(
    stiff: dict[str, float], sentence: str
) -> None:
    robot, changed = simulated(BAD), Imperfections(1, **stiff)
    for refused in (robot.change, simulated):
        with pytest.raises(fjr.ParameterError, match=sentence):
            refused(changed)
    assert np.array_equal(run(robot), run(simulated(BAD)))
    simulated(changed, integrator="implicit_midpoint")


def test_stiffest_friction_brakes_without_changing_the_sign_of_the_velocity() -> None:
    """At the largest allowed slope a slow motor decelerates in every step and never reverses."""
    steepest = 0.5 / 0.004 * INNER * 1e-9 / 1.999
    robot = simulated(Imperfections(1, coulomb_m=0.5, smoothing=steepest), fjr.single_link(gravity_torque=0.0))
    robot.x = fjr.single_link().state([0.0], [0.0], [0.0], [0.1 * steepest])
    speeds = [robot.measure()[1][1]]
    for k in range(1, 6):
        robot.advance_to(k * INNER)
        speeds.append(robot.measure()[1][1])
    ratios = np.divide(speeds[1:], speeds[:-1])
    assert np.all((ratios > 0.2) & (ratios < 0.5))


# Parameters.


def values(**given: Any) -> dict[str, Any]:
    return complete(all_parameters(plant_parameters, {}), given)


def test_all_are_off_by_default() -> None:
    found = values()
    assert build_imperfections(found, 1).off
    assert sensor_errors(found, 1).off
    assert all(errors.off for errors in channel_errors(found))
    assert period_jitter(found) == 0.0


def test_all_but_the_seed_are_dynamic() -> None:
    assert [p.name for p in imperfection_parameters(1) if not p.dynamic] == ["imperfections.seed"]
