# SPDX-License-Identifier: Apache-2.0
"""Parameters of the certificate and its verdict."""

from __future__ import annotations

from collections.abc import Sequence

from .grading import Axes
from .parameters import Parameter, Values, vector
from .thresholds import TOLERANCE

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


def axes(values: Values, joints: Sequence[str], units: Sequence[str] = ()) -> Axes:
    """Return the joints as a verdict names and grades them; raises ParameterError.

    units: "rad" or "m" of each joint's position; empty: all joints turn.
    """
    tolerance = vector(values, "certificate_tolerance", len(joints))
    return Axes(tuple(joints), tuple(units) or ("rad",) * len(joints), tolerance)
