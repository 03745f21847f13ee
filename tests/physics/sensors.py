# SPDX-License-Identifier: Apache-2.0
"""What encoders and clocks make of a motion: samples of both sides and the efforts, as a driver would log them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .arm import Motion

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Encoder:
    """gain q + eccentricity sin q + second cos 2 q + offset + noise, in steps [rad]; slip [rad]: a step half-way."""

    step: float = 1e-5
    noise: float = 0.0
    gain: float = 1.0
    eccentricity: float = 0.0
    offset: float = 0.0
    slip: float = 0.0
    second: float = 0.0

    def read(self, q: Array, random: np.random.Generator) -> Array:
        """Return the readings (k, d, n) of positions."""
        seen = self.gain * q + self.eccentricity * np.sin(q) + self.second * np.cos(2 * q) + self.offset
        seen[len(q) // 2 :] += self.slip
        seen += self.noise * random.standard_normal(q.shape)
        return np.round(seen / self.step) * self.step if self.step else seen


@dataclass(frozen=True)
class Sensors:
    """Encoders of links and motors. lost: share of samples that do not arrive, `burst` in a row.

    drift [s]: by which the skew grows over the record. bits: of the efforts that are recorded, 0: exact.
    """

    link: Encoder = field(default_factory=Encoder)
    motor: Encoder = field(default_factory=Encoder)
    lost: float = 0.0
    burst: int = 1
    drift: float = 0.0
    bits: int = 0


@dataclass(frozen=True, eq=False)
class Samples:
    """Times t (k,) [s] and link positions, motor positions and efforts (k, n) of a draw."""

    t: Array
    q_l: Array
    q_m: Array
    u: Array


EDGE = 8  # samples at both ends that are not recorded, because skews and delays lead out of the motion there


def sampled(
    motion: Motion,
    dt: float,
    skew: Array,
    sensors: Sensors = Sensors(),
    seed: int = 0,
) -> list[Samples]:
    """Return the samples of each draw every dt [s]; links are read `skew` (d, n) [s] later than motors.

    The effort u[k] of the motion was commanded at k dt, whenever it began to act.
    """
    random = np.random.default_rng(seed)
    k, d = np.arange(EDGE, len(motion.u) - EDGE), motion.t.shape[1]
    at = np.tile((k * dt)[:, None], (1, d))
    q_m = sensors.motor.read(motion.position(1, at), random)
    grown = sensors.drift * (k / k[-1] - 0.5)[:, None]
    late = [motion.position(0, at + skew[:, j] + grown)[:, :, j] for j in range(skew.shape[1])]
    q_l = sensors.link.read(np.stack(late, axis=-1), random)
    records = []
    for i in range(d):
        first = random.random(len(k)) < sensors.lost / sensors.burst
        kept = ~np.convolve(first, np.ones(sensors.burst, dtype=bool))[: len(k)]
        kept[[0, -1]] = True
        u = motion.u[k, i]
        step = 2 * np.abs(u).max() / 2**sensors.bits if sensors.bits else 0.0
        u = np.round(u / step) * step if step else u
        records.append(Samples(k[kept] * dt, q_l[kept, i], q_m[kept, i], u[kept]))
    return records
