# SPDX-License-Identifier: Apache-2.0
"""The closed loop under a held effort, in error coordinates, with its derivatives and its solutions during one sample.

    d qt_l = s_l - phi_l(qt_l)
    M_l ds_l = -(C_l + D_l + K_ld) s_l - Pi_l qt_l + K qt_m
    d qt_m = s_m - phi_m(qt_m) - Pi_m^-1 K' s_l
    M_m ds_m = -(D_m + K_md) s_m - Pi_m qt_m + B_m w
    dw = -d/dt u

w = u_held - u(x, x, t) is the held effort minus the law's effort now. Without hold and delay w = 0, and the first four
equations are the error dynamics of docs/method.md. u is the very expression of the law. In these coordinates the
Jacobian depends on the errors weakly: on the paper's joint only through the gravity torque in u.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import TrajectoryError
from fjr_core.law.gains import terms
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.motions.reference import JETS, Reference
from fjr_core.motions.sine import Sines, common_period
from fjr_core.numerics.checks import Array, kind_of
from fjr_core.numerics.intervals import Interval
from fjr_core.numerics.symbolic import solve

from ..verification.interval_matrices import ABOVE
from ..verification.taylor_models import TaylorFunction

DERIVATIVES = JETS + 2
"""Values and derivatives of the reference: the time derivative of the Jacobian of du/dt needs the sixth."""
STEPS = 4
"""Steps of a sample, each with a box that no solution leaves."""
TRIALS = 12
"""Attempts to find such a box."""


@dataclass(frozen=True, eq=False)
class ErrorSystem:
    """The loop of a law with its own robot; chi = (qt_l, qt_m, s_l, s_m, w) (5n,), jets (n, 7): q_ld .. d6q_ld."""

    law: TrackingLaw

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.law.robot.n

    @cached_property
    def symbols(self) -> tuple[ca.SX, ca.SX]:
        """Symbols chi and jets."""
        return ca.SX.sym("chi", 5 * self.n), ca.SX.sym("jets", self.n, DERIVATIVES)

    @cached_property
    def field(self) -> TaylorFunction:
        """The function (chi, jets) -> d chi/dt, enclosed."""
        return TaylorFunction(ca.Function("field", list(self.symbols), [self._field], {"cse": True}))

    @cached_property
    def state(self) -> ca.Function:
        """The CasADi function (chi, jets) -> position and velocity (2n,) of a state with these errors."""
        return ca.Function("state", list(self.symbols), list(self._measured[:2]), {"cse": True})

    @cached_property
    def pattern(self) -> tuple[list[int], list[int]]:
        """Rows and columns of the entries of the Jacobian that are not zero everywhere."""
        rows, columns = self._jacobian.sparsity().get_triplet()
        return list(rows), list(columns)

    @cached_property
    def jacobian(self) -> TaylorFunction:
        """Entries of D = d(d chi/dt)/d chi in the pattern, on intervals."""
        entries = ca.vertcat(*self._jacobian.nonzeros())
        return TaylorFunction(ca.Function("jacobian", list(self.symbols), [entries], {"cse": True}))

    def curvature(self, chi: Interval, jets: Interval) -> tuple[Interval, Interval]:
        """Return the derivatives of these entries by chi (5n, entries, k) and by time (entries, k), on k boxes."""
        derivatives, places = self._curvature
        by_chi, by_time = derivatives.on_intervals(chi, jets)
        there = (places >= 0)[:, :, None]
        return Interval(by_chi.mid[places] * there, by_chi.rad[places] * there), by_time

    @cached_property
    def _curvature(self) -> tuple[TaylorFunction, NDArray[np.int_]]:
        """Second derivatives of the field by chi_j, chi_k, j <= k, and by time; places (5n, entries): -1 for zeros.

        The derivative of the entry (i, j) by chi_k is that of (i, k) by chi_j.
        """
        (chi, jets), entries = self.symbols, self._jacobian.nonzeros()
        at = {place: e for e, place in enumerate(zip(*self.pattern, strict=True))}
        places, parts, count = np.full((5 * self.n, len(entries)), -1), [], 0
        for k in range(5 * self.n):
            chosen = [(i, j) for i, j in at if j <= k and (i, k) in at]
            for i, j in chosen:
                places[k, at[i, j]] = places[j, at[i, k]] = count
                count += 1
            direction = ca.DM(np.eye(5 * self.n)[k])
            parts.append(ca.jtimes(ca.vertcat(*(entries[at[place]] for place in chosen)), chi, direction))
        by_time = ca.jtimes(ca.vertcat(*entries), ca.vec(jets), ca.vec(self._jet_rates))
        outputs = [ca.densify(ca.vertcat(*parts)), ca.densify(by_time)]
        return TaylorFunction(ca.Function("curvature", [chi, jets], outputs, {"cse": True})), places

    @cached_property
    def by_time(self) -> TaylorFunction:
        """The partial derivative of the field by time (5n,), on intervals."""
        chi, jets = self.symbols
        rate = ca.densify(ca.jtimes(self._field, ca.vec(jets), ca.vec(self._jet_rates)))
        return TaylorFunction(ca.Function("by_time", [chi, jets], [rate], {"cse": True}))

    @property
    def _jet_rates(self) -> ca.SX:
        _, jets = self.symbols
        return ca.horzcat(jets[:, 1:], ca.SX.zeros(self.n))

    @cached_property
    def _jacobian(self) -> ca.SX:
        return ca.jacobian(self._field, self.symbols[0])

    @cached_property
    def _field(self) -> ca.SX:
        chi, jets = self.symbols
        errors = self._error_rates
        z, dz = ca.vertcat(chi[: 4 * self.n], ca.vec(jets)), ca.vertcat(errors, ca.vec(self._jet_rates))
        return ca.densify(ca.vertcat(errors, -ca.jtimes(self._measured[2], z, dz)))

    @cached_property
    def _error_rates(self) -> ca.SX:
        """Rates (4n,) of the errors."""
        r, g, (chi, _) = self.law.robot, terms(self.law.gains), self.symbols
        qt_l, qt_m, s_l, s_m, w = ca.vertsplit(chi, self.n)
        q_l, dq_l = self._links
        inertial = r.links.inertial_torque(q_l, dq_l, s_l, ca.SX.zeros(self.n))  # C_l s_l
        link = -inertial - (r.D_l + g.K_ld) @ s_l - g.Pi_l @ qt_l + ca.DM(r.K) @ qt_m
        motor = -(r.D_m + g.K_md) @ s_m - g.Pi_m @ qt_m + ca.DM(r.B_m) @ w
        return ca.vertcat(
            s_l - g.phi_l(qt_l),
            s_m - g.phi_m(qt_m) - g.Pi_m_inverse @ ca.DM(r.K.T) @ s_l,
            solve(r.links.M_l(q_l), link),
            ca.DM(np.linalg.inv(r.M_m)) @ motor,
        )

    @property
    def _links(self) -> tuple[ca.SX, ca.SX]:
        """Link positions and velocities (n,) of the errors, eqs. (30), (31)."""
        (chi, jets), phi_l = self.symbols, terms(self.law.gains).phi_l
        qt_l, s_l = chi[: self.n], chi[2 * self.n : 3 * self.n]
        return jets[:, 0] + qt_l, jets[:, 1] - phi_l(qt_l) + s_l

    @cached_property
    def _measured(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Position and velocity (2n,) of the errors, and the law's effort u (n,) there.

        q_md depends on (q_l, dq_l) only, and v_mr on (q_l, q_m, dq_l) only, so that the law's own errors at zero motor
        position and velocity give them.
        """
        inputs, outputs = self.law.measured_expressions()
        errors = [outputs[name] for name in ("q_tilde_m", "s_m", "u")]
        of_law = ca.Function("of_law", list(inputs.values()), errors)
        (chi, jets), gains, zero = self.symbols, ca.DM(self.law.gain_values), ca.SX.zeros(self.n)
        _, qt_m, _, s_m, _ = ca.vertsplit(chi, self.n)
        (q_l, dq_l), jets = self._links, jets[:, :JETS]
        minus_q_md = of_law(ca.vertcat(q_l, zero), ca.vertcat(dq_l, zero), jets, gains)[0]
        position = ca.vertcat(q_l, qt_m - minus_q_md)
        minus_v_mr = of_law(position, ca.vertcat(dq_l, zero), jets, gains)[1]
        velocity = ca.vertcat(dq_l, s_m - minus_v_mr)
        return position, velocity, of_law(position, velocity, jets, gains)[2]


