# SPDX-License-Identifier: Apache-2.0
"""Samples until wrong wiring stops the controller, for every joint, and healthy starts that must not stop it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Record

from .cases import JOINTS, STARTS, TORQUE, Case, nominal, start_of
from .faults import HEALTHY, NOISE, PAIRS, PLACE, WIRING, noise_of
from .lock_step import Fault

SEED = 5  # of the noise of faults that tests try
SEEDS = (SEED, 6, 7, 8)
LASTING, HEALTHY_LASTING = 0.15, 0.08  # s
LIMITS = {"paper_k31": 0.9, "two_link": 1.5}  # N m that motors give at most, unknown to the controller
HEAVIEST = {"paper_k31": 0.15, "two_link": 0.3, "arm7": 3.0}  # kg
WHITE, QUIET_VELOCITIES, COLOURED = "white", "white, velocities less noisy", "coloured"
FILTERED, ENCODERS = "white, velocities from filtered differences", "encoders of 11 to 18 bit, the same velocities"
ONE, EACH = "one sensor up to 1000 times as noisy as the others", "each sensor of another size"
COLOURED_EACH, HUM = "each sensor of another size, coloured", "each sensor of another size, hum of 50 Hz"
SENSORS = (WHITE, QUIET_VELOCITIES, FILTERED, ENCODERS, COLOURED, ONE, EACH, COLOURED_EACH, HUM)
"""Kinds of noise of other sensors."""
BANDWIDTH = 100.0  # 1/s; noise of velocities relative to that of positions
CORRELATION = 0.9  # of coloured noise, from sample to sample


@dataclass(frozen=True)
class Stop:
    """Samples until the fault was found (0: never), reason of the stop, travel [rad], peak effort [N m], the whole run.

    The state after these samples reveals the fault and is still answered; the next one gets no effort.
    """

    samples: int
    reason: str
    travel: float
    effort: float
    run: Record

    @classmethod
    def of(cls, case: Case, duration: float) -> Stop:
        """Simulate a case in lock-step. Travel and effort are those up to the stop."""
        loop = case.run(duration)
        run, found = loop.record(), loop.found_after
        ended = found + 2 if found else len(run.u)
        travel = np.abs(run.position[:ended] - run.position[0]).max()
        return cls(found, loop.tracker.reason, float(travel), float(np.nanmax(np.abs(run.u[:ended]))), run)


def wrong(scenario: str, kind: str, seed: int = SEED) -> Iterator[Case]:
    """Return the runs with one wiring fault of a kind, on every joint and side, with noise on all sensors."""
    rng, n = np.random.default_rng(seed), JOINTS[scenario]
    sides, maker = WIRING[kind]
    twice = n == 2 and kind.endswith("exchanged")
    for side in () if n == 1 and kind in PAIRS else sides:
        for j in range(1 if twice else n):
            case = Case(f"{scenario} {kind} {side} {j + 1}", scenario, kind, joint=j, side=side)
            case = maker(case.imperfect(seed=int(rng.integers(1000)), **noise_of(n)))
            yield replace(case, start=start_of(scenario, rng))


def healthy(scenario: str, seed: int) -> Case:
    """Draw a robot that is wired as it should be, but differs from its model and starts anywhere.

    Stiffness and inertia within 30 %, payload, friction, noise of up to 1 mrad and 0.1 rad/s, encoder steps, delays of
    up to 3 ms, lag, weak motors, states that are lost; starts at rest or moving, springs not in equilibrium.
    """
    rng, loaded = np.random.default_rng([seed, JOINTS[scenario]]), nominal(scenario)
    keys = ("joint_stiffness", "motor_inertia", *(("link_inertia",) if scenario != "arm7" else ()))
    robot = {
        key: (np.array(values, dtype=float) * rng.uniform(0.7, 1.3, loaded.robot.n)).tolist()
        for key in keys
        if (values := loaded.plant_values.get(f"robot.{key}")) is not None
    }
    changes = _imperfections(scenario, rng)
    case = Case(f"{scenario} healthy {seed}", scenario, HEALTHY, {}, robot, _initial(scenario, loaded, rng))
    return case.imperfect(seed=seed, **changes)


def _imperfections(scenario: str, rng: np.random.Generator) -> dict[str, Any]:
    """Draw what sensors, friction, loads and messages of a healthy robot are like."""
    n, (position, velocity) = JOINTS[scenario], 10 ** rng.uniform((-7, -4), (-3, -1))  # rad, rad/s
    drawn: dict[str, Any] = {name: [float(position if "position" in name else velocity)] * n for name in NOISE}
    if rng.random() < 0.4:
        drawn |= dict.fromkeys(("link_encoder_bits", "motor_encoder_bits"), [float(rng.integers(14, 24))] * n)
    if rng.random() < 0.5:
        friction = (rng.uniform(0, 0.1) * np.array(TORQUE[scenario])).tolist()
        drawn |= {"link_coulomb_friction": friction, "motor_coulomb_friction": friction}
        drawn |= {"friction_smoothing_velocity": [0.05] * n} if scenario == "arm7" else {}
    if rng.random() < 0.5:
        drawn |= {"payload_mass": float(rng.uniform(0, HEAVIEST[scenario])), "payload_position": PLACE[n > 2]}
    if rng.random() < 0.1 and scenario in LIMITS:
        drawn["effort_limit"] = [LIMITS[scenario]] * n
    late = {  # share of the robots, and the value
        "state_delay": (0.6, float(rng.uniform(0, 2e-3))),
        "command_delay": (0.6, float(rng.uniform(0, 1e-3))),
        "actuator_lag": (0.2, [float(rng.uniform(0, 2.5e-3))] * n),
        "state_loss": (0.2, 0.1),
        "period_jitter": (0.2, 3e-4),
    }
    return drawn | {name: value for name, (share, value) in late.items() if rng.random() < share}


def _initial(scenario: str, loaded: Scenario, rng: np.random.Generator) -> dict[str, list[float]]:
    n, values = loaded.robot.n, loaded.plant_values
    if scenario == "arm7":
        q_l = np.array(values["initial_link_position"], dtype=float) + rng.uniform(-0.04, 0.04, n)
        q_m = q_l + np.linalg.solve(
            loaded.robot.K, loaded.robot.grad_P_l(q_l) + rng.uniform(-1, 1, n) * rng.choice([0, 3])
        )
    else:
        q_l = STARTS[scenario] + rng.uniform(-0.5, 0.5, n)
        q_m = q_l + rng.uniform(-0.02, 0.02, n)
    dq: Array = rng.uniform(-1, 1, n) * rng.choice([0.0, 0.2 if scenario == "arm7" else 1.0])
    sides = {"link_position": q_l, "motor_position": q_m, "link_velocity": dq, "motor_velocity": dq}
    return {f"initial_{side}": value.tolist() for side, value in sides.items()}


class NoisySensors:
    """Sensors of both sides with a kind of noise of SENSORS, 1 urad to 1 mrad: changes of what the plant measures."""

    def __init__(self, noise: str, n: int, sample_period: float, rng: np.random.Generator) -> None:
        self._noise, self._T, self._rng = noise, sample_period, rng
        self._size: Array = 10 ** rng.uniform(-6, -3, 2 * n if noise.startswith(EACH) else 1) * np.ones(2 * n)
        if noise == ONE:
            self._size = np.where(np.arange(2 * n) == rng.integers(2 * n), 10 ** rng.uniform(-5, -3), 1e-6)
        self._velocity_size = self._size * (10 ** rng.uniform(0, 3) if noise == QUIET_VELOCITIES else BANDWIDTH)
        self._share = 1 - np.exp(-2 * np.pi * rng.uniform(20, 300) * sample_period)  # of a filter of 20 to 300 Hz
        self._step = 2 * np.pi / 2.0 ** rng.integers(11, 19)
        self._coloured: Array = np.zeros(2 * n)
        self._measured: Array = np.zeros(2 * n)
        self._last: Array | None = None
        self._filtered: Array = np.zeros(2 * n)
        self._phase, self._samples = rng.uniform(0, 2 * np.pi, (2, 2 * n)), 0  # of the hum of positions and velocities

    def position(self, q: Array) -> Array:
        """Return measured positions (2n,)."""
        white = self._size * self._rng.standard_normal(len(q))
        self._coloured = CORRELATION * self._coloured + np.sqrt(1 - CORRELATION**2) * white
        if self._noise == ENCODERS:
            self._measured = np.round(q / self._step) * self._step
        elif self._noise == HUM:
            self._measured = q + self._size * self._hum[0]
        else:
            self._measured = q + (self._coloured if self._noise in (COLOURED, COLOURED_EACH) else white)
        return self._measured

    @property
    def _hum(self) -> Array:
        """Hum (2, 2n) of 50 Hz of positions and velocities, with the standard deviation 1."""
        return np.sqrt(2) * np.sin(2 * np.pi * 50 * self._T * self._samples + self._phase)

    def velocity(self, dq: Array) -> Array:
        """Return measured velocities (2n,)."""
        self._samples += 1
        if self._noise == HUM:
            return dq + self._velocity_size * self._hum[1]
        if self._noise not in (FILTERED, ENCODERS):
            return dq + self._velocity_size * self._rng.standard_normal(len(dq))
        slope = dq if self._last is None else (self._measured - self._last) / self._T
        self._filtered += (1.0 if self._last is None else self._share) * (slope - self._filtered)
        self._last = self._measured
        return self._filtered.copy()


def with_sensors(scenario: str, noise: str, seed: int) -> Case:
    """Return a healthy start of the robot of the model, beside payload, friction and delays, with a kind of noise."""
    case = healthy(scenario, seed)
    sensors = NoisySensors(
        noise, JOINTS[scenario], nominal(scenario).sample_period, np.random.default_rng([SEED, seed])
    )
    changes = {name: value for name, value in case.changes.items() if not name.endswith(("_noise", "_bits"))}
    return replace(case, changes=changes, robot={}, fault=Fault(position=sensors.position, velocity=sensors.velocity))
