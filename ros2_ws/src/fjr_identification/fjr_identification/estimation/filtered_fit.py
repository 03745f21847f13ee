# SPDX-License-Identifier: Apache-2.0
"""Fit all parameters to the errors of the equations along filtered motions: start and fallback of the simulation.

    link side    r = q_m - q_l - offset - tau / K             (phi^-1(tau) of springs that harden)
    motor side   r = u(t - delay) - tau - B a_m - D_m v_m - F_m tanh(v_m / v_0)
    torque       tau = M_l a + C v + grad P_l + D_l v_l + F_l tanh(v_l / v_0) + T(q_l)

The motor side counts only while the motor moves, because friction at rest takes any value up to static friction. These
errors need no simulation, so that torques which the model lacks do not add up over time. They are compared within the
bandwidth of the motion, because the noise of an acceleration would bias the stiffness (M. Gautier, ICRA 1997: filtered
and decimated regressors).

Errors of both sides and of all joints count together, each in units of its deviation, which is estimated with the
parameters (Gauss-Newton). They are coloured; blocks of the record have scores of their own, from which `verdicts`
widens the intervals.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fjr_core.model import springs
from fjr_core.numerics.checks import Array

from .elastic_arm import coulomb, packed, position_terms
from .estimation_problem import Estimation
from .motion_record import FilteredMotion, decimated, inner, shifted
from .multiple_shooting import NormalEquations, with_prior
from .optimise import bounded_step
from .parameters import HARDENING, LAG, OF_LINKS, POSITION_TORQUE, RATIO, SMOOTHING
from .verdicts import Estimates, estimates_at, not_identifiable

BLOCK = 1.0  # s; longer than the correlation of the errors
FEWEST_BLOCKS = 4  # of a record
LEAST_ERROR = 1e-3  # of the deflection or the effort; no model is better
MOVING = 2.0  # smoothing velocities; a slower motor may be at rest
EXCESS = 1.2  # static friction over Coulomb friction, at the start
MOST_ITERATIONS = 12  # of Gauss and Newton
LARGEST_STEP = 1.0  # of the prior's width
CONVERGED = 1e-3  # of the prior's width
LEAST_DEFLECTION = 3.0  # of its noise
NOT_SIMULATED = (
    "unmodelled torques are too large to simulate this joint; the value is from filtered least squares and may be off "
    "by more than the interval"
)

Columns = dict[tuple[str, int], Array]


@dataclass(frozen=True, eq=False)
class Side:
    """Errors r (k,) of an equation of a joint, and -dr/dp of each column (k,) by (name, index) of p.

    p of positive parameters is the logarithm. torque (k,) [N m]: of the spring. used (k,): samples that
    count. Every `stride`-th one, stride dt apart, is independent. measured: standard deviation of the deflection or the
    effort. record: number of the record.
    """

    errors: Array
    columns: Columns
    torque: Array
    used: Array
    dt: float
    stride: int
    measured: float
    record: int


class FilteredEquations:
    """Equations of both sides of each joint along the filtered motions of all records at z (p,).

    p: parameters by name. rigid: of each record, the torque (k, n) of the links and its derivatives by their free ones.
    """

    def __init__(self, setup: Estimation, z: Array) -> None:
        self.setup, self.p = setup, setup.coordinates.parameters(z)
        self.rigid = [self._rigid_along(motion) for motion in setup.motions]

    def links(self, j: int) -> list[Side]:
        """Return the equations of link j in the records that measure both sides of its joint."""
        return [self.link(k, j) for k, record in enumerate(self.setup.records) if record.both_sides(j)]

    def motors(self, j: int) -> list[Side]:
        """Return the equations of motor j in all records."""
        return [self.motor(k, j) for k in range(len(self.setup.records))]

    def link(self, record: int, j: int) -> Side:
        """Return the errors [rad] of the equation of link j in a record."""
        p, m = self.p, self.setup.motions[record]
        tau, columns, q = self._spring_torque(record, j)
        K, cubic, q_m = p["joint_stiffness"][j], p[HARDENING][j], m.q_m[:, j] / (1 + p[RATIO][j])
        zeta = springs.root(K, cubic, tau, np)
        tangent = K + 3 * cubic * zeta**2
        columns = {name: column / tangent for name, column in columns.items()}
        columns[("joint_stiffness", j)] = -zeta * (K / tangent)
        columns[(HARDENING, j)] = -(zeta**3) / tangent
        columns[("offset", j)] = np.ones(len(q))
        columns[("link_skew", j)] -= np.gradient(q, m.dt)
        columns[(RATIO, j)] = q_m / (1 + p[RATIO][j])
        errors = q_m - q - p["offset"][j] - zeta
        return self._side(record, q_m - q, errors, columns, tau, np.ones(len(q), dtype=bool))

    def motor(self, record: int, j: int) -> Side:
        """Return the errors [N m] of the equation of motor j in a record."""
        p, m = self.p, self.setup.motions[record]
        tau, columns, _ = self._spring_torque(record, j)
        u = shifted((m.u @ self.setup.robot.B_m.T)[:, j], m.dt, p["effort_delay"][j] + m.dt / 2)
        bend = np.gradient(np.gradient(u, m.dt), m.dt) / 2
        u = u + p[LAG][j] ** 2 * bend
        B, v, friction = p["motor_inertia"][j], m.v_m[:, j], coulomb(m.v_m[:, j], p[SMOOTHING][j])
        columns[("motor_inertia", j)] = B * m.a_m[:, j]
        columns[("motor_damping", j)] = v
        columns[("motor_coulomb_friction", j)] = friction
        columns[("motor_load_friction", j)] = np.abs(tau) * friction
        columns[("effort_delay", j)] = np.gradient(u, m.dt)
        columns[(LAG, j)] = -bend
        level = p["motor_coulomb_friction"][j] + p["motor_load_friction"][j] * np.abs(tau)
        explained = tau + B * m.a_m[:, j] + p["motor_damping"][j] * v + level * friction
        return self._side(record, u, u - explained, columns, tau, np.abs(v) > MOVING * p[SMOOTHING][j])

    def _rigid_along(self, motion: FilteredMotion) -> tuple[Array, Columns]:
        free = [(name, i) for name, i in self.setup.coordinates.free if name in OF_LINKS]
        if not free:
            return motion.rigid, {}
        arm = self.setup.arm(self.setup.coordinates)
        n, values, arguments = arm.robot.n, packed(arm, self.p), (motion.q_l.T, motion.v_l.T, motion.a_l.T)
        torque, slopes = (np.asarray(each) for each in arm.link_torque(*arguments, values))
        return torque.T, {parameter: slopes[k * n : (k + 1) * n].T for k, parameter in enumerate(free)}

    def _spring_torque(self, record: int, j: int) -> tuple[Array, Columns, Array]:
        """Return tau (k,) of joint j, its derivatives, and the position of the link, at the link's skew."""
        p, m, (rigid, slopes) = self.p, self.setup.motions[record], self.rigid[record]
        skew = p["link_skew"][j]
        q, v, tau = (shifted(signal[:, j], m.dt, skew) for signal in (m.q_l, m.v_l, rigid))
        friction, terms = coulomb(v, p[SMOOTHING][j]), position_terms(q, np)
        columns = {(name, j): term for name, term in zip(POSITION_TORQUE, terms, strict=True)}
        columns |= {("link_damping", j): v, ("link_coulomb_friction", j): friction}
        columns[("link_load_friction", j)] = np.abs(tau) * friction
        tau = tau + sum(p[name][i] * column for (name, i), column in columns.items())
        columns |= {name: shifted(slope[:, j], m.dt, skew) for name, slope in slopes.items()}
        columns[("link_skew", j)] = -np.gradient(tau, m.dt)
        return tau, columns, q

    def _side(self, record: int, measured: Array, errors: Array, columns: Columns, torque: Array, used: Array) -> Side:
        m = self.setup.motions[record]
        inside = {name: inner(column, m.dt) for name, column in columns.items()}
        errors, torque, used = (inner(values, m.dt) for values in (errors, torque, used))
        return Side(errors, inside, torque, used, m.dt, m.stride, float(np.std(measured)), record)


