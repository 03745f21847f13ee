# SPDX-License-Identifier: Apache-2.0
"""First guesses for an arm from its URDF: joint data of its size, a motion within its limits, gains with a margin."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.chains import ARM7, ARM7_JOINTS
from fjr_core.model.robot import JointLimits
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.urdf.typical_joints import FASTEST_LINK, LARGEST_DEFLECTION, MOTOR_FREQUENCY, typical_joints
from fjr_design.scaffold.first_loop import DELAY_MARGIN, EFFORT, RANGE, VELOCITY, first_gains, first_motion, proposal_of
from two_link_urdf import JOINTS, two_link_urdf


def rigid_arm7() -> fjr.Robot:
    return fjr.robot_from_urdf(ARM7, ARM7_JOINTS, 1.0, 1.0)


def two_link(**limits: float) -> fjr.Robot:
    robot = fjr.robot_from_urdf(two_link_urdf(), JOINTS, [40.0, 25.0], [0.02, 0.01])
    values = {"lower": -3.0, "upper": 3.0, "velocity": 5.0, "effort": 30.0, **limits}
    return replace(robot, limits=JointLimits(**{name: np.full(2, value) for name, value in values.items()}))


def test_guesses_for_a_lightweight_arm_have_the_order_of_such_arms() -> None:
    typical = typical_joints(rigid_arm7())
    assert np.all((typical.stiffness[:5] > 1e3) & (typical.stiffness[:5] < 2e4))
    assert np.all((typical.motor_inertia[:5] > 0.05) & (typical.motor_inertia[:5] < 3))


def test_the_guess_for_a_joint_of_87_newton_metres_has_the_published_motor_inertia() -> None:
    stiffness = 87 / LARGEST_DEFLECTION[0]  # the first joints of the Franka FR3: 0.6057 kg m^2
    assert stiffness / MOTOR_FREQUENCY**2 == pytest.approx(0.6057, rel=0.02)


def test_a_spring_gives_a_degree_at_the_effort_limit_unless_the_joint_carries_little() -> None:
    robot = two_link(effort=10.0)
    where = np.random.default_rng(0).uniform(-3, 3, (2000, 2))
    least_inertia = 1 / np.max([np.diag(np.linalg.inv(robot.M_l(q))) for q in where], axis=0)
    expected = np.minimum(10.0 / np.deg2rad(1.0), FASTEST_LINK**2 * least_inertia)
    assert np.allclose(typical_joints(robot).stiffness, expected, rtol=0.05)  # two digits


def test_guesses_without_effort_limits_are_finite() -> None:
    typical = typical_joints(two_link(effort=np.inf))
    assert np.all(np.isfinite(typical.stiffness) & (typical.stiffness > 0))


def test_an_input_gain_with_limits_in_its_efforts_changes_no_first_loop() -> None:
    gain = 4.0
    plain, geared = (two_link(lower=0.5, upper=0.9, effort=effort) for effort in (8.0, 8.0 / gain))
    geared = replace(geared, B_m=gain * np.eye(2))
    one, other = (proposal_of(robot, JOINTS, "arm") for robot in (plain, geared))
    assert other.motion.offset == pytest.approx(one.motion.offset, rel=1e-12)
    assert other.motion.amplitude == pytest.approx(one.motion.amplitude, rel=1e-12)
    assert other.q_l == pytest.approx(one.q_l, rel=1e-9)


@pytest.mark.parametrize("limits", [{}, {"velocity": 0.05}, {"effort": 6.0}, {"lower": 0.5, "upper": 0.9}])
def test_the_motion_stays_within_ranges_speeds_and_efforts(limits: dict[str, float]) -> None:
    robot = two_link(**limits)
    motion, found = first_motion(robot, JOINTS), robot.limits
    assert found is not None
    reach = motion.motion_bounds(0.0, np.inf)
    assert np.all((reach.lower[0] >= found.lower) & (reach.upper[0] <= found.upper))
    assert np.all(reach.upper[0] - reach.lower[0] <= 2 * RANGE * (found.upper - found.lower) + 1e-12)
    assert np.all(reach.upper[1] <= VELOCITY * found.velocity + 1e-12)
    stiff = replace(robot, K=1e6 * np.eye(2))  # the efforts are those of rigid joints
    torques = [np.array(inverse_dynamics(stiff)(*motion.jets(t))[4]).ravel() for t in np.linspace(0, 2, 41)]
    assert np.max(np.abs(torques) / found.effort) < EFFORT + 0.05
    assert np.allclose(motion.jets(0.0)[1], 0.0, atol=1e-12)


def test_an_arm_that_cannot_carry_its_weight_is_refused_with_the_joint() -> None:
    robot = two_link(effort=0.5, lower=1.4, upper=1.7)
    with pytest.raises(fjr.TrajectoryError, match="joint 'shoulder' has an effort limit of 0.5 N m, and in each of"):
        first_motion(robot, JOINTS)


def test_first_gains_are_stable_with_a_margin_in_the_whole_range() -> None:
    robot = two_link()
    found = first_gains(robot, 1e-3, first_motion(robot, JOINTS).configurations(16))
    again = fjr.check(fjr.TrackingLaw(robot, found.gains), 1e-3)
    assert again.stable
    assert again.delay_margin == found.check.delay_margin >= DELAY_MARGIN


def test_an_arm_too_fast_for_the_loop_is_refused() -> None:
    robot = replace(two_link(), K=1e7 * np.eye(2))
    with pytest.raises(fjr.GainsError, match="no gains of 6 to 0.3 1/s are stable at 1000 Hz") as raised:
        first_gains(robot, 1e-3, np.zeros((1, 2)), joints=JOINTS)
    least, most = (robot.M_l(np.array([0.0, elbow]))[0, 0] for elbow in (np.pi, 0.0))  # folded and stretched
    named = re.search(r"joint 'shoulder' moves (.*) to (.*) kg m\^2", str(raised.value))
    assert [float(each) for each in named.groups()] == pytest.approx([least, most], rel=0.05)
