# SPDX-License-Identifier: Apache-2.0
"""Sampled loop of the deviation, linear about a centre motion: maps from sample to sample, what lies between, gains.

    Z_k+1 = L_i Z_k + integral over the sample of exp(A_i s) E_i w(t) ds + G_i e_k
    |Z_k| <= sum over l of |X_l G| e_max + sum over l of integral |X_l exp(A s) E| ds w_max,   X_l = L_k-1 ... L_k-l

Z: deviation and efforts in transit; w: torques of any time course with |w| <= w_max, e: errors of the effort. The peak
gains are the suprema of these sums. The integral of |g|, g = X exp(A s) E, is at most the trapezoidal rule of |g| and
T^3 / 12 max |g''|. The rest of the sum beyond the last lag is bounded by (1 - |X|)^-1, X the last product.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from os import cpu_count
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.law.linearized import Indices
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import c_library_of
from fjr_core.numerics.symbolic import evaluate_rows
from fjr_core.stability.linear_controller import static
from fjr_core.stability.linearization import held_maps, map_of_held, split

from ..verification.taylor_models import ROUNDING
from .cells import Cells
from .deviation_model import CentreMotion, DeviationModel, ModalCoordinates


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


@dataclass(frozen=True, eq=False)
class LinearLoop:
    """Linear model of the deviation in each of c cells about a centre motion, for a delay [s].

    late [s]: longest time in a sample in which the effort before or after acts, as the delay varies; 0 if it does not.

    M (c, n, n), H (c, n, 4n): M dz_3 = H z + d_l;  G (c, n, 4n), B (n, n): M_m dz_4 = G z + B v + d_m, v the deviation
    of the effort. F (c, n, 4n): v = F z at the sample. factors (c, 3n, u): torques d_l, d_m and d_s, which springs
    exert on links and motors, by the share of each parameter. The properties are in `coordinates`: y for z, and
    likewise for torques and efforts.
    """

    model: DeviationModel
    centre: CentreMotion
    delay: float
    late: float
    coordinates: ModalCoordinates
    M: Array
    H: Array
    G: Array
    B: Array
    F: Array
    factors: Array

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.model.n

    @property
    def links(self) -> slice:
        """Rows of the velocities of the links in y."""
        return slice(2 * self.n, 3 * self.n)

    @property
    def sample_period(self) -> float:
        """Sample period T [s]."""
        return self.centre.cells.sample_period

    def at(self, cells: Indices) -> LinearLoop:
        """Return the models of the selected cells."""
        names = ("M", "H", "G", "F", "factors")
        return replace(self, **{name: getattr(self, name)[cells] for name in names})

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
        """Inputs of the effort (c, 4n, n), and of the torques d_l, d_m, d_s (c, 4n, 3n)."""
        n, c, S = self.n, len(self.M), self.coordinates
        by_effort, by_torque = np.zeros((c, 4 * n, n)), np.zeros((c, 4 * n, 3 * n))
        M_m_inverse = np.linalg.inv(self.model.robot.M_m)
        by_effort[:, 3 * n :] = M_m_inverse @ self.B
        by_torque[:, 2 * n : 3 * n, :n], by_torque[:, 3 * n :, n : 2 * n] = np.linalg.inv(self.M), M_m_inverse
        payload, inertia = (
            self.model.uncertain.of_joints(name, self.centre.factors) for name in ("payload", "motor_inertia")
        )
        by_torque[:, 2 * n : 3 * n, 2 * n :] = np.linalg.inv(self.M) / payload
        by_torque[:, 3 * n :, 2 * n :] = -M_m_inverse / inertia
        return S.S @ by_effort @ S.effort_inverse, S.S @ by_torque @ np.linalg.inv(S.torques)

    @cached_property
    def largest(self) -> tuple[Array, Array, Array]:
        """Largest magnitudes in all cells of `A` (4n, 4n) and of the `inputs` (4n, n) and (4n, 3n)."""
        slope, by_effort, by_torque = (np.abs(X).max(axis=0) for X in (self.A, *self.inputs))
        return slope, by_effort, by_torque

    @cached_property
    def jumps(self) -> tuple[Array, Array]:
        """Largest changes (n, 4n) from cell to cell of the links' rows of `A`, if verified, and `law`, if aligned."""
        slope, law = (np.abs(np.roll(X, -1, axis=0) - X).max(axis=0) for X in (self.A[:, self.links], self.law))
        return slope * self.centre.cells.verified, law * self.centre.cells.aligned

    def between_samples(self, rate: Array, jerk: Array) -> tuple[Array, Array]:
        """Return by how much y (4n,) and the accelerations (n,) of the links may exceed their bounds at the samples.

        rate (4n,): bounds of dy/dt at the samples; jerk (n,): of A_l E w, A_l the links' rows of A. Infinite if there
        are none; zero for bounds at the samples. Within T / 2 of a sample |dy/dt| <= r = rate + T / 2 |A| r, |A|
        elementwise. Positions and A_l y differ from the chord between two samples by at most T^2 / 8 times a bound of
        their second derivatives; that of A_l y is A_l A dy/dt and the rate of A_l E w, which adds T / 2 jerk.
        """
        if not self.centre.cells.verified:
            return np.zeros_like(rate), np.zeros_like(jerk)
        half, n, (slope, _, _) = self.sample_period / 2, self.n, self.largest
        if np.abs(np.linalg.eigvals(half * slope)).max() >= 1:
            return np.full_like(rate, np.inf), np.full_like(jerk, np.inf)
        r = ROUNDING * np.linalg.solve(np.eye(4 * n) - half * slope, rate)
        acceleration = half**2 / 2 * self._bends @ r + half * jerk
        r[self.links] = np.minimum(r[self.links], rate[self.links] + acceleration)
        return np.concatenate([half**2 / 2 * slope[: 2 * n] @ r, half * r[2 * n :]]), acceleration

    @cached_property
    def _bends(self) -> Array:
        """Largest magnitudes (n, 4n) of A_l A, which gives the second derivative of A_l y from dy/dt."""
        return np.asarray(np.abs(self.A[:, self.links] @ self.A).max(axis=0))

    @property
    def spectral_radius(self) -> float:
        """Largest spectral radius of the sampled loops of the cells."""
        return float(np.abs(np.linalg.eigvals(self.models.loop)).max())

    @cached_property
    def models(self) -> CellModels:
        """The sampled loop of each cell.

        Outputs: accelerations M^-1 H z (n,) of the links, efforts v = F z (n,), with a delay that varies also its
        change since the last sample. That change is a further torque, on the motors while another effort acts.
        """
        n, T = self.n, self.sample_period
        by_effort, by_torque = self.inputs
        whole, fraction = split(self.delay, T)
        Phi, Gamma = after, _ = held_maps(self.A, by_effort, (1 - fraction) * T)
        held = {whole: Gamma}
        if fraction:
            first, Gamma_late = held_maps(self.A, by_effort, fraction * T)
            held[whole + 1] = Phi @ Gamma_late
            Phi = Phi @ first
        loop = map_of_held(Phi, held, static(self.law)(T))
        c, S = loop.shape[:2]

        def padded(rows: Array) -> Array:
            return np.concatenate([rows, np.zeros((c, S - 4 * n, rows.shape[2]))], axis=1)

        effort = padded(held.get(0, np.zeros((c, 4 * n, n))))
        effort[:, 4 * n : 5 * n] = np.eye(n)[: S - 4 * n]
        outputs = np.zeros((c, (3 if self.late else 2) * n, S))
        outputs[:, :n, : 4 * n], outputs[:, n : 2 * n, : 4 * n] = self.A[:, 2 * n : 3 * n], self.law
        if self.late:
            outputs[:, 2 * n :, : 4 * n], outputs[:, 2 * n :, 4 * n : 5 * n] = self.law, -np.eye(n)
        bend = curvature(self.A, by_torque, T) if self.centre.cells.verified else np.zeros_like(by_torque)
        ends, starts = by_torque, Phi @ by_torque
        if self.late:  # of the sample; the effort changes in its middle part
            change = self.late / T * (after @ by_effort)
            growth, _ = held_maps(np.abs(self.A), np.abs(by_effort), T)
            curved = self.late**2 / 2 * growth @ np.abs(self.A) @ np.abs(by_effort)
            ends, starts = (np.concatenate([each, change], axis=2) for each in (ends, starts))
            bend = np.concatenate([bend, curved], axis=2)
        return CellModels(
            loop,
            torque_late=padded(ends),
            torque_early=padded(starts),
            curvature=padded(bend),
            effort=effort,
            outputs=outputs,
        )

    def forced(self, torque: Array, aging: Array) -> Array:
        """Return the integral of exp(A (T - s)) E (torque + aging age(s)) over a sample (c, 4n, k).

        torque (c, 3n, k); aging (c, 3n) belongs to the first column. The effort that acts after s is s + whole T old,
        and T older while s < fraction T.
        """
        T, (whole, fraction), E = self.sample_period, split(self.delay, self.sample_period), self.inputs[1]
        force, slope = E @ torque, E @ aging[:, :, None]
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