def equation_error(setup: Estimation, z: Array) -> list[NormalEquations]:
    """Return the normal equations by z (p,) of each block of the records, in units of the errors' deviation at z."""
    free, size = setup.coordinates.free, len(z)
    counts = [max(FEWEST_BLOCKS, round(len(motion.u) * motion.dt / BLOCK)) for motion in setup.motions]
    blocks = [[NormalEquations(np.zeros((size, size)), np.zeros(size)) for _ in range(count)] for count in counts]
    equations = FilteredEquations(setup, z)
    for j in range(setup.robot.n):
        for sides in (equations.links(j), equations.motors(j)):
            scale = _deviation(sides)
            for side in sides:
                entries = [i for i, name in enumerate(free) if name in side.columns]
                J_and_r = np.column_stack([*(side.columns[free[i]] for i in entries), side.errors])
                slow, of_record = decimated(J_and_r * side.used[:, None], side.stride), blocks[side.record]
                for block, rows in zip(of_record, np.array_split(slow, len(of_record)), strict=True):
                    J, r = rows[:, :-1], rows[:, -1]
                    block.H[np.ix_(entries, entries)] += J.T @ J / scale**2
                    block.g[entries] += J.T @ r / scale**2
    return [block for of_record in blocks for block in of_record]


def _deviation(sides: Sequence[Side]) -> float:
    """Return the root mean square error of the samples that count, at least a part of what is measured."""
    squares = sum(float(np.sum(decimated(side.errors * side.used, side.stride) ** 2)) for side in sides)
    shares = sum(float(np.sum(decimated(side.used.astype(float), side.stride) ** 2)) for side in sides)
    least = LEAST_ERROR * max((side.measured for side in sides), default=0.0)
    return max(float(np.sqrt(squares / shares)) if shares > 0 else 0.0, least) or 1.0


