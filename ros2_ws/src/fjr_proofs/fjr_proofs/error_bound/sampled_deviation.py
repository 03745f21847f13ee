# SPDX-License-Identifier: Apache-2.0
"""Sampled loop of the deviation in each cell of a reference, linear about a centre motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import block_diag

from fjr_core.model.equilibrium import Indices
from fjr_core.numerics.casadi_function import columnwise
from fjr_core.numerics.checks import Array
from fjr_core.stability.linear_controller import static
from fjr_core.stability.linearization import held_maps, map_of_held, split

from .centre_motion import CentreMotion
from .deviation_model import DeviationModel
from .modal_coordinates import Coordinates
from .peak_gains import ROUNDING, CellModels, curvature


@dataclass(frozen=True, eq=False)
class LinearCells:
    """Linear model of the deviation in each of c cells about a centre motion.

    M (c, n, n), H (c, n, 4n): M dz_3 = H z + d_l;  G (n, 4n), B (n, n): M_m dz_4 = G z + B v + d_m, v the deviation of
    the effort. F (c, n, 4n): v = F z at the sample. between [s]: time from the nearest sample that bounds cover, T / 2,
    or 0 for bounds at the samples. aligned: the model of a cell does not hold after its end (Cells.aligned). The
    properties are in `coordinates`: y for z, and likewise for torques and efforts.
    """

    model: DeviationModel
    coordinates: Coordinates
    M: Array
    H: Array
    G: Array
    B: Array
    F: Array
    sample_period: float
    delay: float
    between: float
    aligned: bool

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    def at(self, cells: Indices) -> LinearCells:
        """Return the models of the selected cells."""
        return replace(self, **{name: getattr(self, name)[cells] for name in "MHF"})

    def shifted(self, cells: int) -> LinearCells:
        """Return the models of the cells a number of cells before."""
        return self.at(np.roll(np.arange(len(self.M)), cells))

    @cached_property
    def A(self) -> Array:
        """Matrices (c, 4n, 4n) of dy/dt = A y + .."""
        n, one, S = self.n, np.eye(self.n), self.coordinates
        A = np.zeros((len(self.M), 4 * n, 4 * n))
        A[:, :n, 2 * n : 3 * n] = one
        A[:, n : 2 * n, 2 * n :] = np.hstack([-one, one])
        A[:, 2 * n : 3 * n] = np.linalg.solve(self.M, self.H)
        A[:, 3 * n :] = np.linalg.solve(self.model.robot.M_m, self.G)
        return np.asarray(S.S @ A @ S.S_inverse)

    @cached_property
    def law(self) -> Array:
        """Slopes (c, n, 4n) of the effort of the law."""
        return np.asarray(self.coordinates.effort @ self.F @ self.coordinates.S_inverse)

    @cached_property
    def inputs(self) -> tuple[Array, Array]:
        """Inputs of the effort (c, 4n, n), and of the torques d_l, d_m and link accelerations (c, 4n, 3n)."""
        n, c, S = self.n, len(self.M), self.coordinates
        by_effort, by_torque = np.zeros((c, 4 * n, n)), np.zeros((c, 4 * n, 3 * n))
        M_m_inverse = np.linalg.inv(self.model.robot.M_m)
        by_effort[:, 3 * n :] = M_m_inverse @ self.B
        by_torque[:, 2 * n : 3 * n, :n], by_torque[:, 3 * n :, n : 2 * n] = np.linalg.inv(self.M), M_m_inverse
        by_torque[:, 2 * n : 3 * n, 2 * n :] = np.eye(n)
        to_torques = block_diag(np.linalg.inv(S.torques), S.acceleration)
        return S.S @ by_effort @ S.effort_inverse, S.S @ by_torque @ to_torques

    @cached_property
    def jumps(self) -> tuple[Array, Array]:
        """Largest changes (4n, 4n) and (n, 4n) of `A` and `law` from a cell to the next; zero unless aligned."""
        if not self.aligned:
            return np.zeros((4 * self.n, 4 * self.n)), np.zeros((self.n, 4 * self.n))
        slope, law = (np.abs(np.roll(each, -1, axis=0) - each).max(axis=0) for each in (self.A, self.law))
        return slope, law

    @cached_property
    def growth(self) -> Array:
        """Matrix (4n, 4n) from bounds of dy/dt at the nearest sample to bounds r between samples; inf: there are none.

        r = rate + between |A| r, |A| elementwise and the largest of all cells.
        """
        grown = self.between * np.abs(self.A).max(axis=0)
        if np.abs(np.linalg.eigvals(grown)).max() >= 1:
            return np.full_like(grown, np.inf)
        return np.asarray(ROUNDING * np.linalg.inv(np.eye(len(grown)) - grown))

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
        loop = map_of_held(Phi, held, static(self.law))
        c, S = loop.shape[:2]

        def padded(rows: Array) -> Array:
            return np.concatenate([rows, np.zeros((c, S - 4 * n, rows.shape[2]))], axis=1)

        effort = padded(held.get(0, np.zeros((c, 4 * n, n))))
        effort[:, 4 * n : 5 * n] = np.eye(n)[: S - 4 * n]
        outputs = np.zeros((c, 2 * n, S))
        outputs[:, :n, : 4 * n], outputs[:, n:, : 4 * n] = self.A[:, 2 * n : 3 * n], self.law
        bend = curvature(self.A, by_torque, T) if self.between else np.zeros_like(by_torque)
        return CellModels(
            loop,
            torque_late=padded(by_torque),
            torque_early=padded(Phi @ by_torque),
            curvature=padded(bend),
            effort=effort,
            outputs=outputs,
        )

    def forced(self, torque: Array, aging: Array) -> Array:
        """Return the integral of exp(A (T - s)) E (torque + aging age(s)) over a sample (c, 4n, k).

        torque (c, 2n, k); aging (c, 2n) belongs to the first column. The effort that acts after s is s + whole T old,
        and T older while s < fraction T.
        """
        T, (whole, fraction), E = self.sample_period, split(self.delay, self.sample_period), self.inputs[1]
        force, slope = E[:, :, : 2 * self.n] @ torque, E[:, :, : 2 * self.n] @ aging[:, :, None]
        force[:, :, :1] += whole * T * slope
        c, N, k = force.shape
        ramp, inputs = np.zeros((c, N + 1, N + 1)), np.zeros((c, N + 1, k + 1))
        ramp[:, :N, :N], ramp[:, :N, N:], inputs[:, :N, :k], inputs[:, N, k] = self.A, slope, force, 1.0
        integral = held_maps(ramp, inputs, T)[1][:, :N]
        integral[:, :, 0] += integral[:, :, k]
        if fraction:
            older = held_maps(self.A, slope, fraction * T)[1]
            integral[:, :, :1] += T * held_maps(self.A, slope, (1 - fraction) * T)[0] @ older
        return np.asarray(integral[:, :, :k])


def linear_cells(model: DeviationModel, centre: CentreMotion, delay: float) -> LinearCells:
    """Return the linear model in the middle of each cell about a centre motion, for a robot with its factors."""
    n, cells, c = model.n, centre.cells, centre.factors
    zero, factors = np.zeros((4 * n, cells.count)), np.tile(c[:, None], cells.count)
    H, M = columnwise(model.link_slope, centre.path.middles, zero, factors, factors)
    G, B = (each.full() for each in model.motor_slope(c))
    (F,) = columnwise(model.law_slope, centre.path.instants, cells.instants, zero, factors)
    inertia, slopes, law = (each.T.reshape(cells.count, -1, n).swapaxes(1, 2).copy() for each in (M, H, F))
    modal = Coordinates.modal(model.robot, inertia.mean(axis=0))
    between = cells.sample_period / 2 if cells.verified else 0.0
    return LinearCells(model, modal, inertia, slopes, G, B, law, cells.sample_period, delay, between, cells.aligned)
