# SPDX-License-Identifier: Apache-2.0
"""Sensors with noise, encoder quantisation and optional velocities; seeded, without ROS."""

from __future__ import annotations

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.simulation.nonideal_parameters import SensorErrors

from .channel import SENSORS, generator

NO_VELOCITIES: Array = np.zeros(0)


class Sensors:
    """Sensors of n joints with errors; repeated readings at the same time are equal.

    The noise at the k-th instant depends only on the seed and k. Each kind of error has its own random numbers, scaled
    by its deviation, independent of the other errors.
    """

    def __init__(self, errors: SensorErrors, seed: int = 0) -> None:
        self._seed = seed
        self.change(errors)
        self.reset()

    def reset(self) -> None:
        """Restart the random sequence."""
        self._random = generator(self._seed, SENSORS)
        self._time = -1

    def change(self, errors: SensorErrors) -> None:
        """Use other errors from now on; the random sequence continues."""
        self.errors, self.perfect = errors, errors.off
        bits = np.concatenate([errors.bits_l, errors.bits_m])
        self._step = np.where(bits == 0, 0.0, 2 * np.pi * 2.0**-bits)  # rad; 0 bits: no encoder
        self._deviation = np.concatenate([errors.position_l, errors.position_m, errors.velocity_l, errors.velocity_m])

    def measured(self, time: int, position: Array, velocity: Array) -> tuple[Array, Array]:
        """Return measured positions [rad] and velocities [rad/s], (2n,) each, at `time` [ns]; no velocities: (0,)."""
        if time != self._time:
            self._time = time
            self._draw = self._random.standard_normal(len(self._deviation))
        noise = self._deviation * self._draw
        position, exact = position + noise[: len(position)], self._step == 0
        position = np.where(exact, position, np.round(position / np.where(exact, 1.0, self._step)) * self._step)
        return position, velocity + noise[len(position) :] if self.errors.velocities else NO_VELOCITIES
