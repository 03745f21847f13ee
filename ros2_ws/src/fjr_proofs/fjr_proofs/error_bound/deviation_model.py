# SPDX-License-Identifier: Apache-2.0
"""Equations of the deviation z of the robot from a centre motion, the exact motion of a robot with other parameters.

    z = (q_l - q_lc, zeta - zeta_c, dq_l - dq_lc, dq_m - dq_mc),   zeta = q_m - q_l
    M_f(q_l) dz_3 = h_l = (K_f zeta - D_lf dq_l) / p_f - C_f dq_l - grad P_f - M_f(q_l) ddq_lc
    M_m dz_4      = h_m = M_m M_mf^-1 (B_m u - K_f zeta - D_mf dq_m) - M_m ddq_mc

Index f: of the true robot, whose uncertain parameters have the shares f (`UncertainRobot`). The centre motion (index c)
solves the equations of a robot with the shares c: its links move along q_lc(t), which determines the springs, the
motors and the effort u_c(t). h vanishes at z = 0, f = c and u = u_c. The law answers the centre motion by u_c + e_c,
with the defect e_c.

q_lc is the reference plus a Fourier series, a sum of sines with its period. The defect is small if the series is that
of the steady motion, which `tube.steady_motion` finds. A bound holds for any series; a better one makes it smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.linalg import block_diag

from fjr_core.errors import ParameterError
from fjr_core.law.interfaces import StaticLaw
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import MotorMotion
from fjr_core.motions.reference import JETS
from fjr_core.motions.sine import MultiSine, Sines
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import sparse

from ..verification.taylor_models import ROUNDING
from .cells import DERIVATIVES, Cells, cycles
from .uncertain_robot import UncertainRobot

HARMONICS = 6
"""Highest harmonic of the series, relative to the highest frequency of the reference."""
POINTS = 8
"""Points in a cell at which the series is evaluated for its largest value."""
NEGLIGIBLE = 1e-6  # of the largest coefficient


@dataclass(frozen=True, eq=False)
class CentreMotion:
    """Motion of the links along the reference of `cells` plus a Fourier series, of a robot with shares `factors` (u,).

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

    Arguments: path (n, 6) q_lc .. d5q_lc of the centre motion, motors (n, 3) its zeta, dq_m and ddq_m, jets (n, 6) q_ld
    .. d5q_ld of the reference, z (4n,), c and f (u,) shares of the centre motion and of the robot. Raises
    ParameterError for springs that harden.
    """

    def __init__(self, law: StaticLaw, uncertain: UncertainRobot | None = None) -> None:
        if law.robot.curve:
            raise ParameterError(
                f"the robot has a {law.robot.curve}; expected straight springs for a proof of the sampled loop"
            )
        self.law, self.robot, self.n = law, law.robot, law.robot.n
        self.uncertain = uncertain or UncertainRobot(law.robot)
        self._path, self._jets = (ca.SX.sym(name, self.n, DERIVATIVES) for name in ("path", "jets"))
        self._motors, self._z = ca.SX.sym("motors", self.n, 3), ca.SX.sym("z", 4 * self.n)
        self._c, self._f = (ca.SX.sym(name, self.uncertain.count) for name in "cf")

    @cached_property
    def motors(self) -> ca.Function:
        """(path, c) -> springs zeta, and dq_m, ddq_m of the centre motion (n, 3)."""
        return self._function("motors", "path c", self._motors_of_path)

    @cached_property
    def defect(self) -> ca.Function:
        """(path, jets, c) -> defect e_c of the law (n,) [N m], and the rate of B_m u_c (n,) [N m/s]."""
        torque = self._centre.torque
        e = ca.substitute(self._answer(ca.DM.zeros(4 * self.n))[0], self._motors, self._motors_of_path)
        e -= ca.DM(np.linalg.inv(self.robot.B_m)) @ torque
        return self._function("defect", "path jets c", e, self._rate(torque))

    @cached_property
    def states(self) -> ca.Function:
        """(path, c) -> state of the centre motion: q_l, zeta, dq_l and dq_m (4n,), and the effort u_c (n,)."""
        effort = ca.DM(np.linalg.inv(self.robot.B_m)) @ self._centre.torque
        state = ca.substitute(ca.vertcat(*self._moving(ca.DM.zeros(4 * self.n))), self._motors, self._motors_of_path)
        return self._function("states", "path c", state, effort)

    @cached_property
    def slopes(self) -> ca.Function:
        """(path, motors, z, c, f) -> d(h_l, h_m, h_s) / d(z, f) (3n, 4n + u) for u = u_c, and M_f(q_l) (n, n).

        h_s is what the springs pull more than those of the centre motion would; h_l and h_m are without it.
        """
        robot, (q_l, zeta, dq_l, dq_m) = self.uncertain, self._moving(self._z)
        K, D_m = (robot.matrix(name, self._f) for name in ("stiffness", "motor_damping"))
        force = K @ zeta - robot.matrix("link_damping", self._f) @ dq_l
        torque, inertia = robot.links(q_l, dq_l, self._path[:, 2], self._f)
        h_l = force / robot.factor("payload", self._f) - torque
        h_s = (K - robot.matrix("stiffness", self._c)) @ zeta
        names = ("stiffness", "motor_inertia", "motor_damping")
        torque = ca.horzcat(*(robot.matrix(name, self._c) for name in names)) @ ca.vec(self._motors[:, [0, 2, 1]])
        h_m = (torque - K @ zeta - D_m @ dq_m) / robot.factor("motor_inertia", self._f)
        h_m -= sparse(self.robot.M_m) @ self._motors[:, 2]
        h_l -= h_s / robot.factor("payload", self._c)
        h_m += h_s / robot.factor("motor_inertia", self._c)
        slopes = ca.jacobian(ca.vertcat(h_l, h_m, h_s), ca.vertcat(self._z, self._f))
        return self._function("slopes", "path motors z c f", slopes, inertia)

    @cached_property
    def law_slope(self) -> ca.Function:
        """(path, motors, jets, z) -> du/dz (n, 4n) of the law."""
        return self._function("law_slope", "path motors jets z", ca.jacobian(self._answer(self._z)[0], self._z))

    @cached_property
    def has_storage(self) -> bool:
        """True if the law has a storage V."""
        _, V = self._answer(self._z)
        return not (V.is_constant() and np.isnan(float(V)))

    @cached_property
    def storage(self) -> ca.Function:
        """(path, motors, jets, z) -> V [J] of the law."""
        _, V = self._answer(self._z)
        return self._function("storage", "path motors jets z", V)

    @cached_property
    def storage_slope(self) -> ca.Function:
        """(path, motors, jets, z) -> V [J] and dV/dz (4n,)."""
        _, V = self._answer(self._z)
        return self._function("storage_slope", "path motors jets z", V, ca.gradient(V, self._z))

    def _answer(self, z: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the effort (n,) of the law and its storage V at the deviation z."""
        q_l, zeta, dq_l, dq_m = self._moving(z)
        position, velocity = ca.vertcat(q_l, q_l + zeta), ca.vertcat(dq_l, dq_m)
        u, V = self.law.measured_expression(position, velocity, self._jets[:, :JETS], ca.DM(self.law.gain_values))
        return u, V

    def _moving(self, z: ca.SX) -> list[ca.SX]:
        """Return q_l, zeta, dq_l and dq_m (n,) at the deviation z."""
        centre = ca.vertcat(self._path[:, 0], self._motors[:, 0], self._path[:, 1], self._motors[:, 1])
        return ca.vertsplit(centre + z, self.n)

    @cached_property
    def _motors_of_path(self) -> ca.SX:
        """Springs zeta, and dq_m, ddq_m (n, 3) of the centre motion."""
        centre = self._centre
        return ca.horzcat(centre.theta - self._path[:, 0], centre.dtheta, centre.ddtheta)

    @cached_property
    def _centre(self) -> MotorMotion:
        """Spring torque, motor motion and motor torque B_m u_c of the robot with the shares c."""
        robot, (q, dq, ddq) = self.uncertain, (self._path[:, i] for i in range(3))
        torque = robot.factor("payload", self._c) * robot.links(q, dq, ddq, self._c)[0]
        tau = torque + robot.matrix("link_damping", self._c) @ dq
        q_m = q + sparse(np.linalg.inv(self.robot.K)) @ (tau / robot.factor("stiffness", self._c))
        dq_m = self._rate(q_m)
        ddq_m = self._rate(dq_m)
        M_m, D_m = (robot.matrix(name, self._c) for name in ("motor_inertia", "motor_damping"))
        return MotorMotion(tau, q_m, dq_m, ddq_m, M_m @ ddq_m + D_m @ dq_m + tau)

    def _rate(self, e: ca.SX) -> ca.SX:
        """Return de/dt along path and reference; e must not depend on their fifth derivatives."""
        states = ca.veccat(self._path[:, :-1], self._jets[:, :-1])
        return ca.jtimes(e, states, ca.veccat(self._path[:, 1:], self._jets[:, 1:]))

    def _function(self, name: str, arguments: str, *results: ca.SX) -> ca.Function:
        """Return a function of the named arguments, with dense results."""
        names = arguments.split()
        dense = [ca.densify(ca.SX(result)) for result in results]
        given, outputs = [getattr(self, f"_{key}") for key in names], [f"result{i}" for i in range(len(dense))]
        return ca.Function(name, given, dense, names, outputs, {"cse": True})


class ModalCoordinates:
    """Coordinates of the deviation in which the joints act on each other less than in their own.

    A bound of each coordinate by itself ignores the signs of the others. In the modes of a mean inertia matrix M_l,
    which the controller decouples, less is lost than in the joints:

        y = S z,  S = diag(R, R^-T K, R, R),   torques R^-T w,   accelerations R dz_3,   R' R = M_l

    torque = R^-T, acceleration = R^-1 and effort = R^-T B_m are (n, n), torques (3n, 3n) acts on links, motors and
    springs.
    """

    def __init__(self, robot: Robot, M_l: Array) -> None:
        eigenvalues, vectors = np.linalg.eigh(M_l)
        self.R: Array = np.sqrt(eigenvalues)[:, None] * vectors.T
        self.acceleration: Array = np.linalg.inv(self.R)
        self.torque: Array = self.acceleration.T
        self.torques: Array = block_diag(*[self.torque] * 3)
        self.effort: Array = self.torque @ robot.B_m
        self.effort_inverse: Array = np.asarray(np.linalg.inv(self.effort), dtype=float)
        self.S: Array = block_diag(self.R, self.torque @ robot.K, self.R, self.R)
        self.S_inverse: Array = np.linalg.inv(self.S)
