# SPDX-License-Identifier: Apache-2.0
"""The controller node's own parameters."""

from __future__ import annotations

from .diagnosis import verdict_parameters
from .gains import gain_parameters
from .law import law_parameters, robust_parameters
from .measurement import measurement_parameters
from .parameter import Parameter
from .process import process_parameters
from .reference import motion_parameters, reference_parameters
from .safety import safety_parameters


def controller_parameters(n: int) -> list[Parameter]:
    """The controller node's own parameters for n joints."""
    return [
        *gain_parameters(n),
        *law_parameters(n),
        *robust_parameters(n),
        *reference_parameters(n),
        *measurement_parameters(n),
        *safety_parameters(n),
        *motion_parameters(n),
        Parameter("autostart", True, "Configure and activate at the start, without waiting to be asked"),
        *verdict_parameters(n),
        *process_parameters(),
    ]
