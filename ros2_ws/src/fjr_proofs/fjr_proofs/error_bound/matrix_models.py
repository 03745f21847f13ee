# SPDX-License-Identifier: Apache-2.0
"""Taylor models of matrices in boxes, and their products with known vectors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.numerics.checks import Array

from ..verification.taylor_models import Shape
from .peak_gains import ROUNDING
from .tube import Tube

PRODUCTS = 1e-13  # relative error of two products of matrices of up to 4n rows


@dataclass(frozen=True, eq=False)
class MatrixModels:
    """Models of matrices X in k boxes: values (k, shape.width, rows, columns); the last are bounds of the rest."""

    values: Array
    shape: Shape

    def between(self, left: Array, right: Array) -> MatrixModels:
        """Return left X right. The signs of all coefficients are kept."""
        exact, rest = self.values[:, :-1], self.values[:, -1:]
        rest = rest + PRODUCTS * np.abs(exact).sum(axis=1, keepdims=True)
        values = np.concatenate([left @ exact @ right, np.abs(left) @ rest @ np.abs(right)], axis=1)
        return MatrixModels(values, self.shape)

    def on_path(self, tube: Tube) -> MatrixModels:
        """Return models of the mean of X on the way from 0 to a deviation in the tube: its terms grow in proportion."""
        values = self.values.copy()
        if self.shape.symbols:
            values[:, self.shape.order : self.shape.order + tube.symbols] /= 2
        return MatrixModels(values, self.shape)

    @property
    def largest(self) -> Array:
        """Largest elements (rows, columns) of |X|."""
        return np.asarray(ROUNDING * np.abs(self.values).sum(axis=1).max(axis=0))

    def along(self, lines: Array, known: slice = slice(0)) -> Array:
        """Return the largest elements (rows,) of X times a sum of lines (k, columns, u), each times -1 to 1.

        known: symbols whose products with the lines are left out, as `products` returns them.
        """
        if not lines.shape[2]:
            return np.zeros(self.values.shape[2])
        unknown = np.delete(self.values[:, :-1], self._symbols(known), axis=1)
        signed = np.abs(unknown @ lines[:, None]).sum(axis=(1, 3))
        return np.asarray(ROUNDING * (signed + (self.values[:, -1] @ np.abs(lines)).sum(axis=2)).max(axis=0))

    def products(self, lines: Array) -> Array:
        """Return the products (k, rows, symbols u) of the slopes of X in its symbols and the lines."""
        found = self.values[:, self._symbols(slice(None))] @ lines[:, None]
        return np.asarray(found.transpose(0, 2, 1, 3).reshape(len(found), found.shape[2], -1))

    def _symbols(self, chosen: slice) -> slice:
        """Return the places of the slopes in the chosen symbols."""
        first, last, _ = chosen.indices(self.shape.symbols)
        return slice(self.shape.order + first, self.shape.order + last)
