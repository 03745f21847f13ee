# SPDX-License-Identifier: Apache-2.0
"""The check of the sampled loop agrees with hand-written linear loops and with the simulated nonlinear loop."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.signal import cont2discrete

import fjr_core as fjr
from core.oracles.chains import arm7
from fjr_core.law.linearized import equilibria_at, plant_matrices
from fjr_core.model.configuration_sampling import sample_configurations
from fjr_core.stability.linearization import closed_form, linearize, spectral_radius
from fjr_design.stability.sampled_loop import check
from fjr_msgs_py.scenarios import library
from fuzzing import refused

SAMPLES = 400  # of a simulated run: 0.98^400 = 3e-4, 1.02^400 = 3e3


def chain3(rng: np.random.Generator) -> fjr.Robot:
    """Return a chain of three joints with random axes."""

    def rotation() -> np.ndarray:
        R = polar(rng.normal(size=(3, 3)))[0]
        return R * np.linalg.det(R)

    def body() -> fjr.Body:
        places = rng.uniform(-0.2, 0.2, (2, 3))
        inertia = np.diag(rng.uniform(0.01, 0.015, 3))
        return fjr.Body(rotation(), places[0], rng.normal(size=3), rng.uniform(0.5, 2), places[1], inertia)

    return fjr.Robot(
        fjr.serial_chain([body() for _ in range(3)]),
        M_m=np.diag(rng.uniform(0.02, 0.1, 3)),
        K=np.diag(rng.uniform(50, 300, 3)),
        D_l=np.diag(rng.uniform(0, 0.1, 3)),
        D_m=np.diag(rng.uniform(0, 0.1, 3)),
        B_m=np.diag(rng.uniform(0.5, 2, 3)),
    )


def scaled(robot: fjr.Robot, q_l: np.ndarray, rng: np.random.Generator) -> fjr.Gains:
    """Return gains of random size, proportional to inertia and stiffness of the robot."""
    c_1, c_2, c_3, c_4 = rng.uniform(8, 25, 4)
    M_l, g = robot.M_l(q_l), rng.uniform(0.9, 1.4)
    return fjr.Gains(c_1, c_1**2 * M_l, c_2 * M_l, c_3, g * robot.K, c_4 * robot.M_m)


def elastic_modes(robot: fjr.Robot, q_l: np.ndarray) -> np.ndarray:
    """Return the natural frequencies of the links with fixed motors [rad/s]."""
    return np.sqrt(np.linalg.eigvals(np.linalg.solve(robot.M_l(q_l), robot.K)).real)


def loop_converges(
    law: fjr.TrackingLaw, q_l: np.ndarray, period: float, delay: float = 0.0, samples: int = SAMPLES
) -> bool:
    """Return whether the simulated loop converges from an error of 1e-5 rad to the constant reference q_l."""
    robot, n = law.robot, law.robot.n
    off = 1e-5 * np.cos(np.arange(2 * n))
    q_m = q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l))
    x0 = robot.state(q_l + off[:n], q_m + off[n:], 0, 0)
    inner = 0.2 / elastic_modes(robot, q_l).max()
    reference = fjr.Sine(np.zeros(n), 1.0, q_l)
    try:
        run = fjr.simulate(fjr.Plant(robot), law, reference, x0, samples * period, period, inner, delay)
    except fjr.StateError:
        return False
    part = samples // 5
    return bool(run.V[-part:].max() < run.V[part : 2 * part].max())


# A linear plant, for which all numbers have an independent computation.


def hand_written_law(z: np.ndarray, M: float, Mm: float, K: float, D: float, Dm: float) -> float:
    """Return u of Table 1 at z = (q_l, q_m, dq_l, dq_m) without gravity for q_ld = 0: eqs. (30)-(42) with scalars."""
    q, q_m, dq, dq_m = z
    ddq = (K * (q_m - q) - D * dq) / M
    d3q = (K * (dq_m - dq) - D * ddq) / M

    def u_l(q: float, dq: float) -> float:
        return -M * 10 * dq - D * 10 * q - 20 * q - 0.6 * (dq + 10 * q)

    q_md, dq_md, ddq_md = q + u_l(q, dq) / K, dq + u_l(dq, ddq) / K, ddq + u_l(ddq, d3q) / K
    v_mr = dq_md - 15 * (q_m - q_md) - K / 60 * (dq + 10 * q)
    dv_mr = ddq_md - 15 * (dq_m - dq_md) - K / 60 * (ddq + 10 * dq)
    return Mm * dv_mr + K * (q_m - q) + Dm * v_mr - 60 * (q_m - q_md) - 0.3 * (dq_m - v_mr)


def hand_written_radius(values: tuple[float, ...], period: float, parts: int, late: int) -> float:
    """Return the spectral radius by stepping each unit vector over `parts` steps, with u delayed by `late` steps."""
    M, Mm, K, D, Dm = values
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-K / M, K / M, -D / M, 0], [K / Mm, -K / Mm, 0, -Dm / Mm]])
    B = np.array([[0], [0], [0], [1 / Mm]])
    Phi, Gamma, *_ = cont2discrete((A, B, np.eye(4), np.zeros((4, 1))), period / parts, "zoh")
    waiting = -(-late // parts)  # efforts that do not act yet

    def one_period(state: np.ndarray) -> np.ndarray:
        z, efforts = state[:4], [hand_written_law(state[:4], *values), *state[4:]]  # the newest first
        for step in range(parts):
            age = -((step - late) // parts)
            z = Phi @ z + Gamma[:, 0] * efforts[max(age, 0)]
        return np.concatenate([z, efforts[:waiting]])

    loop = np.array([one_period(unit) for unit in np.eye(4 + waiting)]).T
    return float(np.abs(np.linalg.eigvals(loop)).max())


def linear_joint(stiffness: float) -> tuple[fjr.TrackingLaw, tuple[float, ...]]:
    robot = fjr.single_link(stiffness=stiffness, gravity_torque=0.0)
    return fjr.TrackingLaw(robot, fjr.PAPER_GAINS), (0.031, 0.004, stiffness, 0.2, 0.007)


@pytest.mark.parametrize("stiffness", [3.1, 300.0])
@pytest.mark.parametrize("period", [1e-3, 0.02])
@pytest.mark.parametrize("tenths", [0, 3, 10, 37])
def test_radius_of_a_linear_loop_matches_the_hand_written_loop(stiffness: float, period: float, tenths: int) -> None:
    law, values = linear_joint(stiffness)
    (radius,) = spectral_radius(law, period, tenths / 10 * period, [[0.3]])
    assert radius == pytest.approx(hand_written_radius(values, period, 10, tenths), rel=1e-8)


# Any robot: linearisation and coordinates.


@cache
def small_laws() -> tuple[fjr.TrackingLaw, ...]:
    rng = np.random.default_rng(1)
    robots = (fjr.single_link(), fjr.planar_two_link(), chain3(rng))
    return tuple(fjr.TrackingLaw(robot, scaled(robot, np.full(robot.n, 0.4), rng)) for robot in robots)


def laws() -> tuple[fjr.TrackingLaw, ...]:
    robot = arm7().robot
    return (*small_laws(), fjr.TrackingLaw(robot, scaled(robot, np.full(7, 0.4), np.random.default_rng(2))))


def test_jacobian_of_the_law_is_its_closed_form_at_equilibrium() -> None:
    """The check linearises the law that runs; synthesis uses the closed form."""
    for law in laws():
        loop = linearize(law, sample_configurations(law.robot, 5))
        rest = equilibria_at(law.robot, loop.configurations)
        closed = closed_form(rest, law.gains)
        pairs = ((loop.A, closed.A), (loop.B, closed.B), (loop.law(1e-3).F, closed.law(1e-3).F))
        for found, expected in pairs:
            np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-9 * np.abs(expected).max())


def test_plant_matrices_are_the_jacobian_of_the_dynamics_at_equilibrium() -> None:
    for law in laws():
        rest = equilibria_at(law.robot, sample_configurations(law.robot, 3))
        slope = fjr.Plant(law.robot).dynamics.jacobian()
        for x, u, A, B in zip(rest.x, rest.u, *plant_matrices(rest), strict=True):
            exact = np.hstack([block.full() for block in slope(x, u, 0)])
            np.testing.assert_allclose(np.hstack([A, B]), exact, rtol=1e-9, atol=1e-12 * np.abs(A).max())


def test_loop_in_error_coordinates_contracts_at_the_rate_before_sampling() -> None:
    """-sym(A + B F) >= beta, with equality at the worst configuration: V = |z|^2 / 2."""
    for law in laws():
        q_l = sample_configurations(law.robot, 6)
        loop = linearize(law, q_l)
        generator = loop.A + loop.B @ loop.law(1e-3).F
        fastest = np.linalg.eigvalsh((generator + np.swapaxes(generator, 1, 2)) / 2).max()
        assert -fastest == pytest.approx(law.rate(q_l).beta, rel=1e-6)


def test_radius_tends_to_the_continuous_loop() -> None:
    for law in small_laws():
        loop = linearize(law, sample_configurations(law.robot, 3))
        continuous = np.linalg.eigvals(loop.A + loop.B @ loop.law(1e-3).F).real.max(axis=1)
        for period in (1e-4, 1e-5):
            np.testing.assert_allclose(np.log(loop.radii(period)) / period, continuous, rtol=4e3 * period)


MISTAKEN = {
    "heavy motors": {"motor_inertia": (0.06, 0.03)},
    "light motors": {"motor_inertia": (0.008, 0.004)},
    "heavy first link": {"link_mass": (2.4, 0.5)},
    "load": {"link_mass": (1.2, 3.0), "link_inertia": (0.02, 0.05)},
}


def simulated_radius(law: fjr.TrackingLaw, plant: fjr.Robot, q_l: np.ndarray, period: float, late: float) -> float:
    """Return the radius of z(k) -> z(k + 1) from runs that start 1e-6 off equilibrium; z = (x, last two efforts)."""
    rest, reference, befores, afters = np.hstack([q_l, q_l, 0 * q_l, 0 * q_l]), fjr.Sine(0 * q_l, 1.0, q_l), [], []
    for off in 1e-6 * np.eye(4 * plant.n):
        x0 = plant.state(*np.split(rest + off, 4))
        run = fjr.simulate(fjr.Plant(plant), law, reference, x0, 5 * period, period, 5e-4, late * period)
        u = np.vstack([np.zeros((2, plant.n)), run.u])
        z = np.hstack([run.x - rest, u[1:-1], u[:-2]])
        befores.append(z[:-1])
        afters.append(z[1:])
    before, after = np.vstack(befores), np.vstack(afters)
    size = np.abs(before).max(axis=0)
    loop = np.linalg.lstsq(before / size, after / size)[0]
    return float(np.abs(np.linalg.eigvals(loop)).max())


@pytest.mark.parametrize(("period", "late"), [(1e-3, 1.5), (6e-3, 0.0)])
@pytest.mark.parametrize("name", MISTAKEN)
def test_radius_of_a_law_with_another_inertia_is_that_of_its_simulation(name: str, period: float, late: float) -> None:
    """The law computes momenta with its own inertia. Without gravity both robots have the same equilibria."""
    own, plant = (fjr.planar_two_link(gravity=0.0, **values) for values in ({}, MISTAKEN[name]))
    law, q_l = fjr.TrackingLaw(own, fjr.Gains(8.0, 20.0, 2.0, 12.0, 40.0, 0.5)), np.array([0.3, 0.7])
    (radius,) = spectral_radius(law, period, late * period, [q_l], fjr.Plant(plant))
    assert simulated_radius(law, plant, q_l, period, late) == pytest.approx(radius, rel=1e-4)


# The nonlinear loop.


@pytest.mark.parametrize("stiffness", [31.0, 3.1])
def test_margins_of_the_paper_scenarios_agree_with_simulation(stiffness: float) -> None:
    """The loop converges 10 % inside both margins and does not 10 % outside."""
    law, q_l = fjr.TrackingLaw(fjr.single_link(stiffness), fjr.PAPER_GAINS), np.array([0.4])
    found = check(law, 1e-3, configurations=[q_l])
    assert found.stable
    assert found.lowest_stable_rate is not None
    assert loop_converges(law, q_l, 1e-3, 0.9e-3 * found.delay_margin, 3000)
    assert not loop_converges(law, q_l, 1e-3, 1.1e-3 * found.delay_margin, 3000)
    assert loop_converges(law, q_l, 1 / (1.1 * found.lowest_stable_rate))
    assert not loop_converges(law, q_l, 1 / (0.9 * found.lowest_stable_rate))


def test_a_loop_that_overflows_is_unstable() -> None:
    law = fjr.TrackingLaw(fjr.single_link(1e6), fjr.PAPER_GAINS)
    assert np.isinf(spectral_radius(law, 1e5, configurations=[[np.pi]])[0])


def test_check_of_an_unstable_loop_reports_a_stable_rate() -> None:
    law = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS)
    slow = check(law, 0.02)
    assert not slow.stable
    assert slow.delay_margin == 0
    assert slow.lowest_stable_rate == pytest.approx(check(law, 1e-3).lowest_stable_rate, rel=0.01)
    late = check(law, 1e-3, 8e-3)
    assert not late.stable
    assert late.delay_margin == pytest.approx(check(law, 1e-3).delay_margin, abs=0.02)
    assert late.lowest_stable_rate is None


def test_a_check_without_the_lowest_rate_finds_the_same_margin() -> None:
    law = fjr.TrackingLaw(fjr.planar_two_link(), fjr.synthesize(fjr.planar_two_link(), 5.0, 1e-3))
    whole, quick = check(law, 1e-3), check(law, 1e-3, lowest_rate=False)
    assert (quick.spectral_radius, quick.delay_margin) == (whole.spectral_radius, whole.delay_margin)
    assert quick.lowest_stable_rate is None


def test_table_1_recipe_on_a_stiff_arm_is_unstable_as_sampled_and_in_simulation() -> None:
    law = fjr.TrackingLaw(arm7().robot, fjr.PAPER_GAINS)
    found = check(law, 1e-3)
    assert not found.stable
    assert found.spectral_radius > 2
    assert law.rate().beta > 0  # the continuous-time loop is stable
    assert not loop_converges(law, np.full(7, 0.4), 1e-3, samples=100)


@pytest.mark.parametrize("delay", [0.0, 1.3e-3])
def test_margins_are_where_the_radius_of_the_worst_configuration_crosses_one(delay: float) -> None:
    """The configurations preselected by the closed form give the margins of all configurations."""
    for law in small_laws():
        q_l = sample_configurations(law.robot, 64)
        found, radii = check(law, 1e-3, delay, q_l), spectral_radius(law, 1e-3, delay, q_l)
        assert found.configurations == 64
        assert found.spectral_radius == pytest.approx(radii.max(), rel=1e-12)
        (alone,) = spectral_radius(law, 1e-3, delay, [found.configuration])
        assert found.spectral_radius == pytest.approx(alone, rel=1e-12)
        assert found.lowest_stable_rate is not None
        for side, stable in ((-0.02, True), (0.02, False)):
            assert (spectral_radius(law, 1e-3, (found.delay_margin + side) * 1e-3, q_l).max() < 1) == stable
            slower = (1 + side) / found.lowest_stable_rate
            assert (spectral_radius(law, slower, delay, q_l).max() < 1) == stable


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"sample_period": 0.0}, ("sample_period", "0.0 s", "positive")),
        ({"sample_period": float("nan")}, ("sample_period", "nan", "positive")),
        ({"delay": -1e-3}, ("delay", "-0.001 s", "0 or more")),
        ({"configurations": [[0.0, 1.0]]}, ("configurations", "(1, 2)", "(k, 1)")),
        ({"configurations": []}, ("configurations", "(0,)", "(k, 1)")),
        ({"plant": fjr.Plant(fjr.planar_two_link())}, ("plant and law", "2 and 1", "equal")),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_invalid_arguments_are_refused(arguments: dict[str, object], words: tuple[str, ...]) -> None:
    law = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS)
    for call in (check, spectral_radius):
        refused(fjr.StateError, lambda call=call: call(law, **{"sample_period": 1e-3, **arguments}), *words)


def test_a_delay_in_ms_taken_for_one_in_s_is_refused_at_once() -> None:
    law = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS)
    refused(fjr.StateError, lambda: check(law, 1e-3, 1.0), "delay is 1 s", "at most 64 samples of 0.001 s")


def test_an_unstable_late_loop_of_seven_joints_is_checked_at_few_configurations() -> None:
    arm = library.load("arm7", [])
    given = {"configurations": sample_configurations(arm.robot, 256), "plant": arm.plant, "lowest_rate": False}
    found = check(arm.law, arm.sample_period, 10 * arm.sample_period, **given)
    assert not found.stable
    assert found.configurations < 64
    in_time = check(arm.law, arm.sample_period, **given)
    assert found.delay_margin == pytest.approx(in_time.delay_margin, abs=0.02)
