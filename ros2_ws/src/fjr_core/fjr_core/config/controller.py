# SPDX-License-Identifier: Apache-2.0
"""Parameters of the controller node."""

from __future__ import annotations

from .diagnosis import CERTIFICATE, CERTIFICATE_TOLERANCE
from .gains import GAINS
from .law import LAW, ROBUST
from .measurement import measurement_parameters
from .parameter import Parameter
from .process import process_parameters
from .reference import MOTION, reference_parameters
from .safety import safety_parameters

AUTOSTART = Parameter("autostart", True, "Configure and activate at the start, without a request")


def controller_parameters(n: int) -> list[Parameter]:
    """Return the controller node's own parameters for n joints."""
    first = (*GAINS.values(), *LAW, *ROBUST.values())
    last = (*MOTION, AUTOSTART, CERTIFICATE, CERTIFICATE_TOLERANCE)
    return [
        *(parameter.for_joints(n) for parameter in first),
        *reference_parameters(n),
        *measurement_parameters(n),
        *safety_parameters(n),
        *(parameter.for_joints(n) for parameter in last),
        *process_parameters(),
    ]
