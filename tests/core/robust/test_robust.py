# SPDX-License-Identifier: Apache-2.0
"""Disturbance observer, integral action and Smith predictor, and their effect on the tracking error."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from scipy import signal

import fjr_core as fjr
from core.oracles.cases import ARMS, TORSION, linear
from fjr_core.config.scenario import load_scenario
from fjr_core.errors import StateError
from fjr_core.extensions.law_registry import LAWS, V_DPBC
from fjr_core.law.interfaces import SampledLaw, StaticLaw
from fjr_core.numerics.symbolic import NumericFunction
from fjr_core.robust.integral_action import IntegralAction, gain_values
from fjr_core.robust.law import Robust, RobustLaw, loaded_by_springs, loaded_expression, sampled_law
from fjr_core.robust.smith_predictor import EffortBuffer
from fjr_core.stability.linearization import spectral_radius
from fjr_design.batch import ClosedLoop, Draws

JOINT = fjr.TrackingLaw(fjr.single_link(stiffness=31.0), fjr.PAPER_GAINS)
TWO_LINK = load_scenario("ros2_ws/src/fjr_bringup/scenarios/two_link.yaml")
PLANAR = fjr.TrackingLaw(TWO_LINK.robot, TWO_LINK.gains)
LOOPS = {"joint": JOINT, "two_link": PLANAR}
SINE = fjr.Sine(1.0, 1.0)
PERIOD = 1e-3  # s
ESTIMATE = Robust(residual_gain=60.0, motor_residual_gain=30.0)
INTEGRATE = Robust(integral_gain=5.0, motor_integral_gain=5.0)
BOTH = replace(ESTIMATE, integral_gain=5.0, motor_integral_gain=5.0)


def pushed(robot: fjr.Robot, torque: Any) -> fjr.Robot:
    """Return the robot with a constant torque (n,) [N m] on its links: P_l - torque' q_l."""
    links, q = robot.links, ca.SX.sym("q", robot.n)
    d = ca.DM(np.broadcast_to(np.asarray(torque, dtype=float), robot.n))
    P_l = ca.Function("P_l", [q], [links.P_l(q) - ca.dot(d, q)])
    grad_P_l = ca.Function("grad_P_l", [q], [links.grad_P_l(q) - d])
    return replace(robot, links=replace(links, P_l=P_l, grad_P_l=grad_P_l))


def on_reference(robot: fjr.Robot, reference: fjr.Reference) -> np.ndarray:
    """Return the state with the links on the reference and the springs loaded by gravity."""
    q, dq = reference.jets(0.0)[:2]
    return robot.state(q, q + np.linalg.solve(robot.K, robot.grad_P_l(q)), dq, dq)


def errors(
    law: StaticLaw,
    robust: Robust | None,
    reference: fjr.Reference,
    robot: fjr.Robot,
    seconds: float,
    delay: float = 0.0,
) -> np.ndarray:
    """Return q_l - q_ld (k, n) [rad] of a 1 kHz loop that starts on the reference."""
    plant, sampled, x0 = fjr.Plant(robot), sampled_law(law, robust), on_reference(robot, reference)
    run = fjr.simulate(plant, sampled, reference, x0, seconds, PERIOD, delay=delay)
    return run.x[:, : robot.n] - run.jets[:, 0]


def rms(e: np.ndarray) -> float:
    return float(np.sqrt(np.mean(e**2)))


# --- reduction of the tracking error


actions = pytest.mark.parametrize("robust", [ESTIMATE, INTEGRATE, BOTH], ids=["residual", "integral", "both"])


@actions
def test_constant_load_leaves_no_error_of_a_sine(robust: Robust) -> None:
    """docs/robust.md states the factor of 1000; the error of a hold is that of the test of the equilibrium."""
    plain, better = (rms(errors(JOINT, r, SINE, pushed(JOINT.robot, 0.3), 4.0)[-1000:]) for r in (None, robust))
    assert plain > 0.01
    assert plain > 1000 * better


