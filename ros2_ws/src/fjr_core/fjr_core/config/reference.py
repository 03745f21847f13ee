# SPDX-License-Identifier: Apache-2.0
"""Parameters of reference trajectories: reference.*, and the tolerances of trajectory actions.

A motion of a file is read once, and compared with the efforts that the robot can give.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError, TrajectoryError, prefixed
from ..files.motion_table import motion_text, read_motion
from ..files.text_file import is_lines
from ..model.robot import Robot
from ..motions.inverse_dynamics import EffortDemand, effort_demand
from ..motions.point_to_point import Circle, Hold, PointToPoint
from ..motions.reference import Reference
from ..motions.sine import MultiSine, Sine
from ..motions.spline import SampledMotion
from ..numerics.checks import Array
from ..numerics.parameter_field import declared
from .parameter import VECTOR, Parameter, Values, names, read

FILE_PATH = Parameter(
    "reference.file.path",
    "",
    "Motion of reference.type file: a CSV or Parquet path, package:// or the CSV text itself; "
    "columns time [s], each joint, optionally each joint_velocity",
)
TOLERANCE = Parameter(
    "reference.file.tolerance",
    1e-3,
    "Largest distance of the smoothed motion from the samples of the file; 0: interpolate them",
    "rad",
    0.0,
    shape=VECTOR,
)
NOTABLE = 2.0
"""Ratio of two efforts above which both are reported."""
MARGIN, FIRST = 20, 10
"""Share of the samples at each end that the comparison of efforts leaves out; samples at which the start is judged."""


def motion_of_file(path: str, tolerance: ArrayLike, joints: tuple[str, ...]) -> SampledMotion:
    """Return the motion of a file; raise ParameterError. A file is read once until `forget_files` is called.

    tolerance: one number or (n,) [rad, m], see SampledMotion.
    """
    if not path:
        raise ParameterError(
            f"parameter '{FILE_PATH.name}' is empty; expected a CSV file with the columns time and each joint"
        )
    with prefixed(f"parameter '{FILE_PATH.name}': ", TrajectoryError):
        return _motion(path, tuple(np.atleast_1d(tolerance).tolist()), joints)


@lru_cache(maxsize=8)
def _motion(path: str, tolerance: tuple[float, ...], joints: tuple[str, ...]) -> SampledMotion:
    table = read_motion(path, joints)
    return SampledMotion(table.times, table.positions, tolerance, table.velocities)


def motion_inlined(values: Mapping[str, object], joints: tuple[str, ...]) -> dict[str, object]:
    """Return the values with the text of the motion in place of its path; raise ParameterError."""
    path = values.get(FILE_PATH.name)
    if not isinstance(path, str) or not path or is_lines(path):
        return dict(values)
    with prefixed(f"parameter '{FILE_PATH.name}': ", TrajectoryError):
        return {**values, FILE_PATH.name: motion_text(read_motion(path, joints), joints)}


def forget_files() -> None:
    """Read each file again when it is needed next."""
    _motion.cache_clear()


_declared = partial(declared, prefix="reference.")
_TYPES: dict[str, tuple[Callable[..., Reference], Mapping[str, Parameter]]] = {
    "sine": (Sine, _declared(Sine, defaults={"amplitude": 1.0, "frequency": 1.0})),
    "multi_sine": (MultiSine, _declared(MultiSine, defaults={"amplitude": 1.0, "frequency": 1.0})),
    "point_to_point": (
        PointToPoint,
        _declared(PointToPoint, defaults={"q0": 0.0, "q1": 1.0, "duration": 2.0, "dwell": 0.5, "returns": True}),
    ),
    "circle": (Circle, _declared(Circle, defaults={"centre": 0.0, "radius": 0.5, "frequency": 1.0})),
    "hold": (Hold, _declared(Hold, defaults={"q": 0.0})),
    "file": (motion_of_file, {"path": FILE_PATH, "tolerance": TOLERANCE}),
}
_TYPE = Parameter("reference.type", "sine", "Type of the reference trajectory", choices=tuple(_TYPES), dynamic=True)

MOTION = (
    Parameter("allow_partial_joints", False, "Accept a trajectory of some joints; the other joints hold", dynamic=True),
    Parameter(
        "constraints.trajectory",
        0.0,
        "Path tolerance of an action: largest |q_l - q_ld| before its end; 0: any",
        "rad",
        minimum=0.0,
        shape=VECTOR,
    ),
    Parameter(
        "constraints.goal",
        0.0,
        "Goal tolerance of an action: largest |q_l - q_ld| at its end; 0: any",
        "rad",
        minimum=0.0,
        shape=VECTOR,
    ),
    Parameter(
        "constraints.stopped_velocity_tolerance",
        0.01,
        "Goal tolerance of an action: largest |dq_l| at its end; 0: any",
        "rad/s",
        minimum=0.0,
    ),
    Parameter(
        "constraints.goal_time",
        0.0,
        "Time after the end of an action in which the goal must be reached; 0: any",
        "s",
        minimum=0.0,
    ),
)


def reference_parameters(n: int) -> list[Parameter]:
    """Return the parameters reference.* for n joints; the parameters of other types are not used."""
    own = {parameter.name: parameter for _, arguments in _TYPES.values() for parameter in arguments.values()}
    return [_TYPE, *(parameter.for_joints(n) for parameter in own.values())]


def reference(values: Values, n: int) -> Reference:
    """Return the reference trajectory of the values for n joints; raises ParameterError."""
    kind = str(values[_TYPE.name])
    build, declared = _TYPES[kind]
    if kind == "circle" and n < 2:
        raise ParameterError(f"parameter '{_TYPE.name}' is 'circle' for 1 joint; expected 2 joints or more")
    arguments = read(declared, values, n)
    if kind == "multi_sine":
        sizes = [arguments[name].size for name in ("amplitude", "frequency", "phase")]
        if len(set(sizes)) > 1:
            raise ParameterError(
                f"parameters 'reference.multi_sine.*' have lengths {sizes[0]}, {sizes[1]} and {sizes[2]} "
                "for amplitude, frequency and phase; expected equally many"
            )
    if kind == "file":
        arguments["joints"] = names(values, "joints")
    return build(**arguments)


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
