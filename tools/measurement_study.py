# SPDX-License-Identifier: Apache-2.0
"""Study of sensors and observers: simulate a sampled loop with quantised, noisy sensors and the velocity observer.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.measurement_study

writes the tables of docs/tables/measurements.md between their markers; seeded, so that they repeat. No ROS.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.figures import put
from fjr_core import Plant, single_link
from fjr_core.config.controller import BANDWIDTH
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.runtime.velocity_observer import VelocityObserver

SCENARIOS = Path(__file__).resolve().parents[1] / "ros2_ws" / "src" / "fjr_bringup" / "scenarios"
START = 1_000_000_000  # ns; stamp of the first sample
TORQUE_RANGES = {"paper_k31": 5.0, "paper_k3p1": 5.0, "two_link": 50.0, "arm7": 200.0}  # N m, of the torque sensors
BANDWIDTHS = (30.0, 60.0, 100.0, 150.0, 200.0, 300.0, 500.0)  # rad/s
SETTLED = 2.0  # s


@dataclass(frozen=True)
class Sensors:
    """Sensors of q_l and q_m: encoders on both sides, or a joint torque sensor instead of the motor encoder.

    bits: encoder resolution per turn of its shaft, 0: exact. gear_ratio: turns of the motor shaft per turn of q_m.
    torque_range [N m]: of the torque sensors, 0: none; torque_bits: over +-range; torque_noise: standard deviation
    relative to the range, seeded.
    """

    bits: int = 0
    gear_ratio: float = 1.0
    torque_range: float = 0.0
    torque_bits: int = 16
    torque_noise: float = 5e-4

    def read(self, robot: Robot, q_l: Array, q_m: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return measured (q_l, q_m) [rad]."""
        encoder = 2 * np.pi / 2**self.bits if self.bits else 0.0
        link = _rounded(q_l, encoder)
        if not self.torque_range:
            return link, _rounded(q_m * self.gear_ratio, encoder) / self.gear_ratio
        noise = self.torque_noise * self.torque_range * rng.standard_normal(robot.n)
        torque = _rounded(robot.K @ (q_m - q_l) + noise, 2 * self.torque_range / 2**self.torque_bits)
        return link, link + np.linalg.solve(robot.K, torque)


@dataclass(frozen=True)
class Run:
    """A run of k samples: t (k,) [s], q_tilde_l (k, n) [rad], u (k, n) [N m], velocity errors (k, 2n) [rad/s]."""

    t: Array
    q_tilde_l: Array
    u: Array
    velocity_error: Array

    def rms(self, start: float) -> float:
        """Return the RMS of q_tilde_l from `start` [s] on, of the worst joint [rad]."""
        return float(np.sqrt(np.mean(self.q_tilde_l[self.t >= start] ** 2, axis=0)).max())

    def largest(self, start: float) -> float:
        """Return the largest |q_tilde_l| from `start` [s] on, of all joints [rad]."""
        return float(np.abs(self.q_tilde_l[self.t >= start]).max())

    def ripple(self, start: float) -> float:
        """Return the RMS change of u between samples from `start` [s] on, of the worst joint [N m]."""
        return float(np.sqrt(np.mean(np.diff(self.u[self.t >= start], axis=0) ** 2, axis=0)).max())


def scenario(name: str) -> Scenario:
    """Load an installed scenario."""
    return load_scenario(SCENARIOS / f"{name}.yaml")


def run(
    scenario: Scenario,
    sensors: Sensors,
    bandwidth: float | None,
    smoothed: bool = True,
    duration: float = 5.0,
    plant: Plant | None = None,
) -> Run:
    """Simulate the loop. bandwidth [rad/s]: of the observer; None: exact velocities.

    smoothed: feed back the positions of the observer instead of the measured ones. plant: replaces the scenario's.
    """
    robot, plant, n = scenario.robot, plant or scenario.plant, scenario.robot.n
    period = round(scenario.sample_period * 1e9)
    steps = int(scenario.plant_values["inner_steps"])  # type: ignore[arg-type]
    observer = VelocityObserver(robot, bandwidth, compile=True) if bandwidth else None
    rng, x = np.random.default_rng(0), scenario.x0
    u: Array = np.zeros(n)
    t = np.asarray(scenario.sample_period * np.arange(int(duration / scenario.sample_period + 1e-9) + 1), dtype=float)
    jets = scenario.reference.jets(t)
    error, efforts, velocity_error = np.empty((len(t), n)), np.empty((len(t), n)), np.zeros((len(t), 2 * n))
    for k in range(len(t)):
        position: Array = np.concatenate(sensors.read(plant.robot, x[:n], x[n : 2 * n], rng))
        exact = np.concatenate(plant.robot.velocities(x))
        velocity: Array = exact
        if observer:
            observer.update(START + k * period, position[:n], position[n:], u)
            velocity = observer.state[2 * n :]
            position = observer.state[: 2 * n] if smoothed else position
        error[k], velocity_error[k] = x[:n] - jets[k, 0], velocity - exact
        u = efforts[k] = scenario.law.measured_command(position, velocity, jets[k])[0]
        for _ in range(steps):
            x = plant.step(x, u, period * 1e-9 / steps)
    return Run(t, error, efforts, velocity_error)


