# SPDX-License-Identifier: Apache-2.0
"""Metrics of each joint: tracking error, settling time and effort."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_bringup.analysis.run_data import RunData
from fjr_bringup.recording.reader import Array

STEADY_AFTER = 2.0  # s; metrics "after 2 s" exclude the transient
SETTLED = 0.02  # of the initial error
AT_LIMIT = 1.0 - 1e-6  # share of an effort limit from which a command counts as saturated


@dataclass(frozen=True)
class JointMetrics:
    """Metrics of one joint. Errors in rad, efforts in N m, times in s; None: unknown or not applicable.

    position_unit, effort_unit: units of errors and efforts of this joint; m and N for a prismatic joint.
    """

    joint: str
    position_unit: str
    effort_unit: str
    initial_error_rad: float
    peak_error_rad: float
    rms_error_rad: float
    peak_error_after_2s_rad: float | None
    rms_error_after_2s_rad: float | None
    settling_time_2_percent_s: float | None  # to within 2 % of the largest initial error of all joints
    peak_effort_nm: float
    rms_effort_nm: float
    effort_limit_nm: float
    saturated_fraction: float | None  # of the commands; None without a limit


def joint_metrics(data: RunData) -> list[JointMetrics]:
    """Return the metrics of every joint."""
    return [_of(data, j) for j in range(len(data.joints))]


def settling_time(t: Array, size: Array, band: float) -> float | None:
    """Return the time [s] from which `size` (k,) stays within the band; None if never or unknown."""
    if not (np.isfinite(band) and np.isfinite(size).any()):
        return None
    outside = np.flatnonzero(size > band)
    if outside.size == 0:
        return 0.0
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else None


def initial_error(data: RunData) -> float:
    """Return the largest initial error of all joints [rad]."""
    return float(np.abs(data.error[0]).max())


def _of(data: RunData, j: int) -> JointMetrics:
    size, effort, limit = np.abs(data.error[:, j]), np.abs(data.u[:, j]), float(data.effort_limit[j])
    steady, sent = size[data.t >= STEADY_AFTER], effort[np.isfinite(effort)]
    return JointMetrics(
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
    """Return the root mean square."""
    return float(np.sqrt((values**2).mean()))
