# SPDX-License-Identifier: Apache-2.0
"""Equations of the deviation z of the robot from a centre motion, the exact motion of a robot with other parameters.

    z = (q_l - q_lc, zeta - zeta_c, dq_l - dq_lc, dq_m - dq_mc),   zeta = q_m - q_l
    M_l(q_l) dz_3 = h(z) = (f_K K zeta - f_D D_l dq_l) / (p f_M) - C dq_l - f_g / f_M grad P_l - M_l(q_l) ddq_lc
    M_m dz_4      = (B_m u - f_K K zeta - f_Dm D_m dq_m) / f_Mm - M_m ddq_mc

The centre motion (index c) solves the equations of a robot with the factors c: its links move along q_lc(t), which
determines the springs, the motors and the effort u_c(t). The factors of the true robot are f (`FACTORS`); p multiplies
inertia and weight of the links together. At z = 0, h is the torque error d_l of the links, which vanishes for f = c;
likewise d_m of the motors. The law answers the centre motion by u_c + e_c, with the defect e_c.

q_lc is the reference plus a Fourier series, a sum of sines with its period. The defect is small if the series is that
of the steady motion, which `tube.steady_motion` finds. A bound holds for any series; a better one makes it smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np

from fjr_core.errors import ParameterError
from fjr_core.law.interfaces import StaticLaw
from fjr_core.motions.inverse_dynamics import MotorMotion
from fjr_core.motions.reference import JETS
from fjr_core.motions.sine import MultiSine, Sines
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import directional, sparse

from .cells import DERIVATIVES, Cells, cycles
from .peak_gains import ROUNDING

FACTORS = (
    "payload",
    "link_inertia",
    "gravity",
    "stiffness",
    "motor_inertia",
    "link_damping",
    "motor_damping",
)
"""Factors of the true robot on the parameters of the model, 1 without an error."""
HARMONICS = 6
"""Highest harmonic of the series, relative to the highest frequency of the reference."""
POINTS = 8
"""Points in a cell at which the series is evaluated for its largest value."""
NEGLIGIBLE = 1e-6  # of the largest coefficient


@dataclass(frozen=True, eq=False)
class CentreMotion:
    """Motion of the links along the reference of `cells` plus a Fourier series, of a robot with `factors` (7,).

    series (k + 1, n) complex: q_lc - q_ld = sum of Re(series[i] exp(j i w t)), w the base frequency of the period.
    """

    cells: Cells
    factors: Array
    series: Array

    @classmethod
    def ideal(cls, cells: Cells, factors: Array) -> CentreMotion:
        """Return the motion whose links stay on the reference."""
        return cls(cells, factors, np.zeros((1, cells.reference.n), dtype=complex))

    @property
    def base(self) -> float:
        """Base frequency w [rad/s]."""
        return 2 * np.pi / (self.cells.length * self.cells.count)

    @cached_property
    def largest(self) -> Array:
        """Bounds (2n,) of |q_lc - q_ld| [rad] and |dq_lc - dq_ld| [rad/s] at all times.

        Between points a sum of sines differs from the nearer one by at most half their distance times its largest rate.
        """
        amplitude, frequency, _ = rows = _rows(self.series, self.base)
        correction = MultiSine(*rows, offset=self.series[0].real)
        apart = self.cells.length / POINTS
        jets = correction.jets(apart * np.arange(POINTS * self.cells.count))
        rates = np.concatenate([(amplitude * frequency**i).sum(axis=0) for i in (1, 2)])
        return ROUNDING * (np.abs(jets[:, :2]).max(axis=0).ravel() + apart / 2 * rates)

    @property
    def path(self) -> Cells:
        """The cells of the motion of the links."""
        reference = self.cells.reference
        if not np.any(self.series) or not isinstance(reference, Sines):
            return self.cells
        rows = zip(reference.rows, _rows(self.series, self.base), strict=True)
        amplitude, frequency, phase = (np.concatenate(pair) for pair in rows)
        offset = np.asarray(reference.offset) + self.series[0].real
        return self.cells.along(MultiSine(amplitude, frequency, phase, offset))

    def moved(self, q: Array) -> CentreMotion:
        """Return the motion with deviations q (c, n) [rad] at the ends of the cells added to the series."""
        t, highest = self.cells.ends, 0  # harmonic that the cells resolve
        if isinstance(self.cells.reference, Sines):
            fastest = cycles(self.cells.reference, self.cells.length * self.cells.count)
            highest = int(min(round(HARMONICS * fastest), (self.cells.count - 1) // 4))
        harmonics = np.arange(highest + 1)
        added = 2 / len(t) * np.exp(-1j * self.base * np.outer(harmonics, t)) @ q
        added[0] = added[0].real / 2
        series = np.zeros((max(len(added), len(self.series)), q.shape[1]), dtype=complex)
        series[: len(self.series)] = self.series
        series[: len(added)] += added
        series[np.abs(series) < NEGLIGIBLE * np.abs(series).max()] = 0
        return replace(self, series=series)


def _rows(series: Array, base: float) -> tuple[Array, Array, Array]:
    """Return amplitude, frequency and phase (k, n) of the sines of a series; at least one."""
    harmonics = np.append(np.flatnonzero(np.any(series[1:], axis=1)) + 1, [] if np.any(series[1:]) else 0).astype(int)
    terms = np.where(harmonics[:, None] > 0, series[harmonics], 0)
    frequency = base * harmonics[:, None] + np.zeros(terms.shape)
    return np.abs(terms), frequency, np.angle(terms) + np.pi / 2


class DeviationModel:
    """CasADi functions of the deviation under a static law and its robot; n joints.

    Arguments: path (n, 6) q_lc .. d5q_lc of the centre motion, jets (n, 6) q_ld .. d5q_ld of the reference, z (4n,),
    c and f (7,) factors of the centre motion and of the robot. Raises ParameterError for springs that harden.
    """

    def __init__(self, law: StaticLaw) -> None:
        if law.robot.curve:
            raise ParameterError(
                f"the robot has a {law.robot.curve}; expected straight springs for a proof of the sampled loop"
            )
        self.law, self.robot, self.n = law, law.robot, law.robot.n
        self._path, self._jets = (ca.SX.sym(name, self.n, DERIVATIVES) for name in ("path", "jets"))
        self._z, (self._c, self._f) = ca.SX.sym("z", 4 * self.n), (ca.SX.sym(name, len(FACTORS)) for name in "cf")

    @cached_property
    def torque_terms(self) -> ca.Function:
        """(path, c) -> terms T (2n, 6) [N m] of the torque errors (d_l, d_m) = T a(f)."""
        robot = self.robot
        motors = sparse(robot.M_m) @ self._centre.ddtheta, sparse(robot.D_m) @ self._centre.dtheta, self._centre.tau
        terms = ca.diagcat(ca.horzcat(*self._link_torques), ca.horzcat(*motors))
        return self._function("torque_terms", "path c", terms)

    @cached_property
    def coefficients(self) -> ca.Function:
        """(c, f) -> derivatives (6, 7) of the coefficients a(f) of the torque terms with respect to f; a(c) = 0."""
        p, f_M, f_g, f_K, f_Mm, f_D, f_Dm = ca.vertsplit(self._f)
        c_p, c_M, c_g, c_K, c_Mm, c_D, c_Dm = ca.vertsplit(self._c)
        inertial, friction = c_p * c_M * f_K / c_K / (p * f_M) - 1, (c_D * f_K / c_K - f_D) / (p * f_M)
        weight = (c_p * c_g * f_K / c_K / p - f_g) / f_M
        motors = (c_Mm - f_Mm) / f_Mm, (c_Dm - f_Dm) / f_Mm, (1 - f_K / c_K) / f_Mm
        derivatives = ca.jacobian(ca.vertcat(inertial, friction, weight, *motors), self._f)
        return self._function("coefficients", "c f", derivatives)

    @cached_property
    def defect(self) -> ca.Function:
        """(path, jets, c) -> defect e_c of the law (n,) [N m], and the rate of B_m u_c (n,) [N m/s]."""
        torque = self._centre.torque
        e = self._answer(ca.DM.zeros(4 * self.n))[0] - ca.DM(np.linalg.inv(self.robot.B_m)) @ torque
        return self._function("defect", "path jets c", e, self._rate(torque))

    @cached_property
    def states(self) -> ca.Function:
        """(path, c) -> state of the centre motion: q_l, zeta, dq_l and dq_m (4n,), and the effort u_c (n,)."""
        effort = ca.DM(np.linalg.inv(self.robot.B_m)) @ self._centre.torque
        state = ca.vertcat(*self._moving(ca.DM.zeros(4 * self.n)))
        return self._function("states", "path c", state, effort)

    @cached_property
    def link_slope(self) -> ca.Function:
        """(path, z, c, f) -> dh/dz (n, 4n), M_l(q_l) (n, n)."""
        p, f_M, f_g, f_K, _, f_D, _ = ca.vertsplit(self._f)
        robot, (q_l, zeta, dq_l, _) = self.robot, self._moving(self._z)
        spring, friction = f_K * (sparse(robot.K) @ zeta), f_D * (sparse(robot.D_l) @ dq_l)
        h = (spring - friction) / (p * f_M) - f_g / f_M * robot.links.grad_P_l(q_l)
        h -= robot.links.inertial_torque(q_l, dq_l, dq_l, self._path[:, 2])
        results = ca.jacobian(h, self._z), robot.links.M_l(q_l)
        return self._function("link_slope", "path z c f", *results)

    @cached_property
    def motor_slope(self) -> ca.Function:
        """(f) -> slope (n, 4n) of M_m dz_4 in z, and B_m / f_Mm (n, n)."""
        _, _, _, f_K, f_Mm, _, f_Dm = ca.vertsplit(self._f)
        zero = ca.SX(self.n, self.n)
        slope = ca.horzcat(zero, -f_K / f_Mm * self.robot.K, zero, -f_Dm / f_Mm * self.robot.D_m)
        return self._function("motor_slope", "f", slope, self.robot.B_m / f_Mm)

    @cached_property
    def law_slope(self) -> ca.Function:
        """(path, jets, z, c) -> du/dz (n, 4n) of the law."""
        return self._function("law_slope", "path jets z c", ca.jacobian(self._answer(self._z)[0], self._z))

    @cached_property
    def has_storage(self) -> bool:
        """True if the law has a storage V."""
        _, V = self._answer(self._z)
        return not (V.is_constant() and np.isnan(float(V)))

    @cached_property
    def storage(self) -> ca.Function:
        """(path, jets, z, c) -> V [J] of the law."""
        _, V = self._answer(self._z)
        return self._function("storage", "path jets z c", V)

    @cached_property
    def storage_slope(self) -> ca.Function:
        """(path, jets, z, c) -> V [J] and dV/dz (4n,)."""
        _, V = self._answer(self._z)
        return self._function("storage_slope", "path jets z c", V, ca.gradient(V, self._z))

    def _answer(self, z: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the effort (n,) of the law and its storage V at the deviation z."""
        q_l, zeta, dq_l, dq_m = self._moving(z)
        position, velocity = ca.vertcat(q_l, q_l + zeta), ca.vertcat(dq_l, dq_m)
        u, V = self.law.measured_expression(position, velocity, self._jets[:, :JETS], ca.DM(self.law.gain_values))
        return u, V

    def _moving(self, z: ca.SX) -> list[ca.SX]:
        """Return q_l, zeta, dq_l and dq_m (n,) at the deviation z."""
        zeta = sparse(np.linalg.inv(self.robot.K)) @ self._centre.tau / self._c[FACTORS.index("stiffness")]
        centre = ca.vertcat(self._path[:, 0], zeta, self._path[:, 1], self._centre.dtheta)
        return ca.vertsplit(centre + z, self.n)

    @cached_property
    def _link_torques(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Inertial torque, friction and weight (n,) [N m] of the model along the centre motion."""
        q, dq, ddq = (self._path[:, i] for i in range(3))
        links = self.robot.links
        return links.inertial_torque(q, dq, dq, ddq), sparse(self.robot.D_l) @ dq, links.grad_P_l(q)

    @cached_property
    def _centre(self) -> MotorMotion:
        """Spring torque, motor motion and motor torque B_m u_c of the robot with the factors c."""
        robot, (c_p, c_M, c_g, c_K, c_Mm, c_D, c_Dm) = self.robot, ca.vertsplit(self._c)
        inertial, friction, weight = self._link_torques
        tau = c_p * c_M * inertial + c_D * friction + c_p * c_g * weight
        q_m = self._path[:, 0] + sparse(np.linalg.inv(robot.K)) @ tau / c_K
        dq_m = self._rate(q_m)
        ddq_m = self._rate(dq_m)
        torque = c_Mm * (sparse(robot.M_m) @ ddq_m) + c_Dm * (sparse(robot.D_m) @ dq_m) + tau
        return MotorMotion(tau, q_m, dq_m, ddq_m, torque)

    def _rate(self, e: ca.SX) -> ca.SX:
        """Return de/dt along path and reference; e must not depend on their fifth derivatives."""
        states = ca.veccat(self._path[:, :-1], self._jets[:, :-1])
        return directional(e, states, ca.veccat(self._path[:, 1:], self._jets[:, 1:]))

    def _function(self, name: str, arguments: str, *results: ca.SX) -> ca.Function:
        """Return a function of the named arguments, with dense results."""
        names = arguments.split()
        dense = [ca.densify(ca.SX(result)) for result in results]
        given, outputs = [getattr(self, f"_{key}") for key in names], [f"result{i}" for i in range(len(dense))]
        return ca.Function(name, given, dense, names, outputs, {"cse": True})
