# SPDX-License-Identifier: Apache-2.0
"""The reference of reference.type `file`: read once, and compared with the efforts that the robot can give."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError, TrajectoryError
from ..files.motion_table import is_text, motion_text, read_motion
from ..law.effort_demand import EffortDemand, effort_demand
from ..model.robot import Robot
from ..motions.sampled_motion import SampledMotion
from ..numerics.checks import Array
from .parameter import Values, names, vector
from .safety import effort_limits

PATH, TOLERANCE = "reference.file.path", "reference.file.tolerance"
NOTABLE = 2.0
"""Ratio of two efforts above which both are reported."""
MARGIN, FIRST = 20, 10
"""Share of the samples at each end that the comparison of efforts leaves out; samples at which the start is judged."""


def motion_of_file(path: str, tolerance: ArrayLike, joints: tuple[str, ...]) -> SampledMotion:
    """Return the motion of a file; raise ParameterError. A file is read once until `read_again` is called.

    tolerance: one number or (n,) [rad, m], see SampledMotion.
    """
    if not path:
        raise ParameterError(f"parameter '{PATH}' is empty; expected a CSV file with the columns time and each joint")
    try:
        return _motion(path, tuple(np.atleast_1d(tolerance).tolist()), joints)
    except TrajectoryError as error:
        raise ParameterError(f"parameter '{PATH}': {error}") from None


@lru_cache(maxsize=8)
def _motion(path: str, tolerance: tuple[float, ...], joints: tuple[str, ...]) -> SampledMotion:
    table = read_motion(path, joints)
    return SampledMotion(table.times, table.positions, tolerance, table.velocities)


def inlined(values: Mapping[str, object], joints: tuple[str, ...]) -> dict[str, object]:
    """Return the values with the text of the motion in place of its path; raise ParameterError."""
    path = values.get(PATH)
    if not isinstance(path, str) or not path or is_text(path):
        return dict(values)
    try:
        return {**values, PATH: motion_text(read_motion(path, joints), joints)}
    except TrajectoryError as error:
        raise ParameterError(f"parameter '{PATH}': {error}") from None


def read_again() -> None:
    """Read each file anew when it is needed next."""
    _motion.cache_clear()


def file_warnings(values: Values, robot: Robot) -> list[str]:
    """Return a sentence for each property of the file of reference.file.path that asks for large efforts."""
    joints = names(values, "joints")
    motion = motion_of_file(str(values[PATH]), vector(values, TOLERANCE, len(joints)), joints)
    return motion_warnings(motion, robot, joints, effort_limits(values, robot))


def motion_warnings(motion: SampledMotion, robot: Robot, joints: tuple[str, ...], limit: Array) -> list[str]:
    """Return a sentence for each property of a motion that asks for large efforts.

    limit (n,) [N m]: effort limits of the joints, infinite for none.
    """
    demand = effort_demand(robot, motion)
    raw = SampledMotion(motion.times, motion.positions, 0.0) if motion.smoothed else motion
    found = [
        _beyond(demand, robot, joints, limit),
        _smoothing(motion, raw, robot, joints) if motion.smoothed else _no_fit(motion, demand, robot, joints),
        _start_at_speed(motion, raw, demand, robot, joints),
        _velocities(motion, robot, joints),
    ]
    return [sentence for sentence in found if sentence]


def _beyond(demand: EffortDemand, robot: Robot, joints: tuple[str, ...], limit: Array) -> str:
    j = int(np.argmax(demand.peak / limit))
    if demand.peak[j] <= limit[j]:
        return ""
    unit = robot.units[j].effort
    asked = f"asks for {demand.peak[j]:.3g} {unit} of {joints[j]} at {demand.at[j]:.4g} s"
    return f"the motion of the file {asked}; its effort limit is {limit[j]:.6g} {unit}"


def _smoothing(motion: SampledMotion, raw: SampledMotion, robot: Robot, joints: tuple[str, ...]) -> str:
    """Compare the efforts of the smoothed motion with those through every sample, away from both ends."""
    t = np.asarray(motion.times)
    inner = t[len(t) // MARGIN], t[-1 - len(t) // MARGIN]
    sharp, smooth = (effort_demand(robot, each, *inner) for each in (raw, motion))
    j = _notable(sharp, smooth)
    if j is None:
        return ""
    unit = robot.units[j]
    return (
        f"through every sample the motion of the file would ask for {sharp.peak[j]:.3g} {unit.effort} of {joints[j]} "
        f"at {sharp.at[j]:.4g} s; smoothed within {motion.deviation[j]:.2g} {unit.position} it asks for "
        f"{smooth.peak[j]:.3g} {unit.effort}"
    )


def _no_fit(motion: SampledMotion, demand: EffortDemand, robot: Robot, joints: tuple[str, ...]) -> str:
    """Compare the efforts through every sample with those of the best fit, which exceeds the tolerance."""
    fit = SampledMotion(motion.times, motion.positions, np.inf)
    smooth = effort_demand(robot, fit)
    j = _notable(demand, smooth) if fit.smoothed else None
    if j is None:
        return ""
    unit = robot.units[j]
    return (
        f"no smooth motion is within {TOLERANCE}, {np.asarray(motion.tolerance)[j]:g} {unit.position}, of the samples"
        f"{_step(motion, joints)}; through every sample the motion asks for {demand.peak[j]:.3g} {unit.effort} of "
        f"{joints[j]} at {demand.at[j]:.4g} s; the best fit deviates by {fit.deviation[j]:.2g} {unit.position} and "
        f"asks for {smooth.peak[j]:.3g} {unit.effort}"
    )


def _notable(sharp: EffortDemand, smooth: EffortDemand) -> int | None:
    """Return the joint of the largest ratio of efforts; None if no ratio exceeds NOTABLE."""
    ratio = sharp.peak / np.maximum(smooth.peak, np.finfo(float).tiny)
    return int(np.argmax(ratio)) if ratio.max() > NOTABLE else None


def _step(motion: SampledMotion, joints: tuple[str, ...]) -> str:
    """Describe the largest step between two samples."""
    t, q = np.asarray(motion.times), np.asarray(motion.positions)
    rates = np.abs(np.diff(q, axis=0)) / np.diff(t)[:, None]
    i, j = np.unravel_index(np.argmax(rates), rates.shape)
    start, end = (f"{q[k, j]:.6g} at {t[k]:.6g} s" for k in (i, i + 1))
    return f" (the fastest step is {joints[j]}, from {start} to {end})"


def _start_at_speed(
    motion: SampledMotion, raw: SampledMotion, demand: EffortDemand, robot: Robot, joints: tuple[str, ...]
) -> str:
    """Compare a start at speed with the effort to reach it from rest within the first samples."""
    t = np.asarray(motion.times)
    first = t[min(len(t) - 1, FIRST)]
    start = effort_demand(robot, raw, 0.0, first)
    j = int(np.argmax(np.abs(motion.initial_velocity)))
    travel = abs(motion.initial_velocity[j]) * first
    if travel <= motion.deviation[j] or start.peak[j] <= NOTABLE * demand.peak[j]:
        return ""
    unit = robot.units[j]
    return (
        f"the motion of the file starts at {motion.initial_velocity[j]:.3g} {unit.velocity} in {joints[j]}; from rest, "
        f"through the first samples, it would ask for {start.peak[j]:.3g} {unit.effort}; "
        "expected a start at rest, or a robot that moves"
    )


def _velocities(motion: SampledMotion, robot: Robot, joints: tuple[str, ...]) -> str:
    """Report velocity columns that contradict the positions: by more than a tenth of the largest velocity."""
    error = motion.velocity_error
    largest = np.abs(motion.jets(motion.times)[:, 1]).max(axis=0)
    j = int(np.argmax(error - 0.1 * largest))
    if error[j] <= 0.1 * largest[j]:
        return ""
    unit = robot.units[j].velocity
    return (
        f"column {joints[j]}_velocity differs by up to {error[j]:.3g} {unit} from the velocity of the smoothed "
        f"positions, which are tracked; their largest velocity is {largest[j]:.3g} {unit}"
    )
