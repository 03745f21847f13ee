# SPDX-License-Identifier: Apache-2.0
"""Parameters gains.*: the gains of v-dPBC, and the parameter values that give them."""

from __future__ import annotations

import numpy as np

from ..law.gains import PAPER_GAINS, Gains
from ..numerics.parameter_field import declared
from .parameter import Values, named, read

GAINS = declared(Gains, "gains.", PAPER_GAINS)


def gains(values: Values, n: int) -> Gains:
    """Return the gains of the values for n joints; raises ParameterError where (32) or (41) is broken."""
    found = Gains(**read(GAINS, values, n))
    named(lambda symbol: f"gains.{symbol}" if symbol in GAINS else "gains", lambda: found.checked(n))
    return found


def gain_values(gains: Gains, n: int) -> dict[str, list[float]]:
    """Return the parameters of these gains: n entries if diagonal, else n*n by rows; zero gains are omitted."""
    checked, values = gains.checked(n), {}
    for field, parameter in GAINS.items():
        array = getattr(checked, field)
        diagonal = np.array_equal(array, np.diag(np.diag(array)))
        if np.any(array):
            values[parameter.name] = [float(v) for v in (np.diag(array) if diagonal else array.ravel())]
    return values
