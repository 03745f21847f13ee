# SPDX-License-Identifier: Apache-2.0
"""The check of the complete sampled loop agrees with the simulated nonlinear loop."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.observer_error import error_radii
from design.stability.test_sampled_loop import elastic_modes, scaled
from fjr_core.config.scenario import load_scenario
from fjr_core.extensions.law_registry import LAWS, law_kind
from fjr_core.law.interfaces import SampledLaw
from fjr_core.model.configuration_sampling import sample_configurations
from fjr_core.numerics.symbolic import NumericFunction
from fjr_core.robust.law import Robust, sampled_law
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_core.stability.linear_controller import Sensing
from fjr_core.stability.linearization import linearize, refuse_fast_integral, spectral_radius
from fjr_design.stability.sampled_loop import contracting
from fjr_design.studies.compare_run import tuned_law
from fjr_design.studies.suite import LawChoice
from fjr_design.tuning.equal_bandwidth import baseline_target
from fjr_design.uncertainty.drawn_loops import radii_with_model_errors

DRAWS = 24
BASELINES = [*LAWS]
MARGIN = 3e-3  # draws with a radius this close to 1 are repeated: a short run cannot decide them
START, FAR, NOTHING = 1e-7, 1e-3, 1e-12  # rad: initial error, error of a diverging loop, rounding
Joint = fjr.TrackingLaw(fjr.single_link(stiffness=31.0), fjr.PAPER_GAINS)


@dataclass(frozen=True)
class Loop:
    """The complete loop: the law with its state, the plant, the configuration, times [s] and sensing."""

    law: SampledLaw
    plant: fjr.Robot
    q_l: np.ndarray
    period: float
    delay: float
    sensing: Sensing

    @property
    def radius(self) -> float:
        """Return the spectral radius by the check."""
        plant = fjr.Plant(self.plant)
        return float(spectral_radius(self.law, self.period, self.delay, [self.q_l], plant, self.sensing)[0])


def random_loop(rng: np.random.Generator) -> Loop:
    """Draw a robot, a law with robust options, an optional observer, a sample rate and a delay."""
    robot, plant = drawn_robot(rng)
    q_l = rng.uniform(-1, 1, robot.n)
    fastest = np.median(elastic_modes(robot, q_l))
    period = round(float(np.clip(10 ** rng.uniform(-1.3, 0.3) / fastest, 2e-4, 0.02)), 6)
    delay = round(float(period * rng.choice([0, 0, 1, rng.uniform(0, 2)])), 6)
    bandwidth = float(rng.uniform(60, 400)) if rng.random() < 0.4 else None
    sensing = Sensing(bandwidth, by_torque=bandwidth is not None and rng.random() < 0.3)
    return Loop(drawn_law(rng, robot, q_l, period, delay), plant, q_l, period, delay, sensing)


def drawn_robot(rng: np.random.Generator) -> tuple[fjr.Robot, fjr.Robot]:
    """Draw the robot of the law and the plant: equal, or without gravity and with another stiffness or inertia."""
    if rng.random() < 0.2:
        robot = fjr.planar_two_link(tuple(40 * 10 ** rng.uniform(-0.5, 0.5, 2)))
        return robot, robot
    stiffness, mistaken = float(10 ** rng.uniform(0, 3)), rng.random() < 0.3
    robot = fjr.single_link(stiffness=stiffness, gravity_torque=0.0 if mistaken else 0.8)
    wrong = {name: getattr(robot, name) * rng.choice([0.7, 0.8, 1.2, 1.3]) for name in (rng.choice(["K", "M_m"]),)}
    return robot, replace(robot, **wrong) if mistaken else robot


def drawn_law(rng: np.random.Generator, robot: fjr.Robot, q_l: np.ndarray, period: float, delay: float) -> SampledLaw:
    """Draw a law with some of the robust options, possibly with prediction over the delay."""
    predicted = Robust(delay=delay, hold=period) if rng.random() < 0.4 else Robust(hold=period)
    residual = 10 ** rng.uniform(1, 2.3, 2) * rng.integers(0, 2, 2)
    if rng.random() < 0.3:
        kind = law_kind(rng.choice(BASELINES))
        law = kind.make(robot, kind.tuning_rule(robot, q_l, rng.uniform(5, 30), kind.default_damping))
        residual_only = replace(predicted, residual_gain=residual[0], motor_residual_gain=residual[1])
        return sampled_law(law, None if law.observes else residual_only)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS if robot.n == 1 and rng.random() < 0.5 else scaled(robot, q_l, rng))
    integral = 10 ** rng.uniform(0.7, 2, 2) * rng.integers(0, 2, 2)
    gains = ("residual_gain", "motor_residual_gain", "integral_gain", "motor_integral_gain")
    return sampled_law(law, replace(predicted, **dict(zip(gains, map(float, [*residual, *integral]), strict=True))))


def converges(loop: Loop, samples: int) -> bool:
    """Return whether the nonlinear loop converges from an error of START, with exactly measured positions."""
    plant, n, T = loop.plant, loop.plant.n, loop.period
    q_m = loop.q_l + np.linalg.solve(plant.K, plant.grad_P_l(loop.q_l))
    rest = np.concatenate([loop.q_l, q_m])
    x = plant.state(*np.split(rest + START * np.cos(np.arange(2 * n)), 2), np.zeros(n), np.zeros(n))
    position, velocity, jets = np.zeros(2 * n), np.zeros(2 * n), np.zeros((5, n))
    jets[0] = loop.q_l
    law, measure = NumericFunction(loop.law.step_function), measuring(loop, position, velocity)
    advance = advancing(loop)
    held = np.linalg.solve(plant.B_m, plant.grad_P_l(loop.q_l))  # before the first command
    efforts, off = [held] * (int(loop.delay / T) + 2), np.zeros(samples)
    sent, memory, gains = held, loop.law.memory, loop.law.gain_values
    for k in range(samples):
        off[k] = np.abs(x[: 2 * n] - rest).max()
        if not off[k] < FAR:
            return False
        measure(k, x, sent)
        dt = T if k else 0.0
        sent, _, memory = law(position, velocity, jets, gains, memory, sent, dt)
        efforts = [sent, *efforts[:-1]]
        x = advance(x, efforts)
    fifth = samples // 5
    return bool(off[-fifth:].max() < max(off[fifth : 2 * fifth].max(), NOTHING))


def measuring(loop: Loop, position: np.ndarray, velocity: np.ndarray) -> Callable[[int, np.ndarray, np.ndarray], None]:
    """Return the function that writes position and velocity for the law from the plant's state at sample k."""
    own, plant, n = loop.law.robot, loop.plant, loop.plant.n
    observer = None if loop.sensing.bandwidth is None else VelocityObserver(own, loop.sensing.bandwidth)

    def measure(k: int, x: np.ndarray, sent: np.ndarray) -> None:
        q_l, q_m = np.split(x[: 2 * n], 2)
        if loop.sensing.by_torque:
            q_m = q_l + np.linalg.solve(own.K, plant.K @ (q_m - q_l))
        if observer is None:
            position[...], velocity[...] = np.concatenate([q_l, q_m]), np.concatenate(plant.velocities(x))
            return
        observer.update(k * round(loop.period * 1e9), q_l, q_m, sent)
        position[...], velocity[...] = np.split(observer.state, 2)

    return measure


