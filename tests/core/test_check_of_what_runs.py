# SPDX-License-Identifier: Apache-2.0
"""The check of the sampled loop with everything that runs, against the simulated nonlinear loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from test_sampled_loop import elastic_modes, scaled

import fjr_core as fjr
from fjr_core.laws import LAWS, law_kind
from fjr_core.linear_controller import Sensing
from fjr_core.observer import VelocityObserver
from fjr_core.robust import Robust, sampled_law
from fjr_core.sampled_law import SampledLaw, bound_step
from fjr_core.sampled_loop import spectral_radius

DRAWS = 60
BASELINES = [name for name, kind in LAWS.items() if kind.standard is not None]
HAIR = 3e-3  # draws whose radius is nearer to 1 are drawn again: a short run cannot tell them
START, FAR, NOTHING = 1e-7, 1e-3, 1e-12  # rad: error at the start, of a loop that diverges, and rounding
Joint = fjr.TrackingLaw(fjr.single_link(stiffness=31.0), fjr.PAPER_GAINS)


@dataclass(frozen=True)
class Loop:
    """Everything that runs: the law with its state, the plant, the configuration, times [s] and sensing."""

    law: SampledLaw
    plant: fjr.Robot
    q_l: np.ndarray
    period: float
    delay: float
    sensing: Sensing

    @property
    def radius(self) -> float:
        """Spectral radius by the check."""
        plant = fjr.Plant(self.plant)
        return float(spectral_radius(self.law, self.period, self.delay, [self.q_l], plant, self.sensing)[0])


def drawn(rng: np.random.Generator) -> Loop:
    """A robot, a law on it with robust options, an observer or none, a rate and a delay."""
    robot, plant = drawn_robot(rng)
    q_l = rng.uniform(-1, 1, robot.n)
    fastest = np.median(elastic_modes(robot, q_l))
    period = round(float(np.clip(10 ** rng.uniform(-1.3, 0.3) / fastest, 2e-4, 0.02)), 6)
    delay = round(float(period * rng.choice([0, 0, 1, rng.uniform(0, 2)])), 6)
    bandwidth = float(rng.uniform(60, 400)) if rng.random() < 0.4 else None
    sensing = Sensing(bandwidth, by_torque=bandwidth is not None and rng.random() < 0.3)
    return Loop(drawn_law(rng, robot, q_l, period, delay), plant, q_l, period, delay, sensing)


def drawn_robot(rng: np.random.Generator) -> tuple[fjr.Robot, fjr.Robot]:
    """The law's robot, and the plant: the same, or without weight one whose stiffness or inertia is off."""
    if rng.random() < 0.2:
        robot = fjr.planar_two_link(tuple(40 * 10 ** rng.uniform(-0.5, 0.5, 2)))
        return robot, robot
    stiffness, mistaken = float(10 ** rng.uniform(0, 3)), rng.random() < 0.3
    robot = fjr.single_link(stiffness=stiffness, gravity_torque=0.0 if mistaken else 0.8)
    wrong = {name: getattr(robot, name) * rng.choice([0.7, 0.8, 1.2, 1.3]) for name in (rng.choice(["K", "M_m"]),)}
    return robot, replace(robot, **wrong) if mistaken else robot


def drawn_law(rng: np.random.Generator, robot: fjr.Robot, q_l: np.ndarray, period: float, delay: float) -> SampledLaw:
    """A baseline, or v-dPBC with some of the robust options; some of it predicts over the delay."""
    predicted = Robust(delay=delay, hold=period) if rng.random() < 0.4 else Robust(hold=period)
    if rng.random() < 0.3:
        kind = law_kind(rng.choice(BASELINES))
        assert kind.standard is not None
        return sampled_law(kind.make(robot, kind.standard(robot, q_l, rng.uniform(5, 30), kind.usual)), predicted)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS if robot.n == 1 and rng.random() < 0.5 else scaled(robot, q_l, rng))
    residual = 10 ** rng.uniform(1, 2.3, 2) * rng.integers(0, 2, 2)
    integral = 10 ** rng.uniform(0.7, 2, 2) * rng.integers(0, 2, 2)
    gains = ("residual_gain", "motor_residual_gain", "integral_gain", "motor_integral_gain")
    return sampled_law(law, replace(predicted, **dict(zip(gains, map(float, [*residual, *integral]), strict=True))))


def dies_out(loop: Loop, samples: int) -> bool:
    """Whether the nonlinear loop returns to rest that starts START off, its positions measured without errors."""
    plant, n, T = loop.plant, loop.plant.n, loop.period
    q_m = loop.q_l + np.linalg.solve(plant.K, plant.grad_P_l(loop.q_l))
    rest = np.concatenate([loop.q_l, q_m])
    x = plant.state(*np.split(rest + START * np.cos(np.arange(2 * n)), 2), np.zeros(n), np.zeros(n))
    position, velocity, jets = np.zeros(2 * n), np.zeros(2 * n), np.zeros((5, n))
    jets[0] = loop.q_l
    step, measure = bound_step(loop.law, position, velocity, jets), measuring(loop, position, velocity)
    advance = advancing(loop)
    held = np.linalg.solve(plant.B_m, plant.grad_P_l(loop.q_l))  # before the first answer
    efforts, off = [held] * (int(loop.delay / T) + 2), np.zeros(samples)
    step.sent[...] = held
    for k in range(samples):
        off[k] = np.abs(x[: 2 * n] - rest).max()
        if not off[k] < FAR:
            return False
        measure(k, x, step.sent)
        step.dt[0] = T if k else 0.0
        step.evaluate()
        step.keep()
        step.sent[...] = step.u
        efforts = [step.u.copy(), *efforts[:-1]]
        x = advance(x, efforts)
    fifth = samples // 5
    return bool(off[-fifth:].max() < max(off[fifth : 2 * fifth].max(), NOTHING))


def measuring(loop: Loop, position: np.ndarray, velocity: np.ndarray) -> Callable[[int, np.ndarray, np.ndarray], None]:
    """What fills position and velocity for the law from sample k of the plant's state."""
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
    """The plant's motion over a sample period under the efforts of the last samples, the newest first."""
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


def test_check_and_simulation_agree_on_60_draws() -> None:
    """Draws within HAIR of the boundary, where a short run cannot tell, are drawn again."""
    rng, stable, unstable = np.random.default_rng(12), 0, 0
    while stable + unstable < DRAWS:
        loop = drawn(rng)
        radius = loop.radius
        if abs(radius - 1) < HAIR:
            continue
        samples = int(np.clip(8 / abs(np.log(radius)), 100, 3000))
        assert dies_out(loop, samples) == (radius < 1), (radius, loop)
        stable, unstable = stable + (radius < 1), unstable + (radius > 1)
    assert min(stable, unstable) >= 20, (stable, unstable)
