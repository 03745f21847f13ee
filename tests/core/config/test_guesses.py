# SPDX-License-Identifier: Apache-2.0
"""Guessed joint data: each value that equals its guess is reported, until it is replaced."""

from __future__ import annotations

import pytest

from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_core.errors import ParameterError

SCENARIO = """
/**:
  ros__parameters:
    joints: [a, b]
    robot:
      model: planar_two_link
      joint_stiffness: [{stiffness}]
      motor_inertia: [0.02, 0.01]
      {guesses}
    initial_link_position: [0.1, 0.1]
    initial_motor_position: [0.1, 0.1]
    reference: {{type: hold, offset: [0.0, 0.0]}}
"""
BOTH = "guesses: {joint_stiffness: [40.0, 25.0], motor_inertia: [0.0, 0.01]}"


def loaded(stiffness: str = "40.0, 25.0", guesses: str = BOTH) -> Scenario:
    return parse_scenario("mine", SCENARIO.format(stiffness=stiffness, guesses=guesses))


def test_values_that_equal_their_guess_are_counted() -> None:
    stiffness, inertia = loaded().robot_warnings
    assert stiffness.startswith("joint stiffness of 2 joints is a guess; replace it by a measured or data-sheet value")
    assert inertia.startswith("motor inertia of joint b is a guess")


@pytest.mark.parametrize("stiffness", ["41.0, 25.0", "41.0, 1.0, 1.0, 25.0"])
def test_a_replaced_value_is_no_guess_any_more(stiffness: str) -> None:
    assert "joint stiffness of joint b is a guess" in loaded(stiffness).robot_warnings[0]


def test_without_guesses_there_is_no_warning() -> None:
    assert loaded(guesses="").robot_warnings == ()
    assert loaded("41.0, 26.0", "guesses: {joint_stiffness: [40.0, 25.0]}").robot_warnings == ()


def test_guesses_do_not_change_the_robot() -> None:
    assert loaded().robot.fingerprint() == loaded(guesses="").robot.fingerprint()


def test_a_negative_guess_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"'robot.guesses.joint_stiffness' holds -1.0; expected at least 0"):
        loaded(guesses="guesses: {joint_stiffness: [-1.0, 25.0]}")
