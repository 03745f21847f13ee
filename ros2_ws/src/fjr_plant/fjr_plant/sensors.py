# SPDX-License-Identifier: Apache-2.0
"""Sensors with noise, encoder quantisation and optional velocities; seeded, without ROS."""

from __future__ import annotations

import ctypes

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_core.simulation.imperfections import SensorErrors

from .channel import SENSORS, Random
from .native.program import PlantProgram, array, plant_program

_FILL = ctypes.CDLL(np.random._generator.__file__).random_standard_normal_fill  # as numpy.org shows for extensions

NO_VELOCITIES: Array = np.zeros(0)


class Sensors:
    """Sensors of n joints with errors, as struct fjr_sensors; repeated readings at the same time are equal.

    The noise at the k-th instant depends only on the seed and k. Each kind of error has its own random numbers, scaled
    by its deviation, independent of the other errors.
    """

    def __init__(self, errors: SensorErrors, seed: int = 0, program: PlantProgram | None = None) -> None:
        program = program or plant_program()
        self._random = Random(program, seed, SENSORS)
        self._step, self._deviation, self._draw = np.zeros(2 * errors.n), np.zeros(4 * errors.n), np.zeros(4 * errors.n)
        self._kept = [array(program, each) for each in (self._step, self._deviation, self._draw)]
        self.pointer = program.ffi.new("struct fjr_sensors*")
        self.pointer.step, self.pointer.deviation, self.pointer.draw = self._kept
        self.pointer.normal = program.ffi.cast("fjr_normal", ctypes.cast(_FILL, ctypes.c_void_p).value)
        self.change(errors)
        self.reset()

    def reset(self) -> None:
        """Restart the random sequence."""
        self.pointer.random = self._random.restart()
        self.pointer.instant = -1

    def change(self, errors: SensorErrors) -> None:
        """Use other errors from now on; the random sequence continues."""
        bits = np.concatenate([errors.bits_l, errors.bits_m])
        self._step[:] = np.where(bits == 0, 0.0, 2 * np.pi * 2.0**-bits)  # rad; 0 bits: no encoder
        self._deviation[:] = np.concatenate(
            [errors.position_l, errors.position_m, errors.velocity_l, errors.velocity_m]
        )
        self.pointer.perfect, self.pointer.velocities = errors.off, errors.velocities

    @property
    def velocities(self) -> bool:
        """True if velocities are measured."""
        return bool(self.pointer.velocities)
