# SPDX-License-Identifier: Apache-2.0
"""Tracking with encoders, observer and torque sensors, in lock-step: the tables of docs/tables/measurements.md.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.diagnosis_benchmark.sensors
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.figures import markdown, put
from fjr_core.config.controller import BANDWIDTH
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

from .cases import JOINTS, Case, nominal
from .lock_step import NONE, Change, Fault

DURATION, SETTLED = 5.0, 2.0  # s
BITS, GEAR_RATIO = 16, 100  # of all sensors; of a motor encoder on the shaft of the motor
TORQUE_RANGES = {"paper_k31": 5.0, "paper_k3p1": 5.0, "two_link": 50.0, "arm7": 200.0}  # N m, of the torque sensors
NOISE = 5e-4  # standard deviation of a torque sensor relative to its range
BANDWIDTHS = (30.0, 60.0, 100.0, 150.0, 200.0, 300.0, 500.0)  # rad/s
WRONG = {"joint_stiffness": [32.55], "link_inertia": [0.0341], "gravity_torque": [0.88], "link_damping": [0.15]}
"""The joint of the paper, 5 % stiffer and 10 % heavier than in the model, with 25 % less damping."""
SENSOR_SETS: dict[str, dict[str, Any]] = {
    "all measured, exact": {"bits": (0, 0)},
    "all measured, encoders": {},
    "observer, exact positions": {"bits": (0, 0), "bandwidth": BANDWIDTH},
    "observer, encoders": {"bandwidth": BANDWIDTH},
    f"observer, encoders, gear ratio {GEAR_RATIO}": {
        "bits": (BITS, BITS + np.log2(GEAR_RATIO)),
        "bandwidth": BANDWIDTH,
    },
    "observer, encoder and torque sensor": {"bits": (0, 0), "bandwidth": BANDWIDTH, "torque": True},
}


def accuracy(
    name: str,
    bits: tuple[float, float] = (BITS, BITS),
    bandwidth: float | None = None,
    torque: bool = False,
    robot: Mapping[str, Any] | None = None,
) -> tuple[float, float, float]:
    """Return RMS of q_l - q_ld of the worst joint, largest [rad], and RMS change of u between samples [N m], settled.

    bits: of the encoders of links and motors, 0: exact. bandwidth [rad/s]: of the observer, None: velocities are
    measured. torque: a link encoder of BITS and a torque sensor. robot: what the plant has and the model lacks.
    """
    sides = zip(("link", "motor"), bits, strict=True)
    changes: dict[str, Any] = {f"imperfections.{side}_encoder_bits": [float(b)] * JOINTS[name] for side, b in sides}
    if bandwidth:
        changes |= {"measurement.velocity": "observer", "measurement.observer_bandwidth": bandwidth}
    fault = NONE
    if torque:
        changes["measurement.motor"] = "torque"
        fault = Fault(position=torque_sensors(nominal(name).robot, TORQUE_RANGES[name]))
    loop = Case("sensors", name, "", changes, robot or {}, fault=fault).run(DURATION)
    stamps, u, jets = map(np.array, zip(*loop.commands, strict=True))
    late = stamps >= stamps[0] + SETTLED * 1e9
    error = np.array([loop.links[stamp] for stamp in stamps[late]]) - jets[late, 0]
    return _rms(error), float(np.abs(error).max()), _rms(np.diff(u[late], axis=0))


def torque_sensors(robot: Robot, largest: float) -> Change:
    """Return a change of exact positions (2n,) [rad] to those of link encoders and torques up to `largest` [N m]."""
    rng, encoder, step = np.random.default_rng(0), 2 * np.pi / 2**BITS, 2 * largest / 2**BITS

    def sensed(position: Array) -> Array:
        q_l, q_m = np.split(position, 2)
        torque = robot.K @ (q_m - q_l) + NOISE * largest * rng.standard_normal(robot.n)
        return np.concatenate([encoder * np.round(q_l / encoder), step * np.round(torque / step)])

    return sensed


def _rms(values: Array) -> float:
    """Return the root mean square (k, n) of the worst joint."""
    return float(np.sqrt(np.mean(values**2, axis=0)).max())


def main() -> None:
    """Write errors [rad] and ripple [N m] by sensor set and by bandwidth, and errors with a wrong model."""
    sets = [
        (f"`{name}`", sensor_set, *(f"{value:.1e}" for value in accuracy(name, **options)))
        for name in JOINTS
        for sensor_set, options in SENSOR_SETS.items()
    ]
    by_bandwidth = []
    for bandwidth in BANDWIDTHS:
        found = [accuracy(name, bandwidth=bandwidth) for name in JOINTS]
        by_bandwidth.append((f"{bandwidth:g}", *(f"{rms:.1e} / {ripple:.1e}" for rms, _, ripple in found)))
    observers = {"measured": None, **{f"{each:g}": each for each in BANDWIDTHS}}
    wrong = [accuracy("paper_k31", bandwidth=each, robot=WRONG)[0] for each in observers.values()]
    for table, head, rows in (
        ("measurements", ("scenario", "measurement", "RMS, rad", "largest, rad", "ripple of u, N m"), sets),
        ("bandwidths", ("bandwidth, rad/s", *(f"`{name}`" for name in JOINTS)), by_bandwidth),
        ("mismatch", ("bandwidth, rad/s", *observers), [("RMS, rad", *(f"{rms:.1e}" for rms in wrong))]),
    ):
        put("measurements.md", table, markdown(head, rows))


if __name__ == "__main__":
    main()
