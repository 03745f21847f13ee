# SPDX-License-Identifier: Apache-2.0
"""Parameters of the gains of v-dPBC: their table, the gains of their values, and the values of gains."""

from __future__ import annotations

import numpy as np

from ..control.vdpbc.gains import PAPER_GAINS, Gains
from .parameter import Parameter, Values, matrix, named

_GAIN_CONSTRAINTS = {
    "Lambda_l": "condition (32): Pi_l Lambda_l + Lambda_l' Pi_l positive definite",
    "Lambda_m": "condition (41): Pi_m Lambda_m + Lambda_m' Pi_m positive definite",
    "Gamma_l": "condition (32): Pi_l Gamma_l diagonal and nonnegative",
    "Gamma_m": "condition (41): Pi_m Gamma_m diagonal and nonnegative",
}
_GAIN_WORDS = {
    "Lambda_l": ("1/s", "Linear part of phi_l, eq. (31)"),
    "Pi_l": ("N m/rad", "Position metric of the links, eq. (32)"),
    "K_ld": ("N m s/rad", "Damping injected at the links, eq. (33)"),
    "Lambda_m": ("1/s", "Linear part of phi_m, eq. (40)"),
    "Pi_m": ("N m/rad", "Position metric of the motors, eq. (41)"),
    "K_md": ("N m s/rad", "Damping injected at the motors, eq. (42)"),
    "Gamma_l": ("1/(s rad^2)", "Cubic part of phi_l"),
    "Gamma_m": ("1/(s rad^2)", "Cubic part of phi_m"),
}


def gain_parameters(n: int) -> list[Parameter]:
    """Return the parameters of the gains for n joints; the defaults are the paper's."""
    return [
        Parameter(
            f"gains.{name}",
            _spread(getattr(PAPER_GAINS, name), n),
            f"{text}, n entries or n*n by rows",
            unit,
            constraint=_GAIN_CONSTRAINTS.get(name, "symmetric positive definite"),
            dynamic=True,
        )
        for name, (unit, text) in _GAIN_WORDS.items()
    ]


def gains(values: Values, n: int) -> Gains:
    """The gains of the values for n joints, with their conditions checked; raises ParameterError."""
    found = Gains(**{name: matrix(values, f"gains.{name}", n) for name in _GAIN_WORDS})
    named(lambda symbol: f"gains.{symbol}" if symbol in _GAIN_WORDS else "gains", lambda: found.checked(n))
    return found


def gain_values(gains: Gains, n: int) -> dict[str, list[float]]:
    """Values of the parameters that give these gains: n entries where diagonal, else n*n by rows; zeros left out."""
    values = {}
    for name, array in ((name, getattr(gains.checked(n), name)) for name in _GAIN_WORDS):
        diagonal = np.array_equal(array, np.diag(np.diag(array)))
        if np.any(array):
            values[f"gains.{name}"] = [float(v) for v in (np.diag(array) if diagonal else array.ravel())]
    return values


def _spread(value: object, n: int) -> tuple[float, ...]:
    return tuple(float(v) for v in np.broadcast_to(np.asarray(value, dtype=float), n))
