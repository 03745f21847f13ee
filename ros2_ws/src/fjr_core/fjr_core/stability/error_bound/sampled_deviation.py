# SPDX-License-Identifier: Apache-2.0
"""Sampled loop of the deviation in each cell of a reference, with the robot's factors in the middle of their box."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...numerics.checks import Array
from ..linear_controller import static
from ..one_sample_map import held_maps, map_of_held, split
from .deviation_model import DeviationModel
from .peak_gains import CellModels, curvature
from .reference_cells import Cells


@dataclass(frozen=True, eq=False)
class LinearCells:
    """Linear model of the deviation in each of c cells at the factors f (7,).

    M (c, n, n), H (c, n, 4n): M dz_3 = H z + d_l;  G (n, 4n), B (n, n): M_m dz_4 = G z + B v + d_m, v the deviation of
    the effort. F (c, n, 4n): v = F z at the sample. Z is (z, v of earlier samples in transit). between [s]: time from
    the nearest sample that bounds cover, T / 2, or 0 for bounds at the samples.
    """

    model: DeviationModel
    M: Array
    H: Array
    G: Array
    B: Array
    F: Array
    sample_period: float
    delay: float
    between: float

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    @cached_property
    def A(self) -> Array:
        """Matrices (c, 4n, 4n) of dz/dt = A z + .."""
        n, one = self.n, np.eye(self.n)
        A = np.zeros((len(self.M), 4 * n, 4 * n))
        A[:, :n, 2 * n : 3 * n] = one
        A[:, n : 2 * n, 2 * n :] = np.hstack([-one, one])
        A[:, 2 * n : 3 * n] = np.linalg.solve(self.M, self.H)
        A[:, 3 * n :] = np.linalg.solve(self.model.robot.M_m, self.G)
        return A

    @cached_property
    def inputs(self) -> tuple[Array, Array]:
        """Inputs of v (c, 4n, n) and of the torques d_l, d_m (c, 4n, 2n)."""
        n, c = self.n, len(self.M)
        by_effort, by_torque = np.zeros((c, 4 * n, n)), np.zeros((c, 4 * n, 2 * n))
        M_m_inverse = np.linalg.inv(self.model.robot.M_m)
        by_effort[:, 3 * n :] = M_m_inverse @ self.B
        by_torque[:, 2 * n : 3 * n, :n], by_torque[:, 3 * n :, n:] = np.linalg.inv(self.M), M_m_inverse
        return by_effort, by_torque

    @cached_property
    def models(self) -> CellModels:
        """The sampled loop of each cell; outputs: accelerations M^-1 H z (n,) of the links, efforts F z (n,)."""
        n, T = self.n, self.sample_period
        by_effort, by_torque = self.inputs
        whole, fraction = split(self.delay, T)
        Phi, Gamma = held_maps(self.A, by_effort, (1 - fraction) * T)
        held = {whole: Gamma}
        if fraction:
            first, Gamma_late = held_maps(self.A, by_effort, fraction * T)
            held[whole + 1] = Phi @ Gamma_late
            Phi = Phi @ first
        loop = map_of_held(Phi, held, static(self.F))
        c, S = loop.shape[:2]

        def padded(rows: Array) -> Array:
            return np.concatenate([rows, np.zeros((c, S - 4 * n, rows.shape[2]))], axis=1)

        effort = padded(held.get(0, np.zeros((c, 4 * n, n))))
        effort[:, 4 * n : 5 * n] = np.eye(n)[: S - 4 * n]
        outputs = np.zeros((c, 2 * n, S))
        outputs[:, :n, : 4 * n], outputs[:, n:, : 4 * n] = self.A[:, 2 * n : 3 * n], self.F
        held_torque, bend = held_maps(self.A, by_torque, T)[1], curvature(self.A, by_torque, T)
        aged = self._aged(by_torque, whole, fraction)
        return CellModels(
            loop,
            torque_late=padded(by_torque),
            torque_early=padded(Phi @ by_torque),
            torque_held=padded(held_torque),
            torque_aged=padded(aged),
            curvature=padded(bend),
            effort=effort,
            outputs=outputs,
        )

    def _aged(self, by_torque: Array, whole: int, fraction: float) -> Array:
        """Return the integral of exp(A (T - s)) E age(s) over a sample.

        The effort that acts after s is s + whole T old, and T older while s < fraction T.
        """
        T, (c, N, m) = self.sample_period, by_torque.shape
        ramp = np.zeros((c, N + m, N + m))
        ramp[:, :N, :N], ramp[:, :N, N:] = self.A, by_torque
        aged = held_maps(ramp, np.broadcast_to(np.eye(N + m)[:, N:], (c, N + m, m)), T)[1][:, :N]
        aged += whole * T * held_maps(self.A, by_torque, T)[1]
        if fraction:
            older = held_maps(self.A, by_torque, fraction * T)[1]
            aged += T * held_maps(self.A, by_torque, (1 - fraction) * T)[0] @ older
        return aged


def linear_cells(
    model: DeviationModel, cells: Cells, F: Array, factors: Array, sample_period: float, delay: float
) -> LinearCells:
    """Return the linear model in the middle of each cell at the factors f (7,); F (c, n, 4n): slopes of the law."""
    n, jets, between = model.n, cells.middles, sample_period / 2 if cells.verified else 0.0
    zero, f = np.zeros((4 * n, cells.count)), np.tile(factors[:, None], cells.count)
    H, M = model.link_slope.map(cells.count)(_matrices(jets, n), zero, f)
    G, B = (each.full() for each in model.motor_slope(factors))
    return LinearCells(model, stacked(M.full(), n), stacked(H.full(), 4 * n), G, B, F, sample_period, delay, between)


def law_slopes(model: DeviationModel, cells: Cells) -> Array:
    """Return the slopes F (c, n, 4n) of the law at the sampling instants of each cell."""
    F = model.law_slope.map(cells.count)(_matrices(cells.instants, model.n), np.zeros((4 * model.n, cells.count)))
    return stacked(F.full(), 4 * model.n)


def stacked(side_by_side: Array, columns: int) -> Array:
    """Return matrices (c, n, columns) from (n, c columns)."""
    n = len(side_by_side)
    return np.ascontiguousarray(side_by_side.reshape(n, -1, columns).swapaxes(0, 1))


def _matrices(jets: Array, n: int) -> Array:
    """Return jets (n, 6 c) side by side from columns (6n, c)."""
    return jets.T.reshape(jets.shape[1], -1, n).transpose(2, 0, 1).reshape(n, -1)
