# SPDX-License-Identifier: Apache-2.0
"""Sampled configurations: the Halton sequence of SciPy over the joint ranges; larger sets contain smaller ones."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import qmc

import fjr_core as fjr
from core.oracles.chains import arm7
from fjr_core.model.configuration_sampling import bounds_of, loop_configurations, sample_configurations


@pytest.mark.parametrize("robot", [fjr.single_link(), fjr.planar_two_link(), arm7().robot], ids=["one", "two", "seven"])
def test_the_sequence_is_that_of_halton_within_the_joint_ranges(robot: fjr.Robot) -> None:
    lower, upper = bounds_of(robot)
    found = sample_configurations(robot, 200)
    np.testing.assert_array_equal(found[0], np.clip(0.0, lower, upper))
    halton = qmc.Halton(robot.n, scramble=False).random(200)[1:]  # its first is 0
    np.testing.assert_allclose(found[1:], qmc.scale(halton, lower, upper), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(sample_configurations(robot, 60), found[:60])


def test_half_of_the_configurations_of_a_loop_align_axes() -> None:
    found = loop_configurations(fjr.planar_two_link())
    sampled = sample_configurations(fjr.planar_two_link(), 1024)
    np.testing.assert_array_equal(found[:512], sampled[:512])
    aligned = found[512:] == 0
    np.testing.assert_array_equal(found[512:][~aligned], sampled[512:][~aligned])
    assert 0.4 < aligned.mean() < 0.6


def test_a_side_without_a_limit_is_pi_or_pi_beyond_the_other() -> None:
    limits = SimpleNamespace(lower=np.array([-np.inf, 1.0, -np.inf, -1.0]), upper=np.array([-2.0, np.inf, np.inf, 2.0]))
    lower, upper = bounds_of(SimpleNamespace(n=4, limits=limits))
    np.testing.assert_allclose(lower, [-2 - np.pi, 1, -np.pi, -1])
    np.testing.assert_allclose(upper, [-2, 1 + np.pi, np.pi, 2])