def test_residual_reduces_the_effect_of_an_inertia_error_threefold() -> None:
    scenario = load_scenario("ros2_ws/src/fjr_bringup/scenarios/arm7.yaml")
    law = fjr.TrackingLaw(scenario.robot, scenario.gains, compile=True)
    slow = fjr.Sine(0.3, 2 * np.pi * 0.2, offset=scenario.reference.jets(0.5)[0])
    heavier, x0 = Draws(1, link_inertia=1.2, gravity=1.2), on_reference(law.robot, slow)
    plain, better = (
        rms(ClosedLoop(law.robot, sampled_law(law, r), slow, x0, 4.0, PERIOD, settle_after=2.0).run(heavier).rms)
        for r in (None, Robust(residual_gain=60.0))
    )
    assert plain > 3 * better


@pytest.mark.parametrize(("name", "samples"), [("joint", 0.5), ("joint", 2.0), ("two_link", 1.0)])
def test_prediction_reduces_the_error_of_a_delay_tenfold(name: str, samples: float) -> None:
    law, delay = LOOPS[name], samples * PERIOD
    reference = SINE if name == "joint" else TWO_LINK.reference
    plain, better = (rms(errors(law, r, reference, law.robot, 3.0, delay)[1000:]) for r in (None, Robust(delay=delay)))
    assert plain > 10 * better


# --- linear analysis: equilibrium and its stability


@actions
def test_equilibrium_under_load_is_on_the_reference_and_stable(robust: Robust) -> None:
    off = errors(PLANAR, robust, fjr.Hold([0.5, -0.4]), pushed(PLANAR.robot, 0.3), 15.0)
    assert np.abs(off).max() > 1e-3
    assert np.abs(off[-1]).max() < 1e-9


def test_integral_gains_are_symmetric_and_positive_definite() -> None:
    values = gain_values(PLANAR, (np.full(2, 3.0), np.zeros(2)))
    K_l, K_m, K_l_inverse, _ = (K.reshape(2, 2) for K in np.split(values, 4))
    np.testing.assert_allclose(K_l, K_l.T, rtol=1e-12)
    assert np.linalg.eigvalsh(K_l).min() > 0
    np.testing.assert_allclose(K_l @ K_l_inverse, np.eye(2), atol=1e-12)
    assert not K_m.any()


# --- the residual


