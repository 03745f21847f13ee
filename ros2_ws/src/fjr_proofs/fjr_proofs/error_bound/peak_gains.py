# SPDX-License-Identifier: Apache-2.0
"""Peak-to-peak gains of a sampled loop whose matrices change along the reference.

    Z_k+1 = L_i Z_k + integral over the sample of exp(A_i s) E_i w(t) ds + G_i e_k
    |Z_k| <= sum over l of |X_l G| e_max + sum over l of integral |X_l exp(A s) E| ds w_max,   X_l = L_k-1 ... L_k-l

Z: deviation and efforts in transit; w: torques of any time course with |w| <= w_max, e: errors of the effort. The gains
are the suprema of these sums. The integral of |g|, g = X exp(A s) E, is at most the trapezoidal rule of |g| and
T^3 / 12 max |g''|. The rest of the sum beyond the last lag is bounded by (1 - |X|)^-1, X the last product.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import reduce
from os import cpu_count
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.law.linearized import Indices
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import c_library_of
from fjr_core.numerics.symbolic import evaluate_rows
from fjr_core.stability.linearization import held_maps

from ..verification.taylor_models import ROUNDING
from .cells import Cells


@dataclass(frozen=True, eq=False)
class CellModels:
    """Sampled loop of each of c cells: loop (c, S, S), torque inputs (c, S, m) at the end and the start of a sample.

    curvature (c, S, m): bound of T^3 / 12 |exp(A s) A^2 E|. effort (c, S, n): input of e. outputs (c, r, S): rows
    whose gains are computed in addition to those of Z.
    """

    loop: Array
    torque_late: Array
    torque_early: Array
    curvature: Array
    effort: Array
    outputs: Array

    def growing(self, factor: float) -> CellModels:
        """Return the loop of Y_k = factor^k Z_k: all that enters the next sample is multiplied by the factor."""
        names = ("loop", "torque_late", "torque_early", "curvature", "effort")
        return replace(self, **{name: factor * getattr(self, name) for name in names})


def curvature(A: Array, E: Array, T: float) -> Array:
    """Return T^3 / 12 exp(|A| T) |A^2 E| (c, N, m), a bound of T^3 / 12 |exp(A s) A^2 E| for s from 0 to T."""
    growth, _ = held_maps(np.abs(A), np.abs(E), T)
    return np.asarray(T**3 / 12 * growth @ np.abs(A @ A @ E))


def peak_gains(models: CellModels, cells: Cells, T: float, blocks: int, finals: Indices) -> Array:
    """Return the gains (S + r, m + n + S) from torques, effort errors and |Z| before the sums to |Z| and the outputs.

    The supremum is over the samples at the end of the cells `finals`; T [s]: sample period. blocks: length of the sums
    in cells. Infinite if the last product is not a contraction.
    """
    S, m, n = models.loop.shape[1], models.torque_late.shape[2], models.effort.shape[2]
    chain = _Chain(models, cells.samples, T)

    def of_chain(final: Indices) -> tuple[Array, Array]:
        X, sums = np.concatenate([np.eye(S), models.outputs[final]]), np.zeros((S + models.outputs.shape[1], m + n))
        chain.add(cells.before(final, np.arange(blocks)), X, sums)
        return sums, np.abs(X)

    with ThreadPoolExecutor(cpu_count()) as pool:
        largest = reduce(lambda a, b: (np.maximum(a[0], b[0]), np.maximum(a[1], b[1])), pool.map(of_chain, finals))
    rest, gains = largest[1], np.hstack(largest)
    if not np.all(np.isfinite(gains)) or np.abs(np.linalg.eigvals(rest[:S])).max() >= 1:
        return np.full_like(gains, np.inf)
    states = np.linalg.solve(np.eye(S) - rest[:S], gains[:S])
    return np.asarray(ROUNDING * np.concatenate([states, gains[S:] + rest[S:] @ states]))


class _Chain:
    """Cells of a loop as peak_gains.c reads them. Raises CompilerError without a C compiler."""

    def __init__(self, models: CellModels, samples: int, T: float) -> None:
        loop, inputs, bent = _chained(models, samples)
        self._ffi, self._library, _ = c_library_of(__file__)
        self._maps, self._bent = np.concatenate([inputs, loop], axis=2), np.ascontiguousarray(bent)
        given = {"maps": self._pointer(self._maps), "bent": self._pointer(self._bent), "half": T / 2}
        _, states, torques = bent.shape
        sizes = {"states": states, "torques": torques, "efforts": models.effort.shape[2], "samples": samples}
        self._struct = self._ffi.new("struct fjr_chain *", {**given, **sizes})

    def add(self, cells: Indices, X: Array, sums: Array) -> None:
        """Add the absolute responses X maps of a chain of cells, back from X (rows, S), to sums (rows, m + n).

        X becomes the product of X and the loops of the cells.
        """
        product = np.empty((len(X), self._maps.shape[2]))
        chain = self._ffi.from_buffer("int64_t[]", np.ascontiguousarray(cells, dtype=np.int64))
        arrays = map(self._pointer, (X, sums, product))
        self._library.fjr_chain_sums(self._struct, chain, len(cells), len(X), *arrays)

    def _pointer(self, array: Array) -> Any:
        return self._ffi.from_buffer("double[]", array)


def _chained(models: CellModels, samples: int) -> tuple[Array, Array, Array]:
    """Return the loop over a cell, its inputs at each of its samples side by side, and their curvature."""
    inputs = np.concatenate([models.torque_early, models.torque_late, models.effort], axis=2)
    beside, bent = [], np.zeros_like(models.curvature)
    power = np.broadcast_to(np.eye(models.loop.shape[1]), models.loop.shape)
    for _ in range(samples):
        beside.append(power @ inputs)
        bent = bent + np.abs(power) @ models.curvature
        power = power @ models.loop
    return power, np.concatenate(beside, axis=2), bent


def columnwise(function: ca.Function, *arguments: Array) -> list[Array]:
    """Return the outputs (size, k) of a function at k columns of its arguments (size, k), in column-major order."""
    found = evaluate_rows(function, *(columns.T for columns in arguments))
    return [np.ascontiguousarray(rows.T) for rows in found]
