# SPDX-License-Identifier: Apache-2.0
"""Parameters of the controller node, and the gains of v-dPBC from gains.*."""

from __future__ import annotations

import numpy as np

from ..control.vdpbc.gains import PAPER_GAINS, Gains
from .diagnosis import diagnosis_parameters
from .law import law_parameters, robust_parameters
from .measurement import measurement_parameters
from .parameter import Parameter, Values, declared, named, read, table
from .process import process_parameters
from .reference import motion_parameters, reference_parameters
from .safety import safety_parameters

AUTOSTART = Parameter("autostart", True, "Configure and activate at the start, without a request")
_GAINS = declared(Gains, "gains.", PAPER_GAINS)


def controller_parameters(n: int) -> list[Parameter]:
    """Return the controller node's own parameters for n joints."""
    return [
        *table(_GAINS, n),
        *law_parameters(n),
        *robust_parameters(n),
        *reference_parameters(n),
        *measurement_parameters(n),
        *safety_parameters(n),
        *motion_parameters(n),
        AUTOSTART,
        *diagnosis_parameters(n),
        *process_parameters(),
    ]


def gains(values: Values, n: int) -> Gains:
    """Return the gains of the values for n joints; raises ParameterError where (32) or (41) is broken."""
    found = Gains(**read(_GAINS, values, n))
    named(lambda symbol: f"gains.{symbol}" if symbol in _GAINS else "gains", lambda: found.checked(n))
    return found


def gain_values(gains: Gains, n: int) -> dict[str, list[float]]:
    """Return the parameters that give these gains: n entries where diagonal, else n*n by rows; zeros left out."""
    checked, values = gains.checked(n), {}
    for field, parameter in _GAINS.items():
        array = getattr(checked, field)
        diagonal = np.array_equal(array, np.diag(np.diag(array)))
        if np.any(array):
            values[parameter.name] = [float(v) for v in (np.diag(array) if diagonal else array.ravel())]
    return values
