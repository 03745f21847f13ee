# SPDX-License-Identifier: Apache-2.0
"""Bound how much one sample of the nonlinear loop contracts in a tube, on pieces of the reference.

The held effort changes at a time tau after a sample, at most one sample and between the least and the longest delay.
With D(s) the Jacobian of the error system along a solution, the Jacobian of the one-sample map is

    J = Psi(h, tau) (Psi(tau, 0) - S),    dPsi/ds = D(s) Psi,    S = diag(0, I): w loses the old effort at tau.

D(s) = C + sum over i of H_i (chi_i(s) - c_i) + (t - t_c) H_t, with C the Jacobian at the centre c of the tube and H its
derivatives, enclosed on the tube. In |W+ J W^-1| the terms of first order in the errors are bounded together, for the
whole ball, all others entry by entry.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.law.linearized import Indices
from fjr_core.motions.sine import Sines
from fjr_core.numerics.checks import Array
from fjr_core.numerics.intervals import Interval

from ..verification.interval_matrices import (
    ABOVE,
    excess,
    exponential,
    exponential_integral,
    growth,
    magnitude_norm,
    matmul,
    spectral_norm,
)
from ..verification.taylor_models import NUMBER, TaylorModels
from .error_system import DERIVATIVES, EnclosedFlow, ErrorSystem, enclosed_flow

CELLS = 4
"""Cells of the delay; in each J lies between its values at the ends, up to a bounded error."""


@dataclass(frozen=True, eq=False)
class PiecewiseMetric:
    """Norms |W[j] chi| of the pieces j, W (N, s, s), with V close to the inverse of W.

    slack (N,): |X W^-1| <= slack |X V| for every matrix X, as W^-1 = V (W V)^-1.
    """

    W: Array
    V: Array
    slack: Array

    @staticmethod
    def of(P: Array) -> PiecewiseMetric:
        """Return the norms (chi' P chi)^(1/2) of positive definite P (N, s, s), up to rounding."""
        W = np.ascontiguousarray(np.swapaxes(np.linalg.cholesky(P), 1, 2))
        V = np.linalg.inv(W)
        error = matmul(Interval.exact(W), Interval.exact(V)) - Interval.exact(np.eye(W.shape[-1]))
        distance = ABOVE * np.sqrt(np.sum(error.magnitude**2, axis=(1, 2)))
        return PiecewiseMetric(W, V, np.where(distance < 0.5, ABOVE / (1 - np.minimum(distance, 0.5)), np.inf))

    def at(self, pieces: Indices) -> PiecewiseMetric:
        """Return the norms of these pieces."""
        return PiecewiseMetric(self.W[pieces], self.V[pieces], self.slack[pieces])

    def extent(self, radius: float | Array) -> Array:
        """Return the largest |chi_i| (N, s) in the ball of this radius."""
        reach = np.sqrt(np.sum(self.V**2, axis=2))
        return np.asarray(ABOVE * self.slack[:, None] * np.reshape(radius, (-1, 1)) * reach)


@dataclass(frozen=True, eq=False)
class Pieces:
    """Pieces of the reference: piece j holds the samples at times from j h to (j + 1) h.

    index (k,). centre (k, m): centre of the tube. C (k, m, m): Jacobian there at (j + 1) h. rate (k, m): the field.
    """

    index: Indices
    centre: Array
    C: Interval
    rate: Interval

    def at(self, chosen: Indices) -> Pieces:
        """Return these of the pieces."""
        return Pieces(self.index[chosen], self.centre[chosen], self.C[chosen], self.rate[chosen])


@dataclass(frozen=True, eq=False)
class OneSample:
    """The one-sample map of an error system with a sample period h [s] and delays from least to longest [samples]."""

    system: ErrorSystem
    reference: Sines
    h: float
    least: float
    longest: float

    @property
    def states(self) -> int:
        """Number of states: without delay w is zero at every sample."""
        return (5 if self.longest else 4) * self.system.n

    @property
    def taus(self) -> Array:
        """Instants (CELLS + 1,) [s] at which the effort changes; twice the only one, if there is only one."""
        cells = CELLS if self.longest > self.least else 1
        return np.asarray(self.h * np.linspace(self.least, self.longest, cells + 1))

    def jets(self, index: Indices, spread: float) -> Interval:
        """Return the reference over (j + 1) h +- spread h for the pieces j (k,)."""
        middle = np.asarray(self.h * (index + 1.0), dtype=float)
        radius = float(ABOVE * spread * self.h + 1e-15 * middle.max())
        models = TaylorModels.sines(self.reference, middle, radius, DERIVATIVES, NUMBER).values
        return Interval(models[..., 0].T, models[..., 1].T)

    def pieces(self, index: Indices, centre: Array) -> Pieces:
        """Return the pieces with centres (k, m)."""
        point, jets = Interval.exact(centre.T), self.jets(index, 0.0)
        C = self.system.jacobian.on_intervals(point, jets)[0]
        rate = self.system.field.on_intervals(point, jets)[0]
        return Pieces(index, centre, self._dense(C), Interval(rate.mid.T, rate.rad.T))

    def on_centre(self, pieces: Pieces) -> tuple[Array, Array]:
        """Return one-sample maps (k, v, s, s) at the instants `taus` and displacements (k, s), in floating point."""
        s, C = self.states, pieces.C.mid
        whole = exponential(C, self.h).mid
        late = [exponential(C, self.h - tau).mid @ self._switch for tau in self.taus]
        drift = exponential_integral(C, self.h).mid @ pieces.rate.mid[:, :, None]
        return np.stack([(whole - part)[:, :s, :s] for part in late], axis=1), drift[:, :s, 0]

    def flow(self, pieces: Pieces, start: Array) -> EnclosedFlow:
        """Return bounds of solutions that start with |chi - c| at most start (k, s)."""
        return enclosed_flow(self.system, pieces.centre.T, start.T, self.jets(pieces.index, 1.0), self.h)

    def displacement(self, pieces: Pieces, after: PiecewiseMetric, next_centre: Array) -> Array:
        """Return bounds (k,) of |W+ (chi - c+)| for the solution that starts at the centre c, one sample later.

        chi = c + (integral of exp(C s)) rate - exp(C (h - tau)) S c, up to bounded terms.
        """
        s, h, C = self.states, self.h, pieces.C.mid
        flow = self.flow(pieces, np.zeros((len(C), s)))
        if not np.isfinite(flow.box).all():
            return np.full(len(C), np.inf)
        box = Interval(pieces.centre.T, flow.box)
        D = self._dense(self.system.jacobian.on_intervals(box, flow.jets)[0])
        by_time = self.system.by_time.on_intervals(box, flow.jets)[0].magnitude.T[:, :, None]
        A, R = np.abs(C), (D - Interval.exact(C)).magnitude
        held, column = (self._switch @ np.abs(pieces.centre)[:, :, None]), pieces.rate[:, :, None]
        late = excess(A, R, R, h)
        error = h * late @ column.magnitude + late @ held
        error = error + h * h * (by_time + growth(A + R, h) @ by_time)
        error = error + self._curved(A, self.taus[1] - self.taus[0], h) @ held
        moved = Interval.exact((pieces.centre - next_centre)[:, :, None]) + matmul(exponential_integral(C, h), column)
        bounds = []
        for tau in self.taus:
            lost = matmul(exponential(C, h - tau), Interval.exact(self._switch @ pieces.centre[:, :, None]))
            offset = matmul(Interval.exact(after.W), (moved - lost)[:, :s])
            bounds.append(np.linalg.norm(offset.magnitude[:, :, 0], axis=1))
        error = np.linalg.norm((np.abs(after.W) @ error[:, :s])[:, :, 0], axis=1)
        return np.asarray(ABOVE * (np.max(bounds, axis=0) + error))

    def factors(self, pieces: Pieces, metric: PiecewiseMetric, after: PiecewiseMetric, radius: float) -> Array:
        """Return bounds (k,) of |W+ J W^-1| for all J in the ball |W (chi - c)| <= radius; infinite without a bound."""
        flow = self.flow(pieces, metric.extent(radius))
        if not np.isfinite(flow.box).all():
            return np.full(len(flow.box.T), np.inf)
        H, by_time = self.system.curvature(Interval(pieces.centre.T, flow.box), flow.jets)
        n, h = self.system.n, self.h
        errors, others = H.mid[: 4 * n], np.concatenate([H.mid[4 * n :], by_time.mid[None]])
        reach = np.concatenate([flow.box[4 * n :], np.full((1, len(flow.box.T)), h)])  # of w, and of the time
        linear = np.einsum("iek,ik->ek", np.abs(errors), flow.start[: 4 * n])
        linear += np.einsum("iek,ik->ek", np.abs(others), reach)
        rest = np.einsum("iek,ik->ek", np.abs(errors), flow.grown[: 4 * n])
        rest += np.einsum("iek,ik->ek", H.rad, flow.box) + h * by_time.rad
        R1, R2 = (ABOVE * self._scattered(part) for part in (linear, rest))
        R2 += pieces.C.rad
        bound = self._together(errors, metric, after, radius) + self._one_by_one(others, reach, metric, after)
        bound = h * bound + 1e-12 * self._by_entries(h * R1, metric, after)
        return np.asarray(ABOVE * metric.slack * (self._constant(pieces.C.mid, R1, R2, metric, after) + bound))

    def _constant(self, C: Array, R1: Array, R2: Array, metric: PiecewiseMetric, after: PiecewiseMetric) -> Array:
        """Return bounds (k,) of |W+ J V| without the terms of first order in the errors: the largest of all cells."""
        s, taus, whole = self.states, self.taus, exponential(C, self.h)
        ends = []
        for tau in taus:
            late = matmul(exponential(C, self.h - tau), Interval.exact(np.broadcast_to(self._switch, C.shape)))
            J = (whole - late)[:, :s, :s]
            J = matmul(matmul(Interval.exact(after.W), J), Interval.exact(metric.V))
            ends.append(spectral_norm(J.mid) + magnitude_norm(J.rad))
        cells = [
            np.maximum(ends[i], ends[i + 1])
            + self._by_entries(self._remainder(C, R1, R2, taus[i], taus[i + 1]), metric, after)
            for i in range(len(taus) - 1)
        ]
        return np.asarray(np.max(cells, axis=0))

    def _remainder(self, C: Array, R1: Array, R2: Array, begin: float, end: float) -> Array:
        """Return bounds (k, m, m) of J for tau from begin to end, less interpolation and terms of first order.

        J = Psi_2 (Psi_1 - T_1) + (Psi_2 - T_2) (T_1 - S) + T_2 (T_1 - S), T_1 = exp(C tau), T_2 = exp(C (h - tau)).
        """
        A, R, left = np.abs(C), R1 + R2, self.h - begin
        stays = np.eye(C.shape[-1]) - self._switch
        later = excess(A, R, R2, left)
        if not end:
            return np.asarray(ABOVE * (later @ stays))
        first, grown = excess(A, R, R2, end), growth(A, end)
        before = growth(A + R, left) @ (first + R1 * end) + first
        after = later @ (stays + grown) + left * R1 @ grown
        return np.asarray(ABOVE * (before + after + self._curved(A, end - begin, left)))

    def _curved(self, A: Array, cell: float, left: float) -> Array:
        """Return bounds (k, m, m) of the difference of exp(C (h - tau)) S from a straight line in tau over a cell."""
        return np.asarray(cell**2 / 8 * A @ A @ (np.eye(A.shape[-1]) + growth(A, left)) @ self._switch)

    def _together(self, H: Array, metric: PiecewiseMetric, after: PiecewiseMetric, radius: float) -> Array:
        """Return bounds (k,) of |W+ (sum H_i e_i) V| on the ball; with delay also with V less the rows of w.

        e = V y, |y| <= radius: sum_j y_j G_j, G_j = sum_i V_ij W+ H_i V. Its norm is at most radius times the norm of
        the matrices G_j side by side, and of those on top of each other.
        """
        s, k = self.states, H.shape[-1]
        weights, bounds = metric.V[:, : len(H)], []
        for parts in self._in_metric(H, metric, after):
            G = np.einsum("kij,kiab->kjab", weights, parts)
            beside = np.swapaxes(G, 1, 2).reshape(k, s, -1)
            bounds.append(np.minimum(spectral_norm(beside), spectral_norm(G.reshape(k, -1, s))))
        return np.asarray(ABOVE * metric.slack * radius * np.max(bounds, axis=0))

    def _one_by_one(self, H: Array, reach: Array, metric: PiecewiseMetric, after: PiecewiseMetric) -> Array:
        """Return bounds (k,) of |W+ (sum H_i y_i) V| for |y_i| at most reach (i, k)."""
        bounds = [
            sum(spectral_norm(parts[:, i]) * reach[i] for i in range(len(H)))
            for parts in self._in_metric(H, metric, after)
        ]
        return np.asarray(ABOVE * np.max(bounds, axis=0))

    def _in_metric(self, H: Array, metric: PiecewiseMetric, after: PiecewiseMetric) -> list[Array]:
        """Return W+ H_i V (k, i, s, s); with delay also with V less the rows of w."""
        s = self.states
        dense = np.stack([self._scattered(part)[:, :s, :s] for part in H], axis=1)
        without_w = (np.eye(5 * self.system.n) - self._switch)[:s, :s] @ metric.V
        rights = (metric.V, without_w)[: 2 if self.longest else 1]
        return [after.W[:, None] @ dense @ right[:, None] for right in rights]

    def _by_entries(self, X: Array, metric: PiecewiseMetric, after: PiecewiseMetric) -> Array:
        """Return bounds (k,) of |W+ Y V| for all matrices |Y| <= X (k, m, m)."""
        s = self.states
        return magnitude_norm(np.abs(after.W) @ X[:, :s, :s] @ np.abs(metric.V))

    @property
    def _switch(self) -> Array:
        """S (m, m)."""
        n = self.system.n
        return np.diag(np.repeat([0.0, 1.0], [4 * n, n]))

    def _dense(self, entries: Interval) -> Interval:
        return Interval(self._scattered(entries.mid), self._scattered(entries.rad))

    def _scattered(self, entries: Array) -> Array:
        """Return matrices (k, m, m) of the entries (entries, k) of the Jacobian."""
        m = 5 * self.system.n
        matrices = np.zeros((entries.shape[-1], m, m))
        rows, columns = self.system.pattern
        matrices[:, rows, columns] = entries.T
        return matrices
