# SPDX-License-Identifier: Apache-2.0
"""The motion that tells the parameters of elastic joints: its information, its limits, and what it gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

import fjr_core as fjr
from fjr_core.errors import TrajectoryError
from fjr_core.runtime.safety_settings import Settings
from fjr_identification.cli.excite import _designed
from fjr_identification.excitation import optimal_design
from fjr_identification.excitation.elastic_motion import (
    PARAMETERS,
    ElasticMotion,
    InformationModel,
    JointNoise,
    elastic_motion,
    encoder_noise,
    motion_envelope,
)
from fjr_identification.excitation.optimal_design import ExcitationDesign, design
from fjr_msgs_py.scenarios import library

NOISE = JointNoise(np.full(2, 1e-5), np.full(2, 2e-5), np.full(2, 1e-2))
FOLLOWED = ("q_l", "q_m", "dq_l", "dq_m", "u", "ddq_m")
SINE = fjr.Sine([0.5, 0.4], 2.0, phase=-np.pi / 2)


def limits(robot: fjr.Robot, reference: fjr.Sine = SINE, **given: float):
    names = tuple(f"joint{i + 1}" for i in range(robot.n))
    settings = Settings(names, **given)
    return motion_envelope(robot, settings, np.full(robot.n, 40.0), reference, 0.9, 5.0)


@pytest.fixture(scope="module", autouse=True)
def short_search():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(optimal_design, "STARTS", 1)
        patch.setattr(optimal_design, "STEPS", 25)
        yield


@pytest.fixture(scope="module")
def found(short_search):
    robot = fjr.planar_two_link()
    ranges = {"link_position_lower": -2.0, "link_position_upper": 2.0}
    bounds = limits(robot, link_velocity=3.0, effort=60.0, deflection=0.5, **ranges)
    return robot, bounds, design(robot, bounds, NOISE, SINE, 5.0, 1e-3)


def test_the_motion_keeps_every_limit_and_starts_and_ends_at_rest(found):
    robot, bounds, result = found
    motion = elastic_motion(robot, result.reference.jets(np.linspace(0, 5, 20001)))
    largest = np.abs(bounds.ratios(np.stack(motion))).max(axis=(1, 2))
    assert largest.max() <= 1.0 + 5e-3
    assert largest.max() > 0.9
    jets = result.reference.jets(np.array([0.0, result.period, result.duration]))
    assert np.allclose(jets[:, 1], 0.0, atol=1e-9)
    assert np.allclose(jets[:, 2], 0.0, atol=1e-8)


def test_hardening_springs_are_deflected_up_to_their_limit_and_the_plant_follows_the_motion() -> None:
    """At the limit of the deflection each spring pulls twice as much as a straight one."""
    straight, most = fjr.planar_two_link(input_gain=[0.5, 2.0]), 0.04
    K = np.diag(straight.K)
    robot = replace(straight, cubic=K / most**2)
    result = design(robot, limits(robot, deflection=most, effort=60.0), NOISE, SINE, 5.0, 1e-3)
    motion = elastic_motion(robot, result.reference.jets(np.linspace(0, 5, 501)))
    zeta = motion.q_m - motion.q_l
    np.testing.assert_allclose(motion.torque, K * (zeta + zeta**3 / most**2), rtol=1e-9, atol=1e-9)
    assert 0.85 * most < np.abs(zeta).max() <= most
    for q_l, q_m, dq_l, dq_m, u, ddq_m in zip(*(getattr(motion, name)[::50] for name in FOLLOWED), strict=True):
        rate = fjr.Plant(robot).derivative(robot.state(q_l, q_m, dq_l, dq_m), u)
        np.testing.assert_allclose(rate[6:], robot.M_m @ ddq_m, rtol=1e-9, atol=1e-9)


def test_the_motion_tells_more_of_every_parameter_than_a_sine_within_the_same_limits(found):
    *_, result = found
    gain = result.before / result.deviations
    assert np.all(gain[:, PARAMETERS.index("joint_stiffness")] > 2)
    assert np.all(gain > 0.8)


def test_equal_seeds_design_equal_motions(found):
    robot, bounds, first = found
    second = design(robot, bounds, NOISE, SINE, 5.0, 1e-3)
    assert np.array_equal(first.reference.amplitude, second.reference.amplitude)


@pytest.mark.parametrize("hard", [False, True])
def test_the_gradient_of_the_search_is_that_of_its_loss(hard):
    robot = replace(fjr.planar_two_link(), cubic=[4e3, 2.5e3]) if hard else fjr.planar_two_link()
    task = ExcitationDesign(robot, limits(robot, link_velocity=0.5, effort=20.0), NOISE, 2.0, 1e-3)
    rng = np.random.default_rng(2)
    c = 20 * task.start(rng)
    direction = rng.standard_normal(c.shape) * np.abs(c)
    h = 1e-6
    given = 1e3, np.array([4.0, 9.0])  # weight of the excess, emphasis on each stiffness
    difference = (task._loss(c + h * direction, *given)[0] - task._loss(c - h * direction, *given)[0]) / (2 * h)
    assert (task._loss(c, *given)[1] * direction).sum() == pytest.approx(difference, rel=1e-4)


def response(w: np.ndarray, u: np.ndarray, J: float, p: np.ndarray) -> np.ndarray:
    """Return the steady state (q_l, q_m) of a linear elastic joint at k instants, by its transfer matrix."""
    K, D_l, M, D_m = np.exp(p[0]), p[1], np.exp(p[2]), p[3]
    s = 1j * w
    matrix = np.array([[J * s**2 + D_l * s + K, -K + 0 * s], [-K + 0 * s, M * s**2 + D_m * s + K]])
    right = np.stack([np.zeros(len(w)), u], axis=1)[..., None]
    return np.fft.irfft(np.linalg.solve(np.moveaxis(matrix, 2, 0), right)[..., 0].T, 2 * (len(w) - 1), axis=1)


def test_the_information_is_that_of_the_outputs_of_the_joint():
    """Oracle: derivatives of the periodic response of a linear joint to a known effort, by differences."""
    J, p, period, k = 0.8, np.array([np.log(500.0), 0.02, np.log(0.3), 0.01]), 2.0, 256
    w = 2 * np.pi * np.arange(k // 2 + 1) / period
    u = np.zeros(len(w), dtype=complex)
    u[[2, 3, 5, 7, 11]] = np.exp(1j * np.arange(5)) * k
    s_l, s_m = 1e-5, 2e-5
    w[0] = 1e-9  # there is no effort at this frequency
    slopes = [(response(w, u, J, p + h) - response(w, u, J, p - h)) / 2e-5 for h in 1e-5 * np.eye(4)]
    scaled = np.stack(slopes) / np.array([s_l, s_m])[:, None]
    expected = 1000 / k * np.einsum("ask,bsk->ab", scaled, scaled)

    q = np.fft.rfft(response(w, u, J, p), axis=1)
    dq_l, dq_m, ddq_l, ddq_m = (
        np.fft.irfft((1j * w) ** i * q[j], k)[:, None] for i, j in ((1, 0), (1, 1), (2, 0), (2, 1))
    )
    motion = ElasticMotion(0 * dq_l, dq_l, ddq_l, J * ddq_l + p[1] * dq_l, 0 * dq_m, dq_m, ddq_m, 0 * dq_m)
    noise = JointNoise(np.array([s_l]), np.array([s_m]), np.array([1e-9]))
    model = InformationModel(np.exp(p[:1]), np.exp(p[2:3]), np.array([J]), noise, period, 1000)
    own = [PARAMETERS.index(name) for name in ("joint_stiffness", "link_damping", "motor_inertia", "motor_damping")]
    assert np.allclose(model.matrices(motion)[0][np.ix_(own, own)], expected, rtol=1e-2, atol=1e-3 * expected.max())


def test_the_noise_of_an_encoder_is_that_of_its_steps():
    noise = encoder_noise(np.array([0.0, 12.0, 0.0]), np.array([0.0, 0.0, 1e-4]), 1e-6)
    assert noise == pytest.approx([1e-6, 2 * np.pi / 4096 / np.sqrt(12), 1e-4])


@pytest.mark.parametrize("springs", [{}, {"robot.cubic_stiffness": [4e3, 2.5e3]}], ids=["straight", "hardening"])
def test_an_input_gain_with_limits_in_its_efforts_changes_no_deviation(
    springs: dict[str, list[float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(optimal_design, "STEPS", 5)
    found = []
    for gain in (1.0, 0.1):
        changes = {"robot.input_gain": [gain] * 2, "limits.effort": [60.0 / gain] * 2, **springs}
        path = library.find("two_link")
        found.append(_designed(library.as_run(path, changes)[1], 3.0, 1e-5, 0))
    assert found[1].before == pytest.approx(found[0].before, rel=1e-6)
    assert found[1].deviations == pytest.approx(found[0].deviations, rel=1e-2)


@pytest.mark.parametrize(
    "changes", [{"stiffness": [[40.0, 5.0], [5.0, 25.0]]}, {"motor_inertia": [[0.02, 0.003], [0.003, 0.01]]}]
)
def test_joints_that_identification_refuses_as_coupled_get_no_motion(changes: dict[str, ArrayLike]) -> None:
    robot = fjr.planar_two_link(**changes)
    with pytest.raises(fjr.ParameterError, match="is not diagonal; expected one number per joint"):
        design(robot, limits(robot), NOISE, SINE, 3.0, 1e-3)


def test_a_short_record_and_a_joint_without_limits_whose_reference_rests_are_refused():
    robot = fjr.planar_two_link()
    with pytest.raises(TrajectoryError, match="lasts 0.01 s; expected at least"):
        design(robot, limits(robot), NOISE, SINE, 0.01, 1e-3)
    with pytest.raises(TrajectoryError, match="'joint2' has no position limit and rests"):
        limits(fjr.planar_two_link(), fjr.Sine([0.5, 0.0], 2.0))
