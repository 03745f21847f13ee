# SPDX-License-Identifier: Apache-2.0
"""Compare measured velocities with differences of the measured positions, without a model of the robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_core.monitoring.thresholds import BLOCK
from fjr_core.numerics.checks import Array

from ..innovations import consecutive
from ..record import Record
from .torque_residuals import FEWEST_BLOCKS, block_means, deviation

SIGNIFICANT = 5.0
"""Smallest difference of a wrong velocity from the slope of its position, in standard deviations."""
FLOOR = 5e-4
"""Difference relative to the speed that is attributed to discretisation."""
EXPLAINED = 0.8
"""Share of the difference that a fault must explain to be reported."""
REVERSED = (-3.0, -1.4)
"""Range of the relative error of scale that is reported as a wrong sign."""


@dataclass(frozen=True)
class VelocityFault:
    """Fault of a velocity that contradicts its position.

    kind: "velocity sign", "velocity scale" [%], "velocity delay" [s], "velocity of another joint" (size: its channel)
    or "unknown". channel: of the 2n velocities, links then motors. power: mean square, in variances.
    """

    kind: str
    channel: int
    size: float
    unit: str
    share: float
    power: float


def velocity_faults(record: Record) -> tuple[VelocityFault, ...]:
    """Return the velocities (2n) that differ from the slope of their position, the worst first.

    The slope D and the mean velocity V of each block of intervals are compared. V - D is regressed on D (scale or
    sign), on -dD/dt (delay) and on D of another joint of the same side minus its own.
    """
    first = consecutive(record)
    block = int(np.clip(len(first) // FEWEST_BLOCKS, 1, BLOCK))
    if len(first) < FEWEST_BLOCKS or not np.isfinite(record.position[first]).all():
        return ()
    dt = np.diff(record.t)[first][:, None]
    slope = (record.position[first + 1] - record.position[first]) / dt
    mean = _means(record.velocity, first)
    change = np.gradient(slope, axis=0) / np.median(dt)
    D, V, dD = (block_means(values, block) for values in (slope, mean, change))
    found = (_fault(channel, D, V, dD) for channel in range(D.shape[1]))
    return tuple(sorted((fault for fault in found if fault is not None), key=lambda fault: -fault.power))


def _means(dq: Array, first: NDArray[np.intp]) -> Array:
    """Return the mean velocities of the intervals, by the trapezoidal rule with its first correction."""
    ddq = np.gradient(dq, axis=0)  # times the sample period
    return np.asarray((dq[first + 1] + dq[first]) / 2 - (ddq[first + 1] - ddq[first]) / 12)


def _fault(channel: int, D: Array, V: Array, dD: Array) -> VelocityFault | None:
    own = D[:, channel]
    e = V[:, channel] - own
    noise = deviation(e[:, None])[0]
    sigma = float(np.hypot(noise, FLOOR * np.sqrt(np.mean(own**2)) + 1e-9))
    power, total = float(np.mean(e**2)) / sigma**2, float((e**2).sum())
    if not power > SIGNIFICANT**2:
        return None
    n = D.shape[1] // 2
    side = range(n * (channel // n), n * (channel // n) + n)
    tried = [("velocity scale", own, 0), ("velocity delay", -dD[:, channel], 0)]
    tried += [("velocity of another joint", D[:, k] - own, k) for k in side if k != channel]
    fits = [(*_regressed(e, x), kind, k) for kind, x, k in tried]
    left, factor, kind, k = min(fit for fit in fits if fit[2] != "velocity of another joint" or abs(fit[1] - 1) < 0.2)
    share = 1 - max(left - len(e) * noise**2, 0.0) / max(total - len(e) * noise**2, 1e-300)
    return _named(kind, channel, factor, k, float(np.clip(share, 0.0, 1.0)), power)


def _regressed(e: Array, x: Array) -> tuple[float, float]:
    """Fit e = factor x; return the residual sum of squares and the factor."""
    factor = float(e @ x) / max(float(x @ x), 1e-300)
    return float(((e - factor * x) ** 2).sum()), factor


def _named(kind: str, channel: int, factor: float, k: int, share: float, power: float) -> VelocityFault:
    if share < EXPLAINED or (kind == "velocity delay" and factor < 0):
        return VelocityFault("unknown", channel, float("nan"), "", share, power)
    if kind == "velocity scale" and REVERSED[0] < factor < REVERSED[1]:
        return VelocityFault("velocity sign", channel, -1.0, "", share, power)
    size, unit = {"velocity scale": (100 * factor, "%"), "velocity delay": (factor, "s")}.get(kind, (float(k), ""))
    return VelocityFault(kind, channel, size, unit, share, power)
