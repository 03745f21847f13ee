# SPDX-License-Identifier: Apache-2.0
"""Peak-to-peak gains of a sampled loop whose matrices change along the reference.

    Z_k+1 = L_i Z_k + integral over the sample of exp(A_i s) E_i w(t) ds + G_i e_k
    |Z_k| <= sum over l of |X_l G| e_max + sum over l of integral |X_l exp(A s) E| ds w_max,   X_l = L_k-1 ... L_k-l

Z: deviation and efforts in transit; w: torques of any time course with |w| <= w_max, e: errors of the effort. The gains
are the suprema of these sums. The integral of |g|, g = X exp(A s) E, is at most the trapezoidal rule of |g| and
T^3 / 12 max |g''|. The rest of the sum beyond the last lag is bounded by (1 - |X|)^-1, X the last product.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...numerics.checks import Array
from ...robot.equilibrium import Indices
from ..one_sample_map import held_maps
from .reference_cells import Cells

ROUNDING = 1 + 1e-9
"""Factor that covers the rounding of products and sums: less than 1e5 operations of relative error 2^-53 each."""


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


def curvature(A: Array, E: Array, T: float) -> Array:
    """Return T^3 / 12 exp(|A| T) |A^2 E| (c, N, m), a bound of T^3 / 12 |exp(A s) A^2 E| for s from 0 to T."""
    growth, _ = held_maps(np.abs(A), np.abs(E), T)
    return np.asarray(T**3 / 12 * growth @ np.abs(A @ A @ E))


def peak_gains(models: CellModels, cells: Cells, T: float, blocks: int, finals: Indices) -> Array:
    """Return the gains (S + r, m + n + S) from torques, effort errors and |Z| before the sums to |Z| and the outputs.

    The supremum is over the samples at the end of the cells `finals`; T [s]: sample period. blocks: length of the sums
    in cells. Infinite if the last product is not a contraction.
    """
    S, m = models.loop.shape[1], models.torque_late.shape[2]
    chain, early, bent = _chained(models, cells.samples)
    X = np.concatenate([np.broadcast_to(np.eye(S), (len(finals), S, S)), models.outputs[finals]], axis=1)
    sums = np.zeros((len(finals), X.shape[1], m + models.effort.shape[2]))
    for block in range(blocks):
        i = cells.before(finals, block)
        response = np.abs(X @ early[i]).reshape(*X.shape[:2], cells.samples, -1).sum(axis=2)
        ends, effort = np.split(response, [2 * m], axis=2)
        sums[:, :, :m] += T / 2 * (ends[:, :, :m] + ends[:, :, m:]) + np.abs(X) @ bent[i]
        sums[:, :, m:] += effort
        X = X @ chain[i]
    rest = np.abs(X).max(axis=0)
    gains = np.hstack([sums.max(axis=0), rest])
    if not np.all(np.isfinite(rest)) or np.abs(np.linalg.eigvals(rest[:S])).max() >= 1:
        return np.full_like(gains, np.inf)
    states = np.linalg.solve(np.eye(S) - rest[:S], gains[:S])
    return np.asarray(ROUNDING * np.concatenate([states, gains[S:] + rest[S:] @ states]))


def _chained(models: CellModels, samples: int) -> tuple[Array, Array, Array]:
    """Return the loop over a cell, its inputs at each of its samples side by side, and their curvature."""
    inputs = np.concatenate([models.torque_early, models.torque_late, models.effort], axis=2)
    parts, bent, power = (
        [],
        np.zeros_like(models.curvature),
        np.broadcast_to(np.eye(models.loop.shape[1]), models.loop.shape),
    )
    for _ in range(samples):
        parts.append(power @ inputs)
        bent = bent + np.abs(power) @ models.curvature
        power = power @ models.loop
    return power, np.concatenate(parts, axis=2), bent
