# SPDX-License-Identifier: Apache-2.0
"""Parameters of reference trajectories: reference.*, and the tolerances of trajectory actions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from ..errors import ParameterError
from ..motions.circle import Circle
from ..motions.point_to_point import Hold, PointToPoint
from ..motions.reference import Reference
from ..motions.sine import MultiSine, Sine
from . import reference_file
from .parameter import ROWS, SCALAR, VECTOR, Parameter, Values, names, read


def _own(
    name: str,
    default: float | bool,
    description: str,
    unit: str = "",
    minimum: float = -math.inf,
    shape: str = SCALAR,
) -> Parameter:
    return Parameter(f"reference.{name}", default, description, unit, minimum, dynamic=True, shape=shape)


_OFFSET = _own("offset", 0.0, "Offset of the sines, centre of the circle, position of hold", "rad", shape=VECTOR)
_SINE = {
    "amplitude": _own("amplitude", 1.0, "Amplitude of the sine", "rad", shape=VECTOR),
    "frequency": _own("frequency", 1.0, "Angular frequency of the sine", "rad/s", 0.0, VECTOR),
    "offset": _OFFSET,
    "phase": _own("phase", 0.0, "Phase of the sine", "rad", shape=VECTOR),
}
_MULTI_SINE = {
    "amplitude": _own("multi_sine.amplitude", 1.0, "Amplitudes of the sines", "rad", shape=ROWS),
    "frequency": _own("multi_sine.frequency", 1.0, "Angular frequencies of the sines", "rad/s", 0.0, ROWS),
    "phase": _own("multi_sine.phase", 0.0, "Phases of the sines", "rad", shape=ROWS),
    "offset": _OFFSET,
}
_POINT_TO_POINT = {
    "q0": _own("point_to_point.start", 0.0, "Start position", "rad", shape=VECTOR),
    "q1": _own("point_to_point.goal", 1.0, "Goal position", "rad", shape=VECTOR),
    "duration": _own("point_to_point.duration", 2.0, "Duration of the motion", "s", 1e-3),
    "dwell": _own("point_to_point.dwell", 0.5, "Dwell time at the goal, and at the start if it returns", "s", 0.0),
    "returns": _own("point_to_point.returns", True, "true: repeat back and forth; false: move once"),
}
_CIRCLE = {
    "centre": _OFFSET,
    "radius": _own("circle.radius", 0.5, "Radius of the circle in the plane of the first two joints", "rad", 0.0),
    "frequency": _own(
        "circle.frequency", 1.0, "Angular frequency on the circle; negative: opposite direction", "rad/s"
    ),
    "phase": _own("circle.phase", 0.0, "Initial angle on the circle", "rad"),
    "ramp": _own("circle.ramp", 1.0, "Acceleration time from rest to the angular frequency", "s", 1e-3),
}
_FILE = {
    "path": Parameter(
        reference_file.PATH,
        "",
        "Motion of reference.type file: a CSV or Parquet path, package:// or the CSV text itself; "
        "columns time [s], each joint, optionally each joint_velocity",
    ),
    "tolerance": Parameter(
        reference_file.TOLERANCE,
        1e-3,
        "Largest distance of the smoothed motion from the samples of the file; 0: interpolate them",
        "rad",
        0.0,
        shape=VECTOR,
    ),
}
_TYPES: dict[str, tuple[Callable[..., Reference], Mapping[str, Parameter]]] = {
    "sine": (Sine, _SINE),
    "multi_sine": (MultiSine, _MULTI_SINE),
    "point_to_point": (PointToPoint, _POINT_TO_POINT),
    "circle": (Circle, _CIRCLE),
    "hold": (Hold, {"q": _OFFSET}),
    "file": (reference_file.motion_of_file, _FILE),
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
        _check_lengths(arguments)
    if kind == "file":
        arguments["joints"] = names(values, "joints")
    return build(**arguments)


def _check_lengths(sines: Mapping[str, Any]) -> None:
    sizes = [sines[name].size for name in ("amplitude", "frequency", "phase")]
    if len(set(sizes)) > 1:
        raise ParameterError(
            f"parameters 'reference.multi_sine.*' have {sizes[0]}, {sizes[1]} and {sizes[2]} entries "
            "for amplitude, frequency and phase; expected equally many"
        )