@dataclass(frozen=True, eq=False)
class EnclosedFlow:
    """Solutions during one sample, as deviations from the centre (m, k).

    start: bounds at the start. grown: bounds of the change. box: bounds throughout, infinite without a bound. jets: the
    reference over the piece and the sample after it.
    """

    start: Array
    grown: Array
    box: Array
    jets: Interval

    @property
    def reached(self) -> Array:
        """Bounds (m, k) at every instant of the sample."""
        return np.asarray(ABOVE * (self.start + self.grown))


def enclosed_flow(system: ErrorSystem, centre: Array, start: Array, jets: Interval, h: float) -> EnclosedFlow:
    """Return bounds of solutions that start with |chi - c| at most start (s, k), c = centre (m, k), during h [s].

    Rows s .. m of chi, the effort error w without a delay, start at c. w may drop to zero at any time.
    """
    first = np.zeros_like(centre)
    first[: len(start)] = start
    first[-system.n :] += np.abs(centre[-system.n :])  # w after the change of the effort
    reached, box = first, first
    for _ in range(STEPS):
        box, rates = _step(system, centre, jets, reached, h / STEPS)
        reached = reached + ABOVE * h / STEPS * rates
        if not np.isfinite(reached).all():
            break
    return EnclosedFlow(first, ABOVE * (reached - first), box, jets)


def _step(system: ErrorSystem, centre: Array, jets: Interval, reached: Array, step: float) -> tuple[Array, Array]:
    """Return bounds of |chi - c| and of the field over a step [s] from |chi - c| <= reached; infinite without."""
    box = reached
    for _ in range(TRIALS):
        rates = system.field.on_intervals(Interval(centre, box), jets)[0].magnitude
        end = reached + ABOVE * step * rates
        if np.all(end <= box):
            return box, rates
        box = 1.02 * end + 1e-300
    return np.full_like(box, np.inf), np.full_like(box, np.inf)


def period_of(reference: Reference) -> float | None:
    """Return the period [s] of a sinusoidal reference; None if it is constant.

    Raises TrajectoryError for another reference, and for sines without a common period.
    """
    if not isinstance(reference, Sines):
        raise TrajectoryError(f"reference is {kind_of(reference)}; expected sines, whose derivatives are enclosed")
    amplitude, frequency, _ = reference.rows
    moving = frequency[amplitude != 0]
    if not np.any(moving):
        return None
    period = common_period(moving)
    if period is None:
        raise TrajectoryError(f"reference has the frequencies {np.unique(moving).tolist()}; expected a common period")
    return period
