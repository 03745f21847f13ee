# SPDX-License-Identifier: Apache-2.0
"""The built-in references in words: the parameters reference.*, and the reference that their values describe."""

from __future__ import annotations

from .parameters import Parameter, Values, vector
from .reference import Sine


def reference_parameters(n: int) -> list[Parameter]:
    """The parameters of the controller's reference for n joints."""
    return [
        Parameter("reference.type", "sine", "Kind of reference", choices=("sine",)),
        Parameter("reference.amplitude", (1.0,) * n, "Amplitude of the sine", "rad"),
        Parameter("reference.frequency", (1.0,) * n, "Angular frequency of the sine", "rad/s", minimum=0.0),
        Parameter("reference.offset", (0.0,) * n, "Offset of the sine", "rad"),
        Parameter("reference.phase", (0.0,) * n, "Phase of the sine", "rad"),
    ]


def reference(values: Values, n: int) -> Sine:
    """The reference of the values for n joints; raises ParameterError."""
    return Sine(*(vector(values, f"reference.{name}", n) for name in ("amplitude", "frequency", "offset", "phase")))
