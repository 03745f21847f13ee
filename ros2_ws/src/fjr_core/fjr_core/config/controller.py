# SPDX-License-Identifier: Apache-2.0
"""Parameters of the controller node."""

from __future__ import annotations

from .diagnosis import CERTIFICATE, CERTIFICATE_TOLERANCE
from .gains import GAINS
from .law import LAW, ROBUST
from .measurement import measurement_parameters
from .parameter import Parameter, Values, number
from .process import process_parameters
from .reference import MOTION, reference_parameters
from .safety import safety_parameters

AUTOSTART = Parameter("autostart", True, "Configure and activate at the start, without a request")

AUXILIARY_RATE = Parameter(
    "auxiliary_rate",
    100.0,
    "Rate of ~/reference, ~/tracking_error and ~/certificate in real time; 0: every sample, as in simulated time",
    "Hz",
    minimum=0.0,
    maximum=1e5,
)


def auxiliary_period(values: Values, simulated: bool) -> float:
    """Return the time between two messages on the topics for observers [s]; 0: one per sample."""
    rate = number(values, AUXILIARY_RATE.name)
    return 0.0 if simulated or rate == 0 else 1 / rate


def controller_parameters(n: int) -> list[Parameter]:
    """Return the controller node's own parameters for n joints."""
    first = (*GAINS.values(), *LAW, *ROBUST.values())
    last = (*MOTION, AUTOSTART, AUXILIARY_RATE, CERTIFICATE, CERTIFICATE_TOLERANCE)
    return [
        *(parameter.for_joints(n) for parameter in first),
        *reference_parameters(n),
        *measurement_parameters(n),
        *safety_parameters(n),
        *(parameter.for_joints(n) for parameter in last),
        *process_parameters(),
    ]