def advancing(loop: Loop) -> Callable[[np.ndarray, list[np.ndarray]], np.ndarray]:
    """Return the map of the plant over a sample period under the latest efforts, newest first."""
    step, (whole, late) = fjr.Plant(loop.plant).step_function, divmod(round(loop.delay * 1e6), round(loop.period * 1e6))
    longest = 0.3 / elastic_modes(loop.plant, loop.q_l).max() / 3
    parts = []
    for age, seconds in ((whole + 1, late * 1e-6), (whole, loop.period - late * 1e-6)):
        steps = int(np.ceil(seconds / longest))
        if steps:
            parts.append((age, step.fold(steps) if steps > 1 else step, seconds / steps))

    def advance(x: np.ndarray, efforts: list[np.ndarray]) -> np.ndarray:
        for age, fold, dt in parts:
            x = fold(x, efforts[age], dt).full().ravel()
        return x

    return advance


def test_check_and_simulation_agree_on_random_draws() -> None:
    """Draws within MARGIN of the boundary, which a short run cannot decide, are repeated."""
    rng, stable, unstable = np.random.default_rng(12), 0, 0
    while stable + unstable < DRAWS:
        loop = random_loop(rng)
        radius = loop.radius
        if abs(radius - 1) < MARGIN:
            continue
        samples = int(np.clip(8 / abs(np.log(radius)), 100, 3000))
        assert converges(loop, samples) == (radius < 1), (radius, loop)
        stable, unstable = stable + (radius < 1), unstable + (radius > 1)
    assert min(stable, unstable) >= 6, (stable, unstable)


