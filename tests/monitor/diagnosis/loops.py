# SPDX-License-Identifier: Apache-2.0
"""Records of sampled loops with faults of sensors, efforts and robot that the law does not know."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

import fjr_core as fjr
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Record

PERIOD = 1e-3
LARGEST = 1e3  # rad; a robot beyond this position has diverged
Sensed = Callable[[Array, Array], tuple[Array, Array]]


def recorded(
    law: fjr.TrackingLaw,
    reference: Reference,
    x: Array,
    samples: int,
    robot: fjr.Robot | None = None,
    sensed: Sensed = lambda q, dq: (q, dq),
    commanded: Callable[[Array], Array] = lambda u: u,
    acting: Callable[[Array], Array] = lambda u: u,
    limit: float = np.inf,
    steps: int = 4,
) -> Record:
    """Return the record of a loop from the state x on, or until its robot has diverged.

    robot: the plant; None: the model of the law. sensed: what is measured of positions and velocities. commanded,
    acting: what is sent of the effort of the law, and what acts of it. limit [N m]: known effort limit. steps: of the
    integrator in a sample.
    """
    real = robot or law.robot
    plant, rows = fjr.Plant(real), []
    for k in range(samples):
        if not np.abs(x).max() < LARGEST:
            break
        q, dq = sensed(x[: 2 * real.n], np.concatenate(real.velocities(x)))
        jets = reference.jets(k * PERIOD)
        u = commanded(law.measured_command(q, dq, jets)[0])
        rows.append((k * PERIOD, q, dq, jets, u))
        acts = acting(u)
        try:
            for _ in range(steps):
                x = plant.step(x, acts, PERIOD / steps)
        except fjr.StateError:
            break
    t, position, velocity, jets, u = map(np.array, zip(*rows, strict=True))
    return Record(t, position, velocity, jets, u, None, None, None, PERIOD, np.full(real.n, limit))