def sampled_run(
    law: SampledLaw, robot: fjr.Robot, x: np.ndarray, jets: np.ndarray, seconds: float, period: float, push: Any
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states, efforts and controller states (k, .) of a sampled law under torques (n,) on the motors."""
    memory, sent, rows, plant = law.memory, np.zeros(robot.n), [], fjr.Plant(robot)
    for k in range(round(seconds / period)):
        velocity, dt = np.concatenate(robot.velocities(x)), period if k else 0.0
        found = law.step_function(x[: 2 * robot.n], velocity, jets.T, law.gain_values, memory, sent, dt)
        sent, _, memory = (each.full().ravel() for each in found)
        rows.append((x, sent, memory))
        acting = sent + np.linalg.solve(robot.B_m, push)
        for _ in range(4):
            x = plant.step(x, acting, period / 4)
    states, efforts, memories = map(np.array, zip(*rows, strict=True))
    return states, efforts, memories


def residual_run(law: fjr.TrackingLaw, gain: float, period: float, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return residuals r (k, 2n) and feedforward torques w (k, n) [N m] under constant torques on links and motors."""
    n, robot, step = law.robot.n, law.robot, RobustLaw(law, Robust(residual_gain=gain, motor_residual_gain=gain))
    x = robot.state(np.full(n, 0.4), np.full(n, 0.4), np.zeros(n), np.zeros(n))
    *_, memory = sampled_run(step, pushed(robot, 0.3), x, np.zeros((5, n)), seconds, period, np.full(n, 0.2))
    parts = step._memory.sizes
    kept = dict(zip(parts, np.split(memory, np.cumsum([*parts.values()])[:-1], axis=1), strict=True))
    return kept["r"], kept["w"]


def test_residual_is_the_torque_through_its_filter() -> None:
    """r = L / (s + L) d and w = (L / (s + L))^3 d for any motion, up to the error of the quadrature."""
    gain, off = 40.0, []
    for period in (2e-3, 1e-3):
        r, w = residual_run(PLANAR, gain, period, 0.3)
        t = period * np.arange(len(r))
        _, first = signal.step(([gain], [1, gain]), T=t)
        _, third = signal.step(([gain**3], np.poly([-gain] * 3)), T=t)
        wanted = np.hstack([np.outer(lag, [d, d]) for lag, d in ((first, 0.3), (first, 0.2), (third, 0.3))])
        off.append(np.max(np.abs(np.hstack([r, w]) - wanted)))
    assert off[1] < 0.02
    assert off[0] > 3 * off[1], "the error must be of second order in the period"


# --- the prediction


def test_effort_buffer_returns_the_acting_efforts() -> None:
    """With irregular samples, each effort acts from its stamp + delay until that of the next one; none is lost."""
    rng, delay, hold = np.random.default_rng(4), 2.3e-3, 1e-3
    waiting, kept = EffortBuffer(1, delay, hold), {"efforts": ca.DM.zeros(4), "ages": ca.DM.zeros(4)}
    stamps = np.cumsum(rng.uniform(0.8e-3, 1.2e-3, 12))
    efforts = np.concatenate([[0.0], rng.uniform(-1, 1, 11)])  # no effort was sent before the first sample
    for k, dt in enumerate(np.diff(stamps, prepend=stamps[0])):
        kept = waiting.step(kept, ca.DM(efforts[k]), ca.DM(dt))
    now = stamps[-1]
    grid = now + (np.arange(2300) + 0.5) * 1e-6
    asked = np.searchsorted(stamps + delay, grid, side="right")  # efforts[k] answers stamps[k - 1]
    pairs = [(float(u), float(length)) for u, length in waiting.acting(kept, 0.0, delay)]
    assert sum(length for _, length in pairs) == pytest.approx(delay)
    assert sum(u * length for u, length in pairs) == pytest.approx(efforts[asked].sum() * 1e-6, abs=2e-6)
    before = now - 1e-3 + (np.arange(1000) + 0.5) * 1e-6
    mean = efforts[np.searchsorted(stamps + delay, before, side="right")].mean()
    assert float(waiting.mean(kept, ca.DM(1e-3))) == pytest.approx(mean, abs=2e-3)


def test_predicted_state_is_the_state_after_the_delay() -> None:
    """The effort is the law at the state after the delay and half a hold under the last effort."""
    law, n, rng = PLANAR, 2, np.random.default_rng(3)
    step, plant = RobustLaw(law, Robust(delay=PERIOD, hold=PERIOD)), fjr.Plant(law.robot)
    x = law.robot.state(*rng.uniform(-0.3, 0.3, (4, n)))
    memory, sent, jets = step.memory, np.zeros(n), rng.uniform(-1, 1, (5, n))
    for k in range(4):
        velocity = np.concatenate(law.robot.velocities(x))
        u, V, memory = step.step_function(
            x[: 2 * n], velocity, jets.T, step.gain_values, memory, sent, PERIOD if k else 0.0
        )
        then = x
        for seconds in (PERIOD, PERIOD / 2):
            for _ in range(40):
                then = plant.step(then, sent, seconds / 40)
        wanted_u, wanted_V = (each.full().ravel() for each in law.command_function(then, jets.T))
        np.testing.assert_allclose(u.full().ravel(), wanted_u, rtol=1e-6)
        np.testing.assert_allclose(float(V), wanted_V, rtol=1e-6)
        for _ in range(40):
            x = plant.step(x, sent, PERIOD / 40)
        sent = rng.uniform(-1, 1, n)


def test_prediction_over_many_holds_is_integrated_in_substeps() -> None:
    """A single step would be unstable on the stiff arm, at the first sample under a long delay and after a gap."""
    scenario = load_scenario("ros2_ws/src/fjr_bringup/scenarios/arm7.yaml")
    law, n, plant = fjr.TrackingLaw(scenario.robot, scenario.gains), scenario.robot.n, fjr.Plant(scenario.robot)
    step, x = RobustLaw(law, Robust(delay=0.03)), scenario.x0
    velocity, jets = np.concatenate(law.robot.velocities(x)), scenario.reference.jets(0.03)
    weight = law.command(x, scenario.reference.jets(0.0))
    memory, first = step.memory, (weight, [(weight, 0.0305)], 0.0)
    gap = (0.9 * weight, [(weight, 0.01), (0.9 * weight, 0.0205)], 0.02)
    for sent, acting, dt in (first, gap):
        u, _, memory = step.step_function(x[: 2 * n], velocity, jets.T, step.gain_values, memory, sent, dt)
        then = x
        for effort, seconds in acting:
            for _ in range(round(seconds / 1e-4)):
                then = plant.step(then, effort, 1e-4)
        np.testing.assert_allclose(u.full().ravel(), law.command(then, jets), rtol=1e-3, atol=1e-3)


# --- limits


def test_integral_does_not_wind_up() -> None:
    """After 1 s in saturation under an excessive load, the overshoot is that of the law without integral action."""
    limit, n = 1.0, 1
    overshoot = []
    for robust in (Robust(residual_gain=1e-9), replace(INTEGRATE, integral_gain=10.0, motor_integral_gain=0.0)):
        step = sampled_law(JOINT, robust)
        jets, position, velocity = np.zeros((5, n)), np.zeros(2 * n), np.zeros(2 * n)
        jets[0] = 0.2
        evaluate, gains, memory, sent = NumericFunction(step.step_function), step.gain_values, step.memory, np.zeros(n)
        heavy, light = (fjr.Plant(pushed(JOINT.robot, torque)) for torque in (-2.0, 0.0))
        x, e = JOINT.robot.state(0.2, 0.2, 0.0, 0.0), []
        for k in range(4000):
            position[...], velocity[...] = x[: 2 * n], np.concatenate(JOINT.robot.velocities(x))
            dt = PERIOD if k else 0.0
            u, _, memory = evaluate(position, velocity, jets, gains, memory, sent, dt)
            sent = np.clip(u, -limit, limit)
            for _ in range(4):
                x = (heavy if k < 1000 else light).step(x, sent, PERIOD / 4)
            e.append(x[0] - 0.2)
        assert np.isfinite(memory).all()
        assert abs(e[-1]) < 1e-4
        overshoot.append(max(e[1000:]))
    assert overshoot[1] < overshoot[0] + 0.05


@pytest.mark.parametrize(("dt", "counts"), [(PERIOD, PERIOD), (2 * PERIOD, 2 * PERIOD), (0.1, 2 * PERIOD)])
def test_integration_over_a_gap_is_limited_to_two_holds(dt: float, counts: float) -> None:
    integral = IntegralAction(JOINT.robot, PERIOD)
    kept = {"integral": ca.DM([1.0, 2.0]), "rate": ca.DM([30.0, -40.0]), "requested": ca.DM(0.5)}
    after = integral.step(kept, ca.DM(0.5), ca.DM(dt)).full().ravel()
    np.testing.assert_allclose(after, [1.0 + 30.0 * counts, 2.0 - 40.0 * counts], rtol=1e-12)


# --- options and wiring


def test_no_options_give_the_nominal_law() -> None:
    assert sampled_law(JOINT) is sampled_law(JOINT, Robust(hold=0.002)) is JOINT
    x0 = JOINT.robot.state(0.5, 0.5, 0.0, 0.0)
    plant = fjr.Plant(JOINT.robot)
    one, other = (fjr.simulate(plant, law, SINE, x0, 0.2, PERIOD) for law in (JOINT, RobustLaw(JOINT, Robust())))
    np.testing.assert_allclose(other.u, one.u, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(other.V, one.V, rtol=1e-9)


@pytest.mark.parametrize(
    "values",
    [
        {"residual_gain": 30.0},
        {"motor_residual_gain": 30.0},
        {"integral_gain": 5.0},
        {"motor_integral_gain": 5.0},
        {"delay": 1e-3},
        {"delay": 1e-3, "hold": 2e-3},
        {"delay": 1e-3, "residual_gain": 30.0, "motor_residual_gain": 20.0, "integral_gain": 3.0},
    ],
)
def test_each_option_changes_the_effort_and_compilation_does_not(values: dict[str, Any]) -> None:
    plant = fjr.Plant(pushed(PLANAR.robot, 0.1))
    machine_code = fjr.TrackingLaw(PLANAR.robot, TWO_LINK.gains, compile=True)
    laws = PLANAR, sampled_law(PLANAR, Robust(**values)), sampled_law(machine_code, Robust(**values))
    plain, robust, fast = (fjr.simulate(plant, law, TWO_LINK.reference, TWO_LINK.x0, 0.2, PERIOD).u for law in laws)
    assert np.max(np.abs(robust - plain)) > 1e-5
    np.testing.assert_allclose(fast, robust, rtol=1e-7, atol=1e-9)


def test_other_gains_reuse_the_function() -> None:
    step = RobustLaw(JOINT, BOTH)
    gains = replace(fjr.PAPER_GAINS, Pi_l=25.0)
    other = step.with_law(JOINT.with_gains(gains))
    assert other.step_function is step.step_function
    fresh = RobustLaw(fjr.TrackingLaw(JOINT.robot, gains), BOTH)
    np.testing.assert_array_equal(other.gain_values, fresh.gain_values)


# --- other laws

BASELINES = tuple(name for name in LAWS if name not in (V_DPBC, "friction_observer", "active_disturbance"))
every_baseline = pytest.mark.parametrize("name", BASELINES)


def baseline(name: str, robot: fjr.Robot, omega: float = 30.0) -> StaticLaw:
    kind = LAWS[name]
    return kind.make(robot, kind.tuning_rule(robot, np.full(robot.n, 0.4), omega, 0.8))


@pytest.mark.parametrize("i", range(len(ARMS)), ids=[arm.name for arm in ARMS])
def test_a_load_that_shifts_the_springs_is_that_of_the_loaded_law(i: int) -> None:
    """v-dPBC has both forms, for any straight springs, damping and input gains."""
    robot, rng = ARMS[i].robot, np.random.default_rng(i)
    law, n = fjr.TrackingLaw(robot, linear(robot.n).gains), robot.n
    at = tuple(ca.DM(rng.uniform(-1, 1, 2 * n)) for _ in range(2))
    jets, gains, known, matched = (ca.DM(rng.uniform(-1, 1, size)) for size in ((n, 5), (1, 1), (n, 3), n))
    gains = ca.DM(law.gain_values)
    found = loaded_by_springs(law, at, jets, gains, known, matched)
    wanted = loaded_expression(law, integrates=False)(*at, jets, gains, known, matched)[:2]
    for one, other in zip(found, wanted, strict=True):
        value = ca.evalf(one).full()
        np.testing.assert_allclose(value, other.full(), rtol=1e-8, atol=1e-9 * np.abs(other.full()).max())


@every_baseline
@pytest.mark.parametrize(("loop", "robust"), [("joint", BOTH), ("two_link", ESTIMATE)])
def test_every_law_leaves_no_error_of_a_constant_load(name: str, loop: str, robust: Robust) -> None:
    robot = LOOPS[loop].robot
    law, q_ld = baseline(name, robot, 30.0 if robot.n == 1 else 15.0), np.full(robot.n, 0.4)
    off = errors(law, robust, fjr.Hold(q_ld), pushed(robot, 0.1), 5.0)
    assert np.abs(off).max() > 1e-4
    assert np.abs(off[-1]).max() < 1e-6


def test_springs_with_a_curve_are_compensated_by_v_dpbc_only() -> None:
    robot = next(arm.robot for arm in TORSION)
    law = fjr.PythonLaw(SimpleNamespace(effort=lambda position, velocity, jets: 0 * jets[0]), robot)
    assert sampled_law(law, Robust(delay=1e-3)).lead == 1.5e-3
    with pytest.raises(fjr.GainsError, match="PythonLaw is given springs with a .*; expected v_dpbc, or robust.delay"):
        sampled_law(law, ESTIMATE)


@pytest.mark.parametrize(
    ("law", "tolerance"),
    [
        *((fjr.TrackingLaw(fjr.single_link(stiffness=k), fjr.PAPER_GAINS), 0.02) for k in (310.0, 31.0, 3.1)),
        *((baseline(name, JOINT.robot), 0.05) for name in ("lqr", "feedback_linearisation")),
    ],
    ids=["k = 310", "k = 31", "k = 3.1", "lqr", "feedback linearisation"],
)
def test_integral_converges_at_its_rate(law: StaticLaw, tolerance: float) -> None:
    """The slowest mode of the sampled loop decays at the rate, to second order; a soft joint amplifies the port."""
    for side in ("integral_gain", "motor_integral_gain"):
        slowest = spectral_radius(sampled_law(law, Robust(**{side: 0.1})), PERIOD, configurations=[[0.5]])[0]
        assert -np.log(slowest) / PERIOD == pytest.approx(0.1, rel=tolerance)


def test_law_with_a_controller_state_requires_a_sample_period() -> None:
    with pytest.raises(StateError, match="law is a RobustLaw without a sample_period"):
        fjr.simulate(fjr.Plant(JOINT.robot), RobustLaw(JOINT, BOTH), SINE, np.zeros(4), 1.0)
