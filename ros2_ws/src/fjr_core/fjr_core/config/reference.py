# SPDX-License-Identifier: Apache-2.0
"""Parameters of the built-in references and of motions that are asked for, and what their values describe."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ..errors import ParameterError
from ..numerics.checks import Array
from ..robot.robot import Robot
from ..trajectories.circle import Circle
from ..trajectories.motion_limits import MotionLimits
from ..trajectories.point_to_point import Hold, PointToPoint
from ..trajectories.reference import Reference
from ..trajectories.sine import MultiSine, Sine
from .parameter import Parameter, Values, vector
from .safety import safety


def reference_parameters(n: int) -> list[Parameter]:
    """The parameters of the controller's reference for n joints; those of other types than the chosen are not used."""
    ones, zeros = (1.0,) * n, (0.0,) * n
    rows = "m*n entries: a row of n for each sine"
    words: list[tuple[str, float | bool | tuple[float, ...], str, str, float]] = [
        ("amplitude", ones, "Amplitude of the sine", "rad", -np.inf),
        ("frequency", ones, "Angular frequency of the sine", "rad/s", 0.0),
        ("offset", zeros, "Offset of the sines, centre of the circle, place of hold", "rad", -np.inf),
        ("phase", zeros, "Phase of the sine", "rad", -np.inf),
        ("multi_sine.amplitude", ones, f"Amplitudes of the sines, {rows}", "rad", -np.inf),
        ("multi_sine.frequency", ones, f"Angular frequencies of the sines, {rows}", "rad/s", 0.0),
        ("multi_sine.phase", zeros, f"Phases of the sines, {rows}", "rad", -np.inf),
        ("point_to_point.start", zeros, "Where it begins", "rad", -np.inf),
        ("point_to_point.goal", ones, "Where it goes", "rad", -np.inf),
        ("point_to_point.duration", 2.0, "Time of the way", "s", 1e-3),
        ("point_to_point.dwell", 0.5, "Rest at the goal, and at the start, where it returns", "s", 0.0),
        ("point_to_point.returns", True, "To and fro for ever, instead of once", "", -np.inf),
        ("circle.radius", 0.5, "Radius of the circle that the first two joints sweep", "rad", 0.0),
        (
            "circle.frequency",
            1.0,
            "Angular frequency on the circle, negative for the other way round",
            "rad/s",
            -np.inf,
        ),
        ("circle.phase", 0.0, "Where on the circle it begins", "rad", -np.inf),
        ("circle.ramp", 1.0, "Time in which it comes from rest to its frequency", "s", 1e-3),
    ]
    return [
        Parameter("reference.type", "sine", "Kind of reference", choices=tuple(_BUILD), dynamic=True),
        *(
            Parameter(f"reference.{name}", default, text, unit, minimum=minimum, dynamic=True)
            for name, default, text, unit, minimum in words
        ),
    ]


def reference(values: Values, n: int) -> Reference:
    """The reference of the values for n joints; raises ParameterError."""
    return _BUILD[str(values["reference.type"])](values, n)


def _sine(values: Values, n: int) -> Reference:
    return Sine(*(vector(values, f"reference.{name}", n) for name in ("amplitude", "frequency", "offset", "phase")))


def _multi_sine(values: Values, n: int) -> Reference:
    amplitude, frequency, phase = (
        _rows(values, f"multi_sine.{name}", n) for name in ("amplitude", "frequency", "phase")
    )
    if not len(amplitude) == len(frequency) == len(phase):
        raise ParameterError(
            f"parameters 'reference.multi_sine.*' have {amplitude.size}, {frequency.size} and {phase.size} entries "
            "for amplitude, frequency and phase; expected equally many"
        )
    return MultiSine(amplitude, frequency, phase, vector(values, "reference.offset", n))


def _point_to_point(values: Values, n: int) -> Reference:
    start, goal = (vector(values, f"reference.point_to_point.{name}", n) for name in ("start", "goal"))
    duration, dwell = (_number(values, f"point_to_point.{name}") for name in ("duration", "dwell"))
    return PointToPoint(start, goal, duration, dwell, bool(values["reference.point_to_point.returns"]))


def _circle(values: Values, n: int) -> Reference:
    if n < 2:
        raise ParameterError("parameter 'reference.type' is 'circle' for 1 joint; expected 2 joints or more")
    numbers = (_number(values, f"circle.{name}") for name in ("radius", "frequency", "phase", "ramp"))
    return Circle(vector(values, "reference.offset", n), *numbers)


def _hold(values: Values, n: int) -> Reference:
    return Hold(vector(values, "reference.offset", n))


_BUILD: dict[str, Callable[[Values, int], Reference]] = {
    "sine": _sine,
    "multi_sine": _multi_sine,
    "point_to_point": _point_to_point,
    "circle": _circle,
    "hold": _hold,
}


def _number(values: Values, name: str) -> float:
    return float(values[f"reference.{name}"])  # type: ignore[arg-type]


def _rows(values: Values, name: str, n: int) -> Array:
    """A parameter with m*n entries as (m, n); raises ParameterError."""
    array = np.asarray(values[f"reference.{name}"], dtype=float)
    if array.size % n:
        raise ParameterError(
            f"parameter 'reference.{name}' has {array.size} entries; expected a multiple of {n}, by rows"
        )
    return array.reshape(-1, n)


def motion_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints."""
    none = (0.0,) * n
    return [
        Parameter(
            "limits.acceleration",
            (math.inf,) * n,
            "Largest |ddq_ld| of a trajectory; a larger one is refused",
            "rad/s^2",
            minimum=0.0,
            dynamic=True,
            infinite=True,
        ),
        Parameter("allow_partial_joints", False, "A trajectory may leave joints out, which then hold", dynamic=True),
        Parameter(
            "constraints.trajectory", none, "Largest |q_l - q_ld| on the way to an action's goal, 0 for any", "rad", 0.0
        ),
        Parameter("constraints.goal", none, "Largest |q_l - q_ld| at an action's goal, 0 for any", "rad", 0.0),
        Parameter(
            "constraints.stopped_velocity_tolerance",
            0.01,
            "Largest |dq_l| at an action's goal, 0 for any",
            "rad/s",
            minimum=0.0,
        ),
        Parameter(
            "constraints.goal_time", 0.0, "Time after its end to reach an action's goal, 0 for any", "s", minimum=0.0
        ),
    ]


def motion_limits(values: Values, robot: Robot) -> MotionLimits:
    """The robot's own limits, tightened by limits.*, with limits.acceleration; raises ParameterError."""
    settings = safety(values, robot)
    held = settings if robot.limits is None else settings.tightened(robot.limits)
    return MotionLimits(
        held.link_position_lower,
        held.link_position_upper,
        held.link_velocity,
        vector(values, "limits.acceleration", robot.n),
        robot.units,
    )