@pytest.mark.parametrize("by_torque", [False, True])
def test_separation_principle_holds_without_model_error(by_torque: bool) -> None:
    """The oracle error_radii differentiates the update of the observer, including its integrator."""
    q_l, period = np.array([[0.5]]), 1e-3
    for bandwidth in (20.0, 150.0):
        (radius,) = linearize(Joint, q_l, sensing=Sensing(bandwidth, by_torque)).radii(period)
        (loop,), (observer,) = linearize(Joint, q_l).radii(period), error_radii(Joint.robot, bandwidth, period, q_l)
        assert radius == pytest.approx(max(loop, observer), abs=1e-6)


def test_radii_with_model_errors_are_those_of_the_changed_plant() -> None:
    rough = Joint.robot
    plants = {"stiffness": replace(rough, K=1.3 * rough.K), "motor_inertia": replace(rough, M_m=1.3 * rough.M_m)}
    plants["link_inertia"] = fjr.single_link(link_inertia=1.3 * 0.031)
    radii = radii_with_model_errors(Joint, 1e-3, 5e-3, [[0.3]])
    assert len(radii) == 12
    for quantity, plant in plants.items():
        (exact,) = spectral_radius(Joint, 1e-3, 5e-3, [[0.3]], fjr.Plant(plant))
        assert radii[quantity, 1.3] == pytest.approx(exact, rel=1e-4), quantity


@pytest.mark.parametrize("bandwidth", [pytest.param(None, marks=pytest.mark.full), 150.0])
def test_margin_with_integral_action_holds_where_the_arm_is_lightest(bandwidth: float | None) -> None:
    """The gains of the integral are the same everywhere; the loop without it is worst elsewhere."""
    scenario = load_scenario("ros2_ws/src/fjr_bringup/scenarios/two_link.yaml")
    law = sampled_law(fjr.TrackingLaw(scenario.robot, scenario.gains), Robust(integral_gain=20.0))
    sensing, T = Sensing(bandwidth), 1e-3
    margin = fjr.check(law, T, sensing=sensing, lowest_rate=False).delay_margin
    folded = Loop(law, scenario.robot, np.array([2.16, -3.06]), T, 0.0, sensing)
    assert converges(replace(folded, delay=round((margin - 0.05) * T, 6)), 2000)
    assert not converges(replace(folded, delay=round((margin + 0.15) * T, 6)), 2000)