def linear_loop(model: DeviationModel, centre: CentreMotion, delay: float, late: float = 0.0) -> LinearLoop:
    """Return the linear model in the middle of each cell about a centre motion, for a robot with its factors."""
    n, cells, c = model.n, centre.cells, centre.factors
    zero, factors = np.zeros((4 * n, cells.count)), np.tile(c[:, None], cells.count)
    path = centre.path.columns(cells.middle)
    (motors,) = columnwise(model.motors, path, factors)
    X, M = columnwise(model.slopes, path, motors, zero, factors, factors)
    path, jets = centre.path.columns(cells.sampled), cells.columns(cells.sampled)
    (F,) = columnwise(model.law_slope, path, *columnwise(model.motors, path, factors), jets, zero)
    inertia, slopes, law = (
        A.T.reshape(cells.count, -1, rows).swapaxes(1, 2).copy() for A, rows in ((M, n), (X, 3 * n), (F, n))
    )
    coordinates = ModalCoordinates(model.robot, inertia.mean(axis=0))
    B = model.robot.B_m / model.uncertain.of_joints("motor_inertia", c)[:, None]
    H, G, by_factor = slopes[:, :n, : 4 * n], slopes[:, n : 2 * n, : 4 * n], slopes[:, :, 4 * n :]
    return LinearLoop(model, centre, delay, late, coordinates, inertia, H, G, B, law, by_factor)


