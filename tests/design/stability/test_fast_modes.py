# SPDX-License-Identifier: Apache-2.0
"""The spring that is too fast for a sampled loop: named with its joint, at the limit where gains stop to exist."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.law.linearized import equilibria_at
from fjr_design.stability.fast_modes import lag_limit, late_spring
from fjr_design.tuning.gain_synthesis import synthesize


def one_joint(frequency: float) -> fjr.Robot:
    """Return an undamped joint whose link oscillates on its spring at this frequency [rad/s]."""
    robot = fjr.single_link()
    inertia = float(robot.M_l([0.0])[0, 0])
    stiffness, zero = frequency**2 * inertia, np.zeros((1, 1))
    return replace(robot, K=np.array([[stiffness]]), M_m=np.array([[stiffness / 90**2]]), D_l=zero, D_m=zero)


def sentence(robot: fjr.Robot, delay: float = 0.0) -> str:
    return late_spring(equilibria_at(robot, np.zeros((1, robot.n))), 1e-3, delay, ("knee", "wrist")[-robot.n :])


def test_without_delay_the_limit_is_the_nyquist_frequency() -> None:
    assert lag_limit(1e-3, 0.0) == pytest.approx(2 * np.pi * 500)
    assert lag_limit(1e-3, 1e-3) * (0.5e-3 + 1e-3) == pytest.approx(np.pi / 2)


@pytest.mark.parametrize("delay", [0.0, 1e-3])
def test_no_gains_exist_beyond_the_limit_and_the_joint_is_named(delay: float) -> None:
    limit = lag_limit(1e-3, delay)
    slow, fast = one_joint(0.7 * limit), one_joint(1.6 * limit)
    assert synthesize(slow, 1.0, 1e-3, delay)
    assert sentence(slow, delay) == ""
    with pytest.raises(fjr.GainsError, match="so are all rates down to .*: the spring of joint 'wrist'") as caught:
        synthesize(fast, 1.0, 1e-3, delay, joints=("wrist",))
    assert str(caught.value).endswith(sentence(fast, delay))
    assert f"oscillates at {1.6 * limit:.4g} rad/s, and beyond {limit:.4g} rad/s" in sentence(fast, delay)


def test_the_inertia_is_the_least_that_the_joint_carries_while_the_other_moves_freely() -> None:
    robot = fjr.planar_two_link([40.0, 1e7])
    where = np.column_stack([np.zeros(13), np.linspace(-3, 3, 13)])
    M_l = np.array([robot.M_l(q_l) for q_l in where])
    (a, b), (_, d) = np.moveaxis(M_l, 0, -1)
    least = np.min(d - b * b / a)  # Schur complement
    said = late_spring(equilibria_at(robot, where), 1e-3)
    assert f"the spring of joint 2 with the inertia that it carries ({least:.3g} kg m^2)" in said
    assert f"oscillates at {np.sqrt(1e7 / least):.4g} rad/s" in said


def test_a_prismatic_joint_carries_a_mass() -> None:
    assert " kg)" in sentence(replace(one_joint(5000.0), prismatic=(True,)))