def test_margin_with_the_velocity_observer_holds_at_all_configurations() -> None:
    """The loop of measured velocities is worst elsewhere."""
    scenario = load_scenario("ros2_ws/src/fjr_bringup/scenarios/two_link.yaml")
    law, sensing, T = fjr.TrackingLaw(scenario.robot, scenario.gains), Sensing(150.0), 1e-3
    margin = fjr.check(law, T, sensing=sensing, lowest_rate=False).delay_margin
    everywhere = linearize(law, sensing=sensing)
    assert contracting(everywhere.one_sample_map(T, (margin - 0.02) * T)).all()
    lost = everywhere.at(np.flatnonzero(~contracting(everywhere.one_sample_map(T, (margin + 0.02) * T))))
    q_l = lost.configurations[np.argmax(lost.radii(T, (margin + 0.02) * T))]
    worst = Loop(law, scenario.robot, q_l, T, 0.0, sensing)
    assert converges(replace(worst, delay=round((margin - 0.1) * T, 6)), 1200)
    assert not converges(replace(worst, delay=round((margin + 0.1) * T, 6)), 1200)


ROWS = re.findall(
    r"^\| `(\w+)` \|((?: [\d.]+ \|){5})$", Path("docs/tables/robust.md").read_text(encoding="utf-8"), re.MULTILINE
)


@pytest.mark.parametrize(("name", "row"), ROWS)
def test_documented_integral_rates_are_the_stability_limits(name: str, row: str) -> None:
    scenario = load_scenario(f"ros2_ws/src/fjr_bringup/scenarios/{name}.yaml")
    law, where = fjr.TrackingLaw(scenario.robot, scenario.gains), scenario.configurations(2)
    for hertz, rate in zip((250, 500, 1000, 2000, 10000), row.split("|"), strict=False):
        for factor in (0.9, 1.1):
            sampled = sampled_law(law, Robust(integral_gain=factor * float(rate), hold=1 / hertz))
            assert (spectral_radius(sampled, 1 / hertz, configurations=where).max() < 1) == (factor < 1)


def test_the_docs_have_a_row_for_each_paper_joint_and_the_two_link_arm() -> None:
    assert [name for name, _ in ROWS] == ["paper_k3p1", "paper_k31", "two_link"]


@pytest.mark.parametrize(("stiffness", "rates"), [(3.1, [40.0]), (31.0, [46.9, 50.0])])
def test_integral_gain_above_its_bound_is_refused_with_the_bound(stiffness: float, rates: list[float]) -> None:
    """The nonlinear loop converges at the rate named, and not at one that is 3 % larger."""
    law = fjr.TrackingLaw(fjr.single_link(stiffness=stiffness), fjr.PAPER_GAINS)
    refuse_fast_integral(law, Robust(integral_gain=20.0).checked(1))
    named = []
    for rate in rates:
        words = rf"integral_gain is \[{rate}\] 1/s, .* expected at most \["
        with pytest.raises(fjr.GainsError, match=words) as refusal:
            refuse_fast_integral(law, Robust(integral_gain=rate).checked(1))
        named.append(float(str(refusal.value).rpartition("[")[2].partition("]")[0]))
    worst = max(sample_configurations(law.robot, 3), key=lambda q_l: integrating(law, max(named), q_l).radius)
    assert converges(integrating(law, max(named), worst), 4000)
    assert not converges(integrating(law, 1.03 * min(named), worst), 4000)


def integrating(law: fjr.TrackingLaw, rate: float, q_l: np.ndarray) -> Loop:
    """Return the loop at 1 kHz with integral action at this rate [1/s]."""
    return Loop(sampled_law(law, Robust(integral_gain=rate)), law.robot, q_l, 1e-3, 0.0, Sensing())


def test_comparison_reports_a_law_that_is_unstable_as_sampled() -> None:
    scenario = load_scenario("ros2_ws/src/fjr_bringup/scenarios/paper_k3p1.yaml")
    choices = [LawChoice("v-dPBC", "v_dpbc", {"integral_gain": rate}) for rate in (5.0, 40.0)]
    sentences = [tuned_law(choice, scenario, baseline_target(scenario)).tuning for choice in choices]
    assert ["unstable as sampled" in sentence for sentence in sentences] == [False, True]
