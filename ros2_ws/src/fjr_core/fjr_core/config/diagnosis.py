# SPDX-License-Identifier: Apache-2.0
"""Parameters of the certificate and its diagnosis."""

from __future__ import annotations

from ..model.robot import Robot
from ..monitoring.axes import Axes
from ..monitoring.thresholds import TOLERANCE
from .parameter import VECTOR, Parameter, Values, names, vector

CERTIFICATE = Parameter(
    "certificate", True, "Publish the certificate of the law for each state, and its diagnosis on /diagnostics"
)
CERTIFICATE_TOLERANCE = Parameter(
    "certificate_tolerance",
    TOLERANCE,
    "Tracking error of each joint up to which a violation counts as 'degraded'",
    "rad",
    minimum=1e-9,
    shape=VECTOR,
)


def axes(values: Values, robot: Robot) -> Axes:
    """Return the joints with the units and tolerances of the diagnosis; raises ParameterError."""
    units = tuple(each.position for each in robot.units)
    return Axes(names(values, "joints"), units, vector(values, CERTIFICATE_TOLERANCE.name, robot.n))
