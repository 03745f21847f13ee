# SPDX-License-Identifier: Apache-2.0
"""Parameters of the certificate and its verdict."""

from __future__ import annotations

from ..monitoring.grading import Axes
from ..monitoring.thresholds import TOLERANCE
from ..robot.robot import Robot
from .parameter import Parameter, Values, vector

CERTIFICATE = Parameter(
    "certificate", True, "Publish the law's certificate of each state, and judge it on the diagnostics"
)
SMALLEST = 1e-9  # rad, m


def verdict_parameters(n: int) -> list[Parameter]:
    """Return the parameters for n joints."""
    tolerance = Parameter(
        "certificate_tolerance",
        (TOLERANCE,) * n,
        "Tracking error of each joint up to which a verdict is 'degraded', not 'violated'",
        "rad",
        minimum=SMALLEST,
    )
    return [CERTIFICATE, tolerance]


def axes(values: Values, robot: Robot) -> Axes:
    """Return the joints as a verdict names and grades them; raises ParameterError."""
    joints = tuple(map(str, values["joints"]))  # type: ignore[arg-type]
    units = tuple(each.position for each in robot.units)
    return Axes(joints, units, vector(values, "certificate_tolerance", robot.n))
