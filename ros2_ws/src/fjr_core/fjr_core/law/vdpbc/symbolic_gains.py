# SPDX-License-Identifier: Apache-2.0
"""Represent the gains in the equations of a law, as constants or as symbols with values passed at evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np

from ...errors import GainsError
from ...numerics.checks import Array
from .gains import CheckedGains


@dataclass(frozen=True, eq=False)
class GainTerms:
    """Gain matrices (n, n), CasADi constants or symbols; names as in Gains."""

    Lambda_l: ca.SX
    Pi_l: ca.SX
    K_ld: ca.SX
    Lambda_m: ca.SX
    Pi_m: ca.SX
    K_md: ca.SX
    Gamma_l: ca.SX
    Gamma_m: ca.SX
    Pi_m_inverse: ca.SX

    def phi_l(self, q_tilde_l: ca.SX) -> ca.SX:
        """phi_l (n,) [rad/s] of eq. (31)."""
        return self.Lambda_l @ q_tilde_l + self.Gamma_l @ q_tilde_l**3

    def phi_m(self, q_tilde_m: ca.SX) -> ca.SX:
        """phi_m (n,) [rad/s] of eq. (40)."""
        return self.Lambda_m @ q_tilde_m + self.Gamma_m @ q_tilde_m**3


def terms(gains: CheckedGains) -> GainTerms:
    """Return the gains as constants."""
    return GainTerms(**{name: ca.sparsify(ca.DM(array)) for name, array in gains.arrays().items()})


class ArraySymbols:
    """Symbols for named arrays, so that one function serves all values with this sparsity pattern.

    A square matrix that is diagonal on construction must stay diagonal.
    """

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self._shapes = {name: _shape(array) for name, array in arrays.items()}
        self.by_name = {name: ca.SX.sym(name, shape) for name, shape in self._shapes.items()}
        self.vector = ca.vertcat(*(ca.vertcat(*symbol.nonzeros()) for symbol in self.by_name.values()))

    @property
    def pattern(self) -> str:
        """Description of which arrays are diagonal."""
        return str({name: shape.is_diag() for name, shape in self._shapes.items()})

    def values(self, arrays: Mapping[str, Array]) -> Array:
        """Return the values of the symbols in `vector`; raise GainsError for another sparsity pattern."""
        parts: list[float] = []
        for name, shape in self._shapes.items():
            if shape.is_square() and shape.is_diag() and _off_diagonal(arrays[name]).any():
                raise GainsError(
                    f"{name.removesuffix('_inverse')} has entries off the diagonal; expected a diagonal matrix, "
                    "as when the law was built"
                )
            parts += ca.project(ca.DM(arrays[name]), shape).nonzeros()
        return np.array(parts, dtype=float)


def _shape(array: Array) -> ca.Sparsity:
    if array.ndim == 2 and array.shape[0] == array.shape[1] and not _off_diagonal(array).any():
        return ca.Sparsity.diag(len(array))
    return ca.Sparsity.dense(*(array.shape if array.ndim == 2 else (len(array), 1)))


def _off_diagonal(array: Array) -> Array:
    return np.asarray(array - np.diag(np.diag(array)))