def filtered_fit(setup: Estimation, z: Array, fixed: Collection[int] = (), free: Collection[int] = ()) -> Array:
    """Return z (p,) with the least errors of the equations and the least distance from the prior.

    fixed: entries that keep their prior; so do those that `undetermined` lists, other than `free`.
    """
    fixed = {*fixed, *undetermined(setup)} - {*free}
    coordinates, width = setup.coordinates, setup.coordinates.width
    z = np.where([k in fixed for k in range(len(z))], coordinates.mean, z)
    fitted = np.array([k for k in range(len(z)) if k not in fixed], dtype=int)
    for _ in range(MOST_ITERATIONS if len(fitted) else 0):
        H, g = with_prior(coordinates, z, equation_error(setup, z))
        step = np.zeros(len(z))
        step[fitted] = bounded_step(H[np.ix_(fitted, fitted)], g[fitted], z[fitted], coordinates.nonnegative[fitted])
        largest = float(np.max(np.abs(step) / width))
        z = z + step / max(1.0, largest / LARGEST_STEP)
        if largest < CONVERGED:
            break
    return z


def filtered_estimates(setup: Estimation, z: Array) -> Estimates:
    """Return the estimates of a fit z (p,); what is not identifiable keeps its prior. At best weakly identified."""
    nothing = np.zeros((len(z), len(z)))
    parts = equation_error(setup, z)
    fixed = not_identifiable(parts, nothing, setup.coordinates.width, undetermined(setup))
    again = filtered_fit(setup, z, fixed)
    return estimates_at(setup, equation_error(setup, again), nothing, fixed, again, NOT_SIMULATED)


def undetermined(setup: Estimation) -> tuple[int, ...]:
    """Return the entries that are not fitted: `confounded`, stiffnesses whose deflection is within its noise, and the
    velocities over which friction turns over, because the filter smooths the turn.
    """
    deflected = [False] * setup.robot.n
    for record, motion in zip(setup.records, setup.motions, strict=True):
        for j in (j for j in range(setup.robot.n) if record.both_sides(j)):
            slow = decimated(motion.q_m[:, j] - motion.q_l[:, j], motion.stride)
            steps = np.diff(record.q_m[:, j] - record.q_l[:, j])
            noise = np.sqrt(np.nanmean(steps**2) / 2 / motion.stride)
            deflected[j] |= bool(np.std(slow) > LEAST_DEFLECTION * noise)
    free = enumerate(setup.coordinates.free)
    others = (
        k for k, (name, j) in free if name == SMOOTHING or (name in ("joint_stiffness", HARDENING) and not deflected[j])
    )
    return (*confounded(setup), *others)


def confounded(setup: Estimation) -> tuple[int, ...]:
    """Return the entries of link dampings with a free skew: both change a slow deflection alike."""
    free = setup.coordinates.free
    return tuple(k for k, (name, j) in enumerate(free) if name == "link_damping" and ("link_skew", j) in free)


def simulation_start(setup: Estimation, z: Array) -> dict[str, Array]:
    """Return the start values of a simulation from a fit z (p,): damping and friction divided evenly between the sides.

    Only their sums are known well. A descent that starts with all friction on one side may end in a local minimum.
    Where the skew is free, link damping D_l acts like a skew and a delay of D_l / K.
    """
    values = setup.coordinates.parameters(z)
    halves: dict[str, Array] = {}
    for kind in ("damping", "coulomb_friction", "load_friction"):
        half = (values[f"link_{kind}"] + values[f"motor_{kind}"]) / 2
        halves |= {f"link_{kind}": half, f"motor_{kind}": half}
    with_skew = np.isin(np.arange(setup.robot.n), [setup.coordinates.free[k][1] for k in confounded(setup)])
    added = halves["link_damping"] - values["link_damping"]
    late = np.where(with_skew, added / values["joint_stiffness"], 0.0)
    start = {**values, **halves, **{name: values[name] + late for name in ("link_skew", "effort_delay")}}
    return with_static_friction(start) if setup.options.static_friction else start


def with_static_friction(values: Mapping[str, Array]) -> dict[str, Array]:
    """Return parameters by name with static friction above the Coulomb friction, where its slope is not 0."""
    levels = {side: EXCESS * values[f"{side}_coulomb_friction"] for side in ("link", "motor")}
    return {**values, **{f"{side}_static_friction": level for side, level in levels.items()}}
