# SPDX-License-Identifier: Apache-2.0
"""The figures of each joint: how it followed, how long it took, what effort it needed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_bringup.analysis.run_data import TrackingData
from fjr_bringup.recording.reader import Array

STEADY_AFTER = 2.0  # s; figures "after 2 s" tell the tracking error once the transient is over
SETTLED = 0.02  # of the initial error
AT_LIMIT = 1.0 - 1e-6  # of an effort limit: from there on a command is saturated


@dataclass(frozen=True)
class JointFigures:
    """One joint. Errors in rad, efforts in N m, times in s; None: not known, or none is given.

    position_unit, effort_unit: of this joint's errors and efforts; m and N where it slides.
    """

    joint: str
    position_unit: str
    effort_unit: str
    initial_error_rad: float
    peak_error_rad: float
    rms_error_rad: float
    peak_error_after_2s_rad: float | None
    rms_error_after_2s_rad: float | None
    settling_time_2_percent_s: float | None  # from then on within 2 % of the largest initial error of all joints
    peak_effort_nm: float
    rms_effort_nm: float
    effort_limit_nm: float
    saturated_fraction: float | None  # of the commands; None: no limit is given


def joint_figures(data: TrackingData) -> list[JointFigures]:
    """Those of every joint."""
    return [_of(data, j) for j in range(len(data.joints))]


def settling_time(t: Array, size: Array, band: float) -> float | None:
    """From when on `size` (k,) stays within the band; None: never, or not known."""
    if not (np.isfinite(band) and np.isfinite(size).any()):
        return None
    outside = np.flatnonzero(size > band)
    if outside.size == 0:
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None


def initial_error(data: TrackingData) -> float:
    """The largest error of all joints at the start [rad]."""
    return float(np.abs(data.error[0]).max())


def _of(data: TrackingData, j: int) -> JointFigures:
    size, effort, limit = np.abs(data.error[:, j]), np.abs(data.u[:, j]), float(data.effort_limit[j])
    steady, sent = size[data.t >= STEADY_AFTER], effort[np.isfinite(effort)]
    return JointFigures(
        joint=data.joints[j],
        position_unit=data.units[j].position,
        effort_unit=data.units[j].effort,
        initial_error_rad=float(size[0]),
        peak_error_rad=float(size.max()),
        rms_error_rad=rms(size),
        peak_error_after_2s_rad=float(steady.max()) if steady.size else None,
        rms_error_after_2s_rad=rms(steady) if steady.size else None,
        settling_time_2_percent_s=settling_time(data.t, size, SETTLED * initial_error(data)),
        peak_effort_nm=float(sent.max(initial=0.0)) if sent.size else np.nan,
        rms_effort_nm=rms(sent) if sent.size else np.nan,
        effort_limit_nm=limit,
        saturated_fraction=float((sent >= AT_LIMIT * limit).mean()) if sent.size and np.isfinite(limit) else None,
    )


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt((values**2).mean()))