def curvature(A: Array, E: Array, T: float) -> Array:
    """Return T^3 / 12 exp(|A| T) |A^2 E| (c, N, m), a bound of T^3 / 12 |exp(A s) A^2 E| for s from 0 to T."""
    growth, _ = held_maps(np.abs(A), np.abs(E), T)
    return np.asarray(T**3 / 12 * growth @ np.abs(A @ A @ E))


def peak_gains(models: CellModels, cells: Cells, T: float, blocks: int, finals: Indices) -> Array:
    """Return the gains (S + r, m + n + S) from torques, effort errors and |Z| before the sums to |Z| and the outputs.

    The supremum is over the samples at the end of the cells `finals`; T [s]: sample period. blocks: length of the sums
    in cells. Infinite if the last product is not a contraction. Raises CompilerError without a C compiler.
    """
    S, m, n = models.loop.shape[1], models.torque_late.shape[2], models.effort.shape[2]
    loop, inputs, bent = _chained(models, cells.samples)
    maps, bent = np.concatenate([inputs, loop], axis=2), np.ascontiguousarray(bent)
    ffi, library, _ = c_library_of(__file__)

    def pointer(array: Array) -> Any:
        return ffi.from_buffer("double[]", array)

    sizes = {"states": S, "torques": m, "efforts": n, "samples": cells.samples}
    chain = ffi.new("struct fjr_chain *", {"maps": pointer(maps), "bent": pointer(bent), "half": T / 2, **sizes})

    def of_chain(final: Indices) -> tuple[Array, Array]:
        """Return the sums of the absolute responses of a chain back from the end of a cell, and its product."""
        X = np.concatenate([np.eye(S), models.outputs[final]])
        sums, product = np.zeros((len(X), m + n)), np.empty((len(X), maps.shape[2]))
        back = ffi.from_buffer(
            "int64_t[]", np.ascontiguousarray(cells.before(final, np.arange(blocks)), dtype=np.int64)
        )
        library.fjr_chain_sums(chain, back, blocks, len(X), *map(pointer, (X, sums, product)))
        return sums, np.abs(X)

    with ThreadPoolExecutor(cpu_count()) as pool:
        largest = reduce(lambda a, b: (np.maximum(a[0], b[0]), np.maximum(a[1], b[1])), pool.map(of_chain, finals))
    rest, gains = largest[1], np.hstack(largest)
    if not np.all(np.isfinite(gains)) or np.abs(np.linalg.eigvals(rest[:S])).max() >= 1:
        return np.full_like(gains, np.inf)
    states = np.linalg.solve(np.eye(S) - rest[:S], gains[:S])
    return np.asarray(ROUNDING * np.concatenate([states, gains[S:] + rest[S:] @ states]))


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
