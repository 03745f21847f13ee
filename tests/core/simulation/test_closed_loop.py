# SPDX-License-Identifier: Apache-2.0
"""The paper's example and a planar arm in closed loop, without ROS, and the figure of a run."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache

import matplotlib as mpl
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import fjr_core as fjr
from core.oracles.cases import PLANAR
from fjr_core.model.robot import PRISMATIC, REVOLUTE
from fjr_core.simulation.closed_loop import PlotError

STIFFNESS = (31.0, 3.1)
PEAK_EFFORT = {31.0: 26.203, 3.1: 255.762}
stiffnesses = pytest.mark.parametrize("k", STIFFNESS)
REFERENCE = fjr.Sine(1.0, 1.0)


def joint(k: float) -> tuple[fjr.Plant, fjr.TrackingLaw, np.ndarray]:
    robot = fjr.single_link(stiffness=k)
    return fjr.Plant(robot), fjr.TrackingLaw(robot, fjr.PAPER_GAINS), robot.state(0.5, 0.5, 0, 0)


@cache
def paper_run(k: float, sample_period: float | None = None) -> fjr.Trajectory:
    plant, law, x0 = joint(k)
    return fjr.simulate(plant, law, REFERENCE, x0, 5.0, sample_period)


@stiffnesses
def test_the_papers_example_in_continuous_time_and_at_1_khz(k: float) -> None:
    """The softer joint needs a much larger effort, at t = 0; V is below its bound, the link at sin t."""
    run, held, beta = paper_run(k), paper_run(k, 1e-3), joint(k)[1].rate().beta
    assert np.argmax(np.abs(run.u)) == 0
    assert np.max(run.V / run.V[0] - np.exp(-2 * beta * run.t)) <= 1e-18
    for of, begin, error in ((run, 1, 1e-8), (held, 2, 1e-5)):
        assert np.max(np.abs(of.x[:, 0] - np.sin(of.t))[of.t >= begin]) < error
        assert np.max(np.abs(of.u)) == pytest.approx(PEAK_EFFORT[k], rel=1e-3)


@stiffnesses
def test_continuous_run_agrees_with_the_closed_form_of_the_errors(k: float) -> None:
    """For one joint and linear phi, the errors satisfy e(t) = exp(A t) e(0) with constant A."""
    M, m, Pi_m = 0.031, 0.004, 60.0
    A = np.array([
        [-10, 0, 1 / M, 0],
        [0, -15, -k / Pi_m / M, 1 / m],
        [-20, k, -(0.2 + 0.6) / M, 0],
        [0, -Pi_m, 0, -(0.007 + 0.3) / m],
    ])  # fmt: skip
    run, law = paper_run(k), joint(k)[1]

    def errors(i: int) -> np.ndarray:
        e = law.evaluate(run.x[i], run.x[i], run.jets[i])
        return np.concatenate([e.q_tilde_l, e.q_tilde_m, e.sigma_l, e.sigma_m])

    start = errors(0)
    for i in (100, 1000, 3000):
        assert errors(i) == pytest.approx(expm(A * run.t[i]) @ start, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize(("duration", "k"), [(0.1, 101), (0.0036, 4), (0.3, 301)])
def test_a_run_has_an_instant_for_each_sample_up_to_its_duration(duration: float, k: int) -> None:
    plant, law, x0 = joint(31.0)
    run = fjr.simulate(plant, law, REFERENCE, x0, duration, 1e-3)
    assert run.t == pytest.approx(1e-3 * np.arange(k), abs=1e-15)
    assert [a.shape for a in (run.x, run.u, run.jets, run.V)] == [(k, 4), (k, 1), (k, 5, 1), (k,)]
    assert np.array_equal(run.x[0], x0)
    assert np.array_equal(run.jets, REFERENCE.jets(run.t))


def planar_arm() -> tuple[fjr.Robot, fjr.Gains, fjr.Sine]:
    robot = fjr.planar_two_link(**PLANAR)
    gains = fjr.Gains(Lambda_l=8, Pi_l=20, K_ld=(2, 0.5), Lambda_m=12, Pi_m=60, K_md=(0.5, 0.3))
    return robot, gains, fjr.Sine((0.8, 0.6), (1.0, 1.7), offset=(0.2, -0.1), phase=(0.0, 0.5))


@pytest.mark.parametrize("samples", [0.0, 1e-9, 0.25, 1.0, 2.6])
def test_delayed_effort_acts_after_the_delay(samples: float) -> None:
    """The oracle is an independent integrator that switches efforts at t_k + delay, from zero effort."""
    period, steps = 2e-3, 12
    plant, law, x = joint(3.1)
    run = fjr.simulate(plant, law, REFERENCE, x, period * steps, period, delay=samples * period)

    def held(t: float) -> np.ndarray:
        k = int(np.floor(t / period - samples + 1e-9))
        return run.u[k] if k >= 0 else np.zeros(1)

    cuts = np.unique(np.concatenate([run.t, (run.t + samples % 1 * period)[:-1]]))
    for start, end in zip(cuts, cuts[1:], strict=False):
        u = held((start + end) / 2)
        x = solve_ivp(lambda _, y, u=u: plant.derivative(y, u), (start, end), x, "DOP853", rtol=1e-12, atol=1e-14).y[
            :, -1
        ]
    assert run.x[-1] == pytest.approx(x, abs=1e-7)
    for state, jets, u in zip(run.x, run.jets, run.u, strict=True):
        assert u == pytest.approx(law.effort(state, state, jets), rel=1e-12)


@pytest.mark.parametrize("sample_period", [1e-3, None])
def test_law_with_another_inertia_receives_the_velocities_of_the_plant(sample_period: float | None) -> None:
    """A continuous run agrees with an independent integrator."""
    robot, gains, reference = planar_arm()
    heavy = fjr.planar_two_link(**{**PLANAR, "link_mass": (2.0, 0.5), "motor_inertia": (0.06, 0.03)})
    plant, law = fjr.Plant(heavy), fjr.TrackingLaw(robot, gains)
    x0 = heavy.state([0.5, 0.1], [0.5, 0.2], [0.3, -0.2], [0.1, 0.4])

    def seen(x: np.ndarray) -> np.ndarray:
        return robot.state(x[:2], x[2:4], *heavy.velocities(x))

    def field(t: float, x: np.ndarray) -> np.ndarray:
        return plant.derivative(x, law.effort(seen(x), seen(x), reference.jets(t)))

    run = fjr.simulate(plant, law, reference, x0, 0.1, sample_period)
    assert np.array_equal(run.x[0], x0)
    for x, jets, u, storage in zip(run.x[::20], run.jets[::20], run.u[::20], run.V[::20], strict=True):
        assert u == pytest.approx(law.effort(seen(x), seen(x), jets), rel=1e-9)
        assert storage == pytest.approx(law.evaluate(seen(x), seen(x), jets).V, rel=1e-9)
    if sample_period is None:
        wanted = solve_ivp(field, (0, run.t[-1]), x0, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        assert run.x[-1] == pytest.approx(wanted, rel=1e-7, abs=1e-9)


mpl.use("Agg")


def test_lines_of_a_figure_are_the_arrays_of_the_run_with_units() -> None:
    robot, gains, reference = planar_arm()
    law, x0 = fjr.TrackingLaw(robot, gains), robot.state(*np.zeros((4, 2)))
    run = fjr.simulate(fjr.Plant(robot), law, reference, x0, 0.05, 1e-3)
    axes = {each.get_ylabel(): each for each in run.plot().axes}
    drawn = {label: np.array([line.get_ydata() for line in each.lines]).T for label, each in axes.items()}
    q_l, q_ld = run.x[:, :2], run.jets[:, 0]
    np.testing.assert_array_equal(drawn["q_l [rad]"], np.hstack([q_l, q_ld]))
    np.testing.assert_array_equal(drawn["q_l - q_ld [rad]"], q_l - q_ld)
    np.testing.assert_array_equal(drawn["u [N m]"], run.u)
    np.testing.assert_array_equal(drawn["V [J]"], run.V[:, None])
    assert all(np.array_equal(line.get_xdata(), run.t) for each in axes.values() for line in each.lines)
    lift = replace(run, units=(PRISMATIC, REVOLUTE))
    labels = {each.get_ylabel() for each in lift.plot().axes}
    assert labels == {"q_l [m, rad]", "q_l - q_ld [m, rad]", "u [N, N m]", "V [J]"}


def test_missing_matplotlib_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(PlotError, match="pip install matplotlib"):
        paper_run(31.0).plot()


# Integrators: order of convergence, and the energy of undamped robots under the implicit midpoint rule.

ORDERS = {"rk4": 4, "implicit_midpoint": 2}
SHORT = 0.2  # s


def walk(plant: fjr.Plant, x: np.ndarray, u: np.ndarray, steps: int) -> np.ndarray:
    for _ in range(steps):
        x = plant.step(x, u, SHORT / steps)
    return x


def measured_order(plant: fjr.Plant, x: np.ndarray, u: np.ndarray, exact: np.ndarray) -> np.ndarray:
    steps = np.array([160, 320, 640])
    errors = [np.max(np.abs(walk(plant, x, u, k) - exact)) for k in steps]
    return -np.diff(np.log2(errors))


@pytest.mark.parametrize("integrator", ORDERS)
@pytest.mark.parametrize("robot", [fjr.single_link(), fjr.planar_two_link()], ids=["single", "planar"])
def test_order_of_convergence_against_a_high_precision_solution(robot: fjr.Robot, integrator: str) -> None:
    n, plant = robot.n, fjr.Plant(robot, integrator)
    x, u = robot.state(np.full(n, 0.8), np.full(n, 0.7), np.full(n, -2), np.full(n, 1)), np.full(n, 0.5)
    run = solve_ivp(lambda _, y: plant.derivative(y, u), (0, SHORT), x, method="DOP853", rtol=1e-13, atol=1e-14)
    assert measured_order(plant, x, u, run.y[:, -1]) == pytest.approx(ORDERS[integrator], abs=0.1)


FREE = fjr.planar_two_link(link_damping=0.0, motor_damping=0.0)
FALL = FREE.state([0.4, -0.25], [0.4, -0.25], [0, 0], [0, 0])
"""An undamped arm falls from rest with unloaded springs."""


def test_implicit_midpoint_conserves_the_energy_of_a_free_robot() -> None:
    """Over 10 s at 1 ms the energy stays within 1e-6 of its initial value and does not drift."""
    plant, x, u, H = fjr.Plant(FREE, "implicit_midpoint"), FALL, np.zeros(2), []
    for _ in range(10_000):
        H.append(FREE.hamiltonian(x))
        x = plant.step(x, u, 1e-3)
    H = np.array(H) / H[0]
    assert np.max(np.abs(H - 1)) <= 1e-6
    wobble = np.max(H) - np.min(H)
    assert abs(np.mean(H[-2000:]) - np.mean(H[:2000])) <= 0.05 * wobble
    assert abs(np.polyfit(np.linspace(0, 1, len(H)), H, 1)[0]) <= 0.05 * wobble


@pytest.mark.parametrize("integrator", ORDERS)
def test_steps_far_from_the_origin(integrator: str) -> None:
    """Whole turns of the joint do not change a step, even under a large effort."""
    robot = fjr.single_link()
    plant, turns = fjr.Plant(robot, integrator), 2 * np.pi * 1000
    near, far = (robot.state(0.3 + q, 0.5 + q, 5, -3) for q in (0.0, turns))
    steps = [plant.step(x, [250.0], 1e-3) for x in (near, far)]
    assert steps[1] - steps[0] == pytest.approx(np.array([turns, turns, 0, 0]), abs=1e-9)


@pytest.mark.parametrize("dt", [1e-3, -1e-3, 0.1, 10.0])
def test_implicit_midpoint_solves_its_equation_even_for_huge_steps(dt: float) -> None:
    """The equation is symmetric in time."""
    plant, u = fjr.Plant(FREE, "implicit_midpoint"), np.array([0.3, -0.2])
    z = plant.step(FALL, u, dt)
    assert z - FALL == pytest.approx(dt * plant.derivative((FALL + z) / 2, u), abs=1e-11)


@pytest.mark.parametrize("integrator", ORDERS)
def test_error_of_a_run_has_the_order_of_the_integrator_in_the_inner_step(integrator: str) -> None:
    """The error is that with respect to a fine run."""
    fine, law, x0 = joint(31.0)
    exact = fjr.simulate(fine, law, REFERENCE, x0, 0.2, 4e-3, 1e-4).x[-1]
    plant = fjr.Plant(law.robot, integrator)
    ends = [fjr.simulate(plant, law, REFERENCE, x0, 0.2, 4e-3, h).x[-1] for h in (4e-3, 2e-3)]
    errors = [np.max(np.abs(end - exact)) for end in ends]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(ORDERS[integrator], abs=0.6)
