# SPDX-License-Identifier: Apache-2.0
"""Robots: inertia, energy and Coriolis terms agree with closed forms; configurations are sampled over their ranges."""

from __future__ import annotations

import inspect
from dataclasses import replace
from types import SimpleNamespace
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import scipy.constants
from scipy.stats import qmc

import fjr_core as fjr
from core.oracles.cases import ARMS, HARD, Arm, PlanarTwoLink, SingleLink, random_state
from core.oracles.chains import arm7
from fjr_core.model.configuration_sampling import (
    bounds_of,
    checked_configurations,
    loop_configurations,
    sample_configurations,
)
from fjr_core.model.planar_arms import urdf_of_links
from fuzzing import refused

arms = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
seeds = pytest.mark.parametrize("seed", range(2))


def configuration(arm: Arm, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return tuple(np.random.default_rng(seed).uniform(-3, 3, (3, arm.n)))


@arms
@seeds
def test_closed_forms_of_inertia_coriolis_and_gravity(arm: Arm, seed: int) -> None:
    q, v, w = configuration(arm, seed)
    assert arm.robot.n == arm.n
    assert arm.robot.M_l(q) == pytest.approx(arm.links.M(q), rel=1e-14)
    assert arm.robot.coriolis(q, v, w) == pytest.approx(arm.links.C(q, v) @ w, rel=1e-12, abs=1e-15)
    inertial = arm.links.M(q) @ w + arm.links.C(q, v) @ q
    assert arm.robot.links.inertial_torque(q, v, q, w).full().ravel() == pytest.approx(inertial, rel=1e-12, abs=1e-15)
    assert arm.robot.P_l(q) == pytest.approx(arm.links.P(q), rel=1e-14)
    assert arm.robot.grad_P_l(q) == pytest.approx(arm.links.grad_P(q), rel=1e-13)


def test_each_parameter_of_the_links_enters_the_closed_forms() -> None:
    """The other arms have the default links; none of these numbers is a default."""
    joint = fjr.single_link(link_inertia=0.05, gravity_torque=0.3), SingleLink(0.05, 0.3)
    m, c, inertia = (1.3, 0.7), (0.16, 0.11), (0.012, 0.006)
    arm = fjr.planar_two_link(link_mass=m, link_length=(0.4, 0.2), link_com=c, link_inertia=inertia, gravity=3.7)
    for robot, links in (joint, (arm, PlanarTwoLink(m, 0.4, c, inertia, 3.7))):
        q = np.linspace(0.4, -0.9, robot.n)
        assert robot.M_l(q) == pytest.approx(links.M(q), rel=1e-14)
        assert robot.grad_P_l(q) == pytest.approx(links.grad_P(q), rel=1e-13)


@pytest.mark.parametrize("arm", [ARMS[0], ARMS[-1]], ids=lambda arm: arm.name)
def test_the_bodies_of_a_closed_form_arm_have_its_inertia_and_coriolis_product(arm: Arm) -> None:
    q, v, w = configuration(arm, 1)
    chain = fjr.serial_chain(arm.robot.links.bodies)
    assert chain.M_l(q).full() == pytest.approx(arm.links.M(q), rel=1e-14)
    assert chain.C(q, v, w).full().ravel() == pytest.approx(arm.links.C(q, v) @ w, rel=1e-13, abs=1e-13)


def test_the_default_links_of_the_planar_arm_are_bodies_of_their_length() -> None:
    """Each centre of mass is on its link, and the inertia about it is below that of all mass at the link's ends."""
    given = {name: each.default for name, each in inspect.signature(fjr.planar_two_link).parameters.items()}
    mass, length, com, inertia = (np.array(given[f"link_{name}"]) for name in ("mass", "length", "com", "inertia"))
    assert np.all((com > 0) & (com < length))
    assert np.all((inertia > 0) & (inertia < mass * com * (length - com)))
    assert given["gravity"] == pytest.approx(scipy.constants.g, rel=1e-3)


@arms
@seeds
def test_state_and_velocities_are_inverse_maps_and_momenta_are_M_times_velocity(arm: Arm, seed: int) -> None:
    q_l, dq_l, dq_m = configuration(arm, seed)
    x = arm.robot.state(q_l, q_l + 0.1, dq_l, dq_m)
    wanted = np.concatenate([q_l, q_l + 0.1, arm.links.M(q_l) @ dq_l, arm.M_m @ dq_m])
    assert x == pytest.approx(wanted, rel=1e-13, abs=1e-15)
    for seen, velocity in zip(arm.robot.velocities(x), (dq_l, dq_m), strict=True):
        assert seen == pytest.approx(velocity, rel=1e-12)


@pytest.mark.parametrize("arm", ARMS + HARD, ids=lambda arm: arm.name)
@seeds
def test_hamiltonian_is_kinetic_gravity_and_spring_energy(arm: Arm, seed: int) -> None:
    x = random_state(arm, np.random.default_rng(seed))
    q_l, q_m, p_l, p_m = np.split(x, 4)
    zeta = q_m - q_l
    kinetic = p_l @ np.linalg.solve(arm.links.M(q_l), p_l) / 2 + p_m @ np.linalg.solve(arm.M_m, p_m) / 2
    wanted = kinetic + arm.links.P(q_l) + zeta @ arm.K @ zeta / 2 + arm.cubic @ zeta**4 / 4
    assert arm.robot.hamiltonian(x) == pytest.approx(wanted, rel=1e-13)


def test_single_link_has_the_values_of_table_1() -> None:
    robot = fjr.single_link()
    values = {"K": 31.0, "M_m": 0.004, "D_l": 0.2, "D_m": 0.007, "B_m": 1.0}
    assert {name: getattr(robot, name).item() for name in values} == values
    assert robot.M_l([0.7]).item() == 0.031
    assert robot.P_l([0.7]) == pytest.approx(0.8 * (1 - np.cos(0.7)), rel=1e-15)


@pytest.mark.parametrize("robot", [fjr.single_link(), fjr.planar_two_link()], ids=["one", "two"])
def test_the_urdf_that_shows_an_arm_has_its_dynamics_and_thin_links(robot: fjr.Robot) -> None:
    """Pinocchio reads it; a link is as heavy as a cylinder of its looks about its own axis."""
    text = urdf_of_links("arm", ["a", "b"][: robot.n], robot.links.bodies)
    model = pin.buildModelFromXML(text)
    data, q_l = model.createData(), np.array([0.7, -0.4])[: robot.n]
    q = np.ravel([(np.cos(each), np.sin(each)) for each in q_l])  # continuous joints
    np.testing.assert_allclose(pin.crba(model, data, q), robot.M_l(q_l), rtol=1e-12)
    np.testing.assert_allclose(pin.computeGeneralizedGravity(model, data, q), robot.grad_P_l(q_l), rtol=1e-9)
    for link in ElementTree.fromstring(text).findall("link")[1:]:
        along, across = link.findall("visual/geometry/cylinder")
        inertia, mass = link.find("inertial/inertia").attrib, float(link.find("inertial/mass").get("value"))
        assert float(inertia["izz"]) == pytest.approx(mass * float(along.get("radius")) ** 2 / 2)
        assert float(along.get("length")) > float(across.get("length")) > 2 * float(along.get("radius"))
    turned = [origin.get("rpy").split()[0] for origin in ElementTree.fromstring(text).iterfind("link/visual/origin")]
    assert turned == [repr(np.pi / 2), *["0.0", repr(np.pi / 2)] * robot.n]


def test_a_chain_of_bodies_is_in_standard_gravity_along_minus_z_unless_told_otherwise() -> None:
    arm, q_l = fjr.planar_two_link(gravity=9.81), np.array([0.7, -0.4])
    weight = fjr.serial_chain(arm.links.bodies).grad_P_l(q_l).full().ravel()
    np.testing.assert_allclose(weight, arm.grad_P_l(q_l), rtol=1e-12)


def test_robot_is_immutable() -> None:
    robot = fjr.single_link()
    with pytest.raises(AttributeError):
        robot.K = np.eye(1)
    with pytest.raises(ValueError, match="read-only"):
        robot.K[0, 0] = 2.0
    with pytest.raises(ValueError, match="read-only"):
        replace(robot, cubic=[1.0]).cubic[0] = 2.0


# Configurations: the Halton sequence over the joint ranges; larger sets contain smaller ones.


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


@pytest.mark.parametrize("shape", [(2,), (3, 3), (0, 2), (1, 2, 2)])
def test_configurations_of_another_shape_are_refused(shape: tuple[int, ...]) -> None:
    robot, sentence = fjr.planar_two_link(), f"configurations has shape {shape}; expected (k, 2) with k at least 1"
    refused(fjr.StateError, lambda: checked_configurations(robot, np.zeros(shape)), sentence)


def test_a_side_without_a_limit_is_pi_or_pi_beyond_the_other() -> None:
    limits = SimpleNamespace(lower=np.array([-np.inf, 1.0, -np.inf, -1.0]), upper=np.array([-2.0, np.inf, np.inf, 2.0]))
    lower, upper = bounds_of(SimpleNamespace(n=4, limits=limits))
    np.testing.assert_allclose(lower, [-2 - np.pi, 1, -np.pi, -1])
    np.testing.assert_allclose(upper, [-2, 1 + np.pi, np.pi, 2])
