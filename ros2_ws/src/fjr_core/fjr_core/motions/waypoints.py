# SPDX-License-Identifier: Apache-2.0
"""Waypoints from which a Spline reproduces a motion, for interfaces that transmit points instead of polynomials."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..numerics.checks import Array
from .sampled_motion import SampledMotion
from .spline import Spline

MOST = 20_000
CHECKED = 8  # instants per interval at which the spline is compared with the motion


class Waypoints(NamedTuple):
    """Times (k,) [s]; positions [rad], velocities [rad/s] and accelerations [rad/s^2] (k, n), the last at rest."""

    times: Array
    positions: Array
    velocities: Array
    accelerations: Array


def waypoints(motion: SampledMotion, tolerance: float) -> Waypoints:
    """Return waypoints whose Spline is within `tolerance` [rad] of the motion: its knots, and points between them.

    The intervals are halved until this holds, or until the next halving would give more than MOST points.
    """
    times = motion.pieces.times
    while True:
        jets = motion.jets(times)
        jets[-1, 1:] = 0.0
        found = Waypoints(times, *jets[:, :3].swapaxes(0, 1))
        spline = Spline(*found)
        between = (times[:-1, None] + np.diff(times)[:, None] * np.arange(1, CHECKED) / CHECKED).ravel()
        error = np.abs(spline.jets(between)[:, 0] - motion.jets(between)[:, 0]).max()
        if error <= tolerance or 2 * len(times) > MOST:
            return found
        times = np.sort(np.concatenate([times, times[:-1] + np.diff(times) / 2]))
