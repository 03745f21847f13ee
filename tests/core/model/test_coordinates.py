# SPDX-License-Identifier: Apache-2.0
"""Change of coordinates between velocities and momenta: closed forms, inverse maps, and views between two robots."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import ARMS, Arm
from fjr_core.model.robot import Coordinates, law_view

arms = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)


def measured(arm: Arm) -> tuple[np.ndarray, np.ndarray]:
    position, velocity = np.random.default_rng(5).uniform(-3, 3, (2, 2 * arm.n))
    return position, velocity


@arms
def test_momenta_are_inertia_times_velocity(arm: Arm) -> None:
    n, (position, velocity) = arm.n, measured(arm)
    x = Coordinates(arm.robot).to_momenta(position, velocity).full().ravel()
    p_l, p_m = arm.links.M(position[:n]) @ velocity[:n], arm.M_m @ velocity[n:]
    np.testing.assert_allclose(x, np.concatenate([position, p_l, p_m]), rtol=1e-13)
    np.testing.assert_array_equal(x, arm.robot.state(*np.split(position, 2), *np.split(velocity, 2)))


@arms
def test_the_maps_are_inverse(arm: Arm) -> None:
    position, velocity = measured(arm)
    coordinates = Coordinates(arm.robot)
    x = coordinates.to_momenta(position, velocity)
    np.testing.assert_allclose(coordinates.to_velocities(x).full().ravel(), velocity, rtol=1e-12)
    same, found = (part.full().ravel() for part in coordinates.to_measured(x))
    np.testing.assert_array_equal(same, position)
    np.testing.assert_array_equal(found, Coordinates(arm.robot).to_velocities(x).full().ravel())


def test_law_with_another_inertia_receives_the_velocities_of_the_plant() -> None:
    plant, law = fjr.planar_two_link(link_mass=(1.3, 0.7)), fjr.planar_two_link()
    x = plant.state((0.4, -1.1), (0.5, -1.0), (1.2, 0.3), (-0.7, 2.0))
    view = law_view(plant, law)
    assert view is not None
    np.testing.assert_allclose(np.hstack(law.velocities(view(x).full().ravel())), np.hstack(plant.velocities(x)))


def test_robots_of_equal_inertia_share_the_state() -> None:
    assert law_view(fjr.planar_two_link(stiffness=(40.0, 25.0)), fjr.planar_two_link(stiffness=(31.0, 31.0))) is None
