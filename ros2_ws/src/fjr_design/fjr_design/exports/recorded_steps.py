# SPDX-License-Identifier: Apache-2.0
"""Record a controller on its simulated robot, sample by sample: what the control step reads and the effort it gives."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fjr_core.errors import StateError
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.numerics.checks import Array

from .step_code import Controller


@dataclass(frozen=True)
class RecordedStep:
    """One sample: stamp [ns], which is also its arrival; as measured; the effort u (n,) [N m].

    link, motor (n,): q_l [rad] and the motor angle [rad] or joint torque [N m]; velocity (2n,) [rad/s].
    """

    stamp: int
    link: Array
    motor: Array
    velocity: Array
    u: Array


def recorded_steps(
    controller: Controller, plant: Plant, x0: Array, inner_steps: int, samples: int
) -> Iterator[RecordedStep]:
    """Yield the first samples of the closed loop from x0 (4n,); raises StateError if it diverges."""
    step, n, period = controller.step(), controller.n, controller.sample_period
    x: Array = np.asarray(x0, dtype=float)
    for k in range(samples):
        stamp = round(k * period * 1e9)
        link, motor, velocity = measured(controller, plant, x)
        step.step(stamp, stamp, link, motor, velocity[:n], velocity[n:])
        yield RecordedStep(stamp, link, motor, velocity, step.u.copy())
        for _ in range(inner_steps):
            x = plant.step(x, step.u, period / inner_steps)
        if step.controller.journal.not_finite or not np.isfinite(x).all():
            raise StateError(
                f"the loop diverged at t = {k * period:.6g} s; "
                "expected a loop that is stable at its sample period (fjr check)"
            )


def measured(controller: Controller, plant: Plant, x: Array) -> tuple[Array, Array, Array]:
    """Return the signals of the sensors at x (4n,): link positions, motor angles or joint torques (n,), velocities."""
    n, m, ratio = controller.n, controller.measurement, np.asarray(controller.measurement.gear_ratio)
    q_l, q_m = x[:n], x[n : 2 * n]
    dq_l, dq_m = plant.robot.velocities(x)
    motor = plant.robot.K @ (q_m - q_l) if m.by_torque else q_m * ratio
    return q_l.copy(), motor, np.concatenate([dq_l, dq_m * ratio])


def as_text(steps: Iterator[RecordedStep]) -> str:
    """Format one line per sample: stamp and arrival, then the numbers in hexadecimal, which is exact."""
    lines = []
    for step in steps:
        numbers = np.concatenate([step.link, step.motor, step.velocity, step.u]).tolist()
        lines.append(" ".join([str(step.stamp), str(step.stamp), *map(float.hex, numbers)]))
    return "\n".join(lines) + "\n"
