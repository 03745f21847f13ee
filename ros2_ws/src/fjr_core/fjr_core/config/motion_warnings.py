# SPDX-License-Identifier: Apache-2.0
"""Compare the efforts that the motion of a file asks for with those that the robot can give."""

from __future__ import annotations

import numpy as np

from ..model.robot import Robot
from ..motions.inverse_dynamics import EffortDemand, effort_demand
from ..motions.spline import SampledMotion
from ..numerics.checks import Array
from .controller import effort_limits
from .parameter import Values, names, vector
from .reference import FILE_PATH, TOLERANCE, motion_of_file

NOTABLE = 2.0
"""Ratio of two efforts above which both are reported."""
MARGIN, FIRST = 20, 10
"""Share of the samples at each end that the comparison of efforts leaves out; samples at which the start is judged."""


def file_warnings(values: Values, robot: Robot) -> list[str]:
    """Return a sentence for each property of the file of reference.file.path that asks for large efforts."""
    joints = names(values, "joints")
    motion = motion_of_file(str(values[FILE_PATH.name]), vector(values, TOLERANCE.name, robot.n), joints)
    return motion_warnings(motion, robot, joints, effort_limits(values, robot))


def motion_warnings(motion: SampledMotion, robot: Robot, joints: tuple[str, ...], limit: Array) -> list[str]:
    """Return a sentence for each property of a motion that asks for large efforts.

    limit (n,) [N m]: effort limits of the joints, infinite for none.
    """
    demands = _Demands(motion, robot, joints)
    smoothness = demands.of_smoothing() if motion.smoothed else demands.without_smoothing()
    found = (demands.beyond(limit), smoothness, demands.of_start(), demands.of_velocity_columns())
    return [sentence for sentence in found if sentence]


class _Demands:
    """Sentences on the efforts [N m] that a motion asks for, smoothed and through every sample; empty for none."""

    def __init__(self, motion: SampledMotion, robot: Robot, joints: tuple[str, ...]) -> None:
        self.motion, self.robot, self.joints = motion, robot, joints
        self.raw = SampledMotion(motion.times, motion.positions, 0.0) if motion.smoothed else motion
        self.demand = effort_demand(robot, motion)
        self.t = np.asarray(motion.times)

    def beyond(self, limit: Array) -> str:
        """Compare the efforts with their limits (n,)."""
        j = int(np.argmax(self.demand.peak / limit))
        if self.demand.peak[j] <= limit[j]:
            return ""
        unit = self.robot.units[j].effort
        asked = f"asks for {self.demand.peak[j]:.3g} {unit} of {self.joints[j]} at {self.demand.at[j]:.4g} s"
        return f"the motion of the file {asked}; its effort limit is {limit[j]:.6g} {unit}"

    def of_smoothing(self) -> str:
        """Compare the efforts of the smoothed motion with those through every sample, away from both ends."""
        inner = self.t[len(self.t) // MARGIN], self.t[-1 - len(self.t) // MARGIN]
        sharp, smooth = (effort_demand(self.robot, each, *inner) for each in (self.raw, self.motion))
        j = _notable(sharp, smooth)
        if j is None:
            return ""
        unit, joint = self.robot.units[j], self.joints[j]
        return (
            f"through every sample the motion of the file would ask for {sharp.peak[j]:.3g} {unit.effort} of {joint} "
            f"at {sharp.at[j]:.4g} s; smoothed within {self.motion.deviation[j]:.2g} {unit.position} it asks for "
            f"{smooth.peak[j]:.3g} {unit.effort}"
        )

    def without_smoothing(self) -> str:
        """Compare the efforts through every sample with those of the best fit, which exceeds the tolerance."""
        motion, demand = self.motion, self.demand
        fit = SampledMotion(motion.times, motion.positions, np.inf)
        smooth = effort_demand(self.robot, fit)
        j = _notable(demand, smooth) if fit.smoothed else None
        if j is None:
            return ""
        q, unit = np.asarray(motion.positions), self.robot.units[j]
        rates = np.abs(np.diff(q, axis=0)) / np.diff(self.t)[:, None]
        i, fastest = np.unravel_index(np.argmax(rates), rates.shape)
        start, end = (f"{q[k, fastest]:.6g} at {self.t[k]:.6g} s" for k in (i, i + 1))
        return (
            f"no smooth motion is within {TOLERANCE.name}, {np.asarray(motion.tolerance)[j]:g} {unit.position}, of the "
            f"samples (the fastest step is {self.joints[fastest]}, from {start} to {end}); through every sample the "
            f"motion asks for {demand.peak[j]:.3g} {unit.effort} of {self.joints[j]} at {demand.at[j]:.4g} s; the best "
            f"fit deviates by {fit.deviation[j]:.2g} {unit.position} and asks for {smooth.peak[j]:.3g} {unit.effort}"
        )

    def of_start(self) -> str:
        """Compare a start at speed with the effort to reach it from rest within the first samples."""
        speed, first = self.motion.knot_jets[0, 1], self.t[min(len(self.t) - 1, FIRST)]
        start = effort_demand(self.robot, self.raw, 0.0, first)
        j = int(np.argmax(np.abs(speed)))
        if abs(speed[j]) * first <= self.motion.deviation[j] or start.peak[j] <= NOTABLE * self.demand.peak[j]:
            return ""
        unit = self.robot.units[j]
        return (
            f"the motion of the file starts at {speed[j]:.3g} {unit.velocity} in {self.joints[j]}; from rest, "
            f"through the first samples, it would ask for {start.peak[j]:.3g} {unit.effort}; "
            "expected a start at rest, or a robot that moves"
        )

    def of_velocity_columns(self) -> str:
        """Report velocity columns that contradict the positions: by more than a tenth of the largest velocity."""
        if self.motion.velocities is None:
            return ""
        tracked = self.motion.jets(self.motion.times)[:, 1]
        error, largest = (np.abs(each).max(axis=0) for each in (tracked - np.asarray(self.motion.velocities), tracked))
        j = int(np.argmax(error - 0.1 * largest))
        if error[j] <= 0.1 * largest[j]:
            return ""
        unit = self.robot.units[j].velocity
        return (
            f"column {self.joints[j]}_velocity differs by up to {error[j]:.3g} {unit} from the velocity of the "
            f"smoothed positions, which are tracked; their largest velocity is {largest[j]:.3g} {unit}"
        )


def _notable(sharp: EffortDemand, smooth: EffortDemand) -> int | None:
    """Return the joint of the largest ratio of efforts; None if no ratio exceeds NOTABLE."""
    ratio = sharp.peak / np.maximum(smooth.peak, np.finfo(float).tiny)
    return int(np.argmax(ratio)) if ratio.max() > NOTABLE else None
