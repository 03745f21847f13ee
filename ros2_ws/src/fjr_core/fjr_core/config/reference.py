# SPDX-License-Identifier: Apache-2.0
"""Parameters of reference trajectories: reference.*, and the tolerances of trajectory actions.

A motion of a file is read once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError, TrajectoryError, prefixed
from ..motions.point_to_point import Circle, Hold, PointToPoint
from ..motions.reference import Reference
from ..motions.sine import MultiSine, Sine
from ..numerics.parameter_field import declared
from .parameter import VECTOR, Parameter, Values, named, names, read

if TYPE_CHECKING:
    from ..motions.spline import SampledMotion

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
    from ..files.motion_table import read_motion
    from ..motions.spline import SampledMotion

    table = read_motion(path, joints)
    return SampledMotion(table.times, table.positions, tolerance, table.velocities)


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
    arguments = read(declared, values, n)
    if kind == "file":
        arguments["joints"] = names(values, "joints")
    return named(lambda symbol: declared[symbol].name if symbol in declared else _TYPE.name, lambda: build(**arguments))