def _rounded(values: Array, step: float) -> Array:
    return np.round(values / step) * step if step else values


def modes(scenario: Scenario, torque_range: float) -> Iterator[tuple[str, Run]]:
    """Yield a description of each sensor set with its run; torque_range [N m] of the torque sensors."""
    exact, encoders = Sensors(), Sensors(bits=16)
    yield "all measured, exact", run(scenario, exact, None)
    yield "all measured, encoders", run(scenario, encoders, None)
    yield "observer, exact positions", run(scenario, exact, BANDWIDTH)
    yield "observer, encoders", run(scenario, encoders, BANDWIDTH)
    yield "observer, encoders, positions not smoothed", run(scenario, encoders, BANDWIDTH, smoothed=False)
    yield "observer, encoders, gear ratio 100", run(scenario, Sensors(bits=16, gear_ratio=100.0), BANDWIDTH)
    sensors = Sensors(bits=16, torque_range=torque_range)
    yield "observer, encoder and torque sensor", run(scenario, sensors, BANDWIDTH)


def measured_table(scenarios: Mapping[str, Scenario]) -> list[str]:
    """Return the table of errors [rad] and ripple [N m] by scenario and sensor set."""
    lines = [
        "| scenario | measurement | RMS, rad | largest, rad | ripple of u, N m |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, loop in scenarios.items():
        for sensor_set, found in modes(loop, TORQUE_RANGES[name]):
            metrics = (found.rms(SETTLED), found.largest(SETTLED), found.ripple(SETTLED))
            lines.append(f"| `{name}` | {sensor_set} | " + " | ".join(f"{value:.1e}" for value in metrics) + " |")
    return lines


def bandwidth_table(scenarios: Mapping[str, Scenario]) -> list[str]:
    """Return the table of RMS error [rad] and ripple [N m] with encoders by bandwidth and scenario."""
    lines = ["| bandwidth, rad/s | " + " | ".join(f"`{name}`" for name in scenarios) + " |"]
    lines.append("| --- " * (len(scenarios) + 1) + "|")
    for bandwidth in BANDWIDTHS:
        runs = [run(loop, Sensors(bits=16), bandwidth) for loop in scenarios.values()]
        cells = (f"{found.rms(SETTLED):.1e} / {found.ripple(SETTLED):.1e}" for found in runs)
        lines.append(f"| {bandwidth:g} | " + " | ".join(cells) + " |")
    return lines


def mismatch_table(scenarios: Mapping[str, Scenario]) -> list[str]:
    """Return the table of RMS error [rad] of the paper's joint with a wrong model: by bandwidth."""
    real = single_link(stiffness=32.55, link_inertia=0.0341, gravity_torque=0.88, link_damping=0.15)
    observers = {"measured": None, **{f"{bandwidth:g}": bandwidth for bandwidth in BANDWIDTHS}}
    loop, plant = scenarios["paper_k31"], Plant(real, compile=True)
    found = [run(loop, Sensors(bits=16), bandwidth, plant=plant).rms(SETTLED) for bandwidth in observers.values()]
    head = "| bandwidth, rad/s | " + " | ".join(observers) + " |"
    return [
        head,
        "| --- " * (len(observers) + 1) + "|",
        "| RMS, rad | " + " | ".join(f"{rms:.1e}" for rms in found) + " |",
    ]


if __name__ == "__main__":
    loops = {name: scenario(name) for name in TORQUE_RANGES}
    tables = {"measurements": measured_table, "bandwidths": bandwidth_table, "mismatch": mismatch_table}
    for name, table in tables.items():
        begin, end = f"<!-- {name}: written by tools/measurement_study.py -->", f"<!-- end of {name} -->"
        put(["", *table(loops), ""], "measurements.md", begin, end)
