# SPDX-License-Identifier: Apache-2.0
"""Plant and law linearised at rest, the law also by its Jacobian, and both under a hold and a delay.

Exact for small errors.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..control.sampled_law import MeasuredLaw, SampledLaw, Static
from ..control.static_law import StaticLaw
from ..control.vdpbc.gains import CheckedGains
from ..control.vdpbc.law import TrackingLaw
from ..control.vdpbc.linearized import error_matrices, feedback, metric_roots
from ..errors import StateError
from ..numerics.checks import Array
from ..numerics.symbolic import directional
from ..robot.configuration_sampling import checked_configurations
from ..robot.equilibrium import Indices, RestPoints, plant_matrices, rest_points
from ..robot.port_hamiltonian import Plant
from ..robot.robot import Robot
from ..trajectories.reference import JETS
from .linear_controller import At, Controller, Sensing, controller, plant_in_velocities, static

SCREENED = (0.0, 1.0)  # samples of delay beyond the given one at which the worst configurations are picked
OTHER_LAWS = 64  # configurations at which a law without a closed form is looked at
SERIES = 16  # terms: 0.5^16 / 16! = 7e-19


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """Plant and controller linearised at k rest configurations: dz = A z + B u before any sampling.

    configurations (k, n) [rad], A (k, 4n, 4n), B (k, 4n, n). F (k, n, 4n): the law u = F z of a static loop, in which
    z = P^(1/2) (q_tilde_l, q_tilde_m, sigma_l, sigma_m), so that V = |z|^2 / 2. with_state: the controller at a sample
    period [s] where it has a state, z then being positions and velocities; F is not read.
    """

    configurations: Array
    A: Array
    B: Array
    F: Array
    with_state: At | None = None

    def critical(self, sample_period: float, delay: float, most: int) -> Indices:
        """Indices: 0, and those of the `most` largest radii at the delay [s] and one sample more."""
        delays = (delay + samples * sample_period for samples in SCREENED)
        worst = [np.argsort(-self.radii(sample_period, late), kind="stable")[:most] for late in delays]
        return np.unique(np.concatenate([[0], *worst]))

    def radii(self, sample_period: float, delay: float = 0.0) -> Array:
        """Spectral radii (k,) of the loop sampled every sample_period [s] and delayed by `delay` [s].

        A command computed from z(t_j) is held from t_j + delay to t_j+1 + delay. Exact for the linear loop.
        """
        loop = self.one_sample_map(sample_period, delay)
        radii = np.full(len(loop), np.inf)
        finite = np.flatnonzero(np.isfinite(loop).all(axis=(1, 2)))
        radii[finite] = np.abs(np.linalg.eigvals(loop[finite])).max(axis=1)
        return radii

    def one_sample_map(self, sample_period: float, delay: float = 0.0) -> Array:
        """The map (k, N, N) from one sample to the next of (z, controller state, efforts on their way)."""
        T, (whole, late) = sample_period, _split(delay, sample_period)
        law = static(self.F) if self.with_state is None else self.with_state(T)
        Phi, Gamma = self._held((1 - late) * T)
        if not late:
            return _joined(Phi, {whole: Gamma}, law)
        Phi_late, Gamma_late = self._held(late * T)
        return _joined(Phi @ Phi_late, {whole: Gamma, whole + 1: Phi @ Gamma_late}, law)

    def at(self, indices: Indices) -> SampledLoop:
        """Return the loop at some of its configurations."""
        whole = self.with_state
        part = None if whole is None else lambda T: whole(T).at(indices)
        return SampledLoop(self.configurations[indices], self.A[indices], self.B[indices], self.F[indices], part)

    def _held(self, T: float) -> tuple[Array, Array]:
        """Phi (k, 4n, 4n) and Gamma (k, 4n, n): z(t + T) = Phi z(t) + Gamma u with u held."""
        with np.errstate(over="ignore", invalid="ignore"):  # an unstable plant over a long time
            Psi = _integrated_exponential(self.A, T)
            return np.eye(self.A.shape[1]) + self.A @ Psi, Psi @ self.B


def _integrated_exponential(A: Array, T: float) -> Array:
    """Psi (k, N, N), the integral of exp(A s) from 0 to T, for a stack A: a series over T / 2^j, doubled j times.

    Psi(2 h) = Psi(h) + exp(A h) Psi(h), exp(A h) = 1 + A Psi(h). SciPy's expm takes the matrices one by one.
    """
    one, norm = np.eye(A.shape[1]), float(np.abs(A).sum(axis=2).max())
    doublings = max(0, int(np.ceil(np.log2(2 * norm * T)))) if norm * T else 0
    h = T / 2**doublings
    Psi = one + A * h / SERIES
    for i in range(SERIES - 1, 1, -1):
        Psi = one + A @ Psi * (h / i)
    Psi = h * Psi
    for _ in range(doublings):
        Psi = Psi + Psi + A @ Psi @ Psi
    return Psi


def linearize(
    law: StaticLaw | SampledLaw,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
) -> SampledLoop:
    """The law on its own robot (or on another plant) about rest at configurations (k, n) [rad].

    The plant rests with its links at the configuration and the reference is there too; for another plant this
    leaves out that it would settle beside the reference. z is in the law's momenta, which are made from the
    plant's velocities; of another law than v-dPBC it is the state itself. Raises StateError for shapes that do not fit.
    A law with a state, or with sensing (an observer, torque sensors), is linearised where its own robot rests; z is
    then (q_l, q_m, dq_l, dq_m).
    """
    law, sensing = as_static(law), sensing or Sensing()
    plant = plant or Plant(law.robot)
    if plant.robot.n != law.robot.n:
        raise StateError(f"plant and law have {plant.robot.n} and {law.robot.n} joints; expected equal")
    q_l = looked_at(law, configurations)
    own, real = rest_points(law.robot, q_l), rest_points(plant.robot, q_l)
    if not isinstance(law, StaticLaw) or not sensing.plain:
        return loop_as_run(law, own, real, sensing)
    A, B, F = _jacobians(law, plant, real)
    A, B = in_momenta_of(own, real, A, B)
    return in_error_coordinates(own, law.gains, A, B, F) if isinstance(law, TrackingLaw) else SampledLoop(q_l, A, B, F)


def loop_as_run(law: StaticLaw | SampledLaw, own: RestPoints, real: RestPoints, sensing: Sensing) -> SampledLoop:
    """The law with its state and sensing, linearised where its own robot rests, on the plant of other rest points."""
    return on_plant(controller(as_sampled(law), own, sensing), own, real, sensing)


def on_plant(at: At, own: RestPoints, real: RestPoints, sensing: Sensing) -> SampledLoop:
    """A linearised controller on the plant of other rest points; z is (q_l, q_m, dq_l, dq_m)."""
    A, B = plant_in_velocities(real)
    seen = sensing.measured(own.robot, real.robot.K)
    return SampledLoop(own.q_l, A, B, np.swapaxes(B, 1, 2), at if seen is None else lambda T: at(T).seeing(seen))


def as_static(law: StaticLaw | SampledLaw) -> StaticLaw | SampledLaw:
    """The law itself where a sampled law has no state."""
    return law.law if isinstance(law, Static) and isinstance(law.law, StaticLaw) else law


def as_sampled(law: StaticLaw | SampledLaw) -> SampledLaw:
    """The law as one with a state."""
    return Static(law) if isinstance(law, StaticLaw) else law


def without_state(law: StaticLaw | SampledLaw) -> MeasuredLaw | SampledLaw:
    """The law below robust action."""
    return getattr(law, "law", law)


def looked_at(law: StaticLaw | SampledLaw, configurations: ArrayLike | None) -> Array:
    """The configurations as given, or those of loops; of a law without a closed form the first few sampled ones."""
    few = None if isinstance(without_state(law), TrackingLaw) else OTHER_LAWS
    return checked_configurations(law.robot, configurations, few)


def closed_form(law: TrackingLaw, configurations: Array, plant: Plant) -> SampledLoop:
    """What linearize gives, at a fraction of its cost, when the law's robot and the plant's are alike.

    Else only near it: the law's slope is that where its own robot would rest, not the plant.
    """
    own = rest_points(law.robot, configurations)
    real = own if plant.robot is law.robot else rest_points(plant.robot, configurations)
    A, B = in_momenta_of(own, real, *plant_matrices(real))
    return in_error_coordinates(own, law.gains, A, B, feedback(own, law.gains))


def in_momenta_of(own: RestPoints, real: RestPoints, A: Array, B: Array) -> tuple[Array, Array]:
    """A and B of a plant at rest in the momenta that its velocities make with the inertia of another robot."""
    T = own.blocks(
        [np.eye(own.robot.n), 0, 0, 0],
        [0, np.eye(own.robot.n), 0, 0],
        [0, 0, own.M_l @ np.linalg.inv(real.M_l), 0],
        [0, 0, 0, own.robot.M_m @ np.linalg.inv(real.robot.M_m)],
    )
    return T @ A @ np.linalg.inv(T), T @ B


def in_error_coordinates(rest: RestPoints, gains: CheckedGains, A: Array, B: Array, F: Array) -> SampledLoop:
    """The loop dx = A x + B u, u = F x, each a stack (k, ., .) over the rest points, in z = P^(1/2) e."""
    S = metric_roots(rest, gains) @ error_matrices(rest, gains)
    S_inverse = np.linalg.inv(S)
    return SampledLoop(rest.q_l, S @ A @ S_inverse, S @ B, F @ S_inverse)


def _jacobians(law: StaticLaw, plant: Plant, rest: RestPoints) -> tuple[Array, Array, Array]:
    """A, B and F in the coordinates of the state x, at the rest points of the plant with the reference there."""
    n = rest.robot.n
    plant_slope, law_slope = _plant_slope(plant), _law_slope(law)
    d_x, d_u = np.split(np.eye(5 * n), [4 * n])
    slopes = [plant_slope(x, u, d_x, d_u).full() for x, u in zip(rest.x, rest.u, strict=True)]
    F = [law_slope(x, q_l, np.eye(4 * n)).full() for x, q_l in zip(rest.x, rest.q_l, strict=True)]
    A, B = np.split(np.array(slopes), [4 * n], axis=2)
    return A, B, np.array(F)


@lru_cache(maxsize=2)
def _plant_slope(plant: Plant) -> ca.Function:
    """(x, u, d_x, d_u) -> derivative of the plant's dx in the direction (d_x, d_u)."""
    n = plant.robot.n
    x, u, d_x, d_u = (ca.SX.sym(name, size) for name, size in (("x", 4 * n), ("u", n), ("d_x", 4 * n), ("d_u", n)))
    slope = directional(plant.dynamics(x, u), ca.vertcat(x, u), ca.vertcat(d_x, d_u))
    return ca.Function("plant_slope", [x, u, d_x, d_u], [ca.densify(slope)])


@lru_cache(maxsize=2)
def _law_slope(law: StaticLaw) -> ca.Function:
    """(x, q_ld, d_x) -> derivative of u(x, x, t) in the direction d_x, the reference at rest in q_ld."""
    n = law.robot.n
    x, d_x, q_ld = ca.SX.sym("x", 4 * n), ca.SX.sym("d_x", 4 * n), ca.SX.sym("q_ld", n)
    jets = ca.horzcat(q_ld, ca.SX.zeros(n, JETS - 1))
    if isinstance(law, TrackingLaw):
        u = law.function(x, x, jets, ca.SX.zeros(n))
    else:
        velocity = ca.vertcat(*law.robot.velocity_expressions(x))
        u, _ = law.measured_expression(x[: 2 * n], velocity, jets, ca.DM(law.gain_values))
    slope = directional(u, x, d_x)
    return ca.Function("law_slope", [x, q_ld, d_x], [ca.densify(slope)], {"cse": True})


def _joined(Phi: Array, inputs: dict[int, Array], law: Controller) -> Array:
    """The map of (z, c, efforts of earlier samples): z+ = Phi z + sum of inputs[i] u(i samples ago), u by the law."""
    (k, n, N), m = law.F.shape, law.states
    past = max(*inputs, int(law.reads_sent))
    start = N + m  # of the efforts
    u = np.zeros((k, n, start + n * past))
    u[:, :, :N], u[:, :, N:start] = law.F, law.C
    loop = np.zeros((k, start + n * past, start + n * past))
    loop[:, :N, :N], loop[:, N:start, :N], loop[:, N:start, N:start] = Phi, law.G, law.H
    if past:
        last = slice(start, start + n)
        u[:, :, last], loop[:, N:start, last] = law.S, law.J
        loop[:, last] = u
        loop[:, start + n :, start:-n] = np.eye(n * (past - 1))
    for i, Gamma in inputs.items():
        if i == 0:
            loop[:, :N] += Gamma @ u
        else:
            loop[:, :N, start + n * (i - 1) : start + n * i] += Gamma
    return loop


def _split(delay: float, T: float) -> tuple[int, float]:
    """delay / T as whole samples and a fraction of one; what is a whole number to rounding is one."""
    samples = delay / T
    whole = round(samples) if abs(samples - round(samples)) < 1e-9 else int(samples)
    return whole, max(samples - whole, 0.0)


def slope_at_rest(law: StaticLaw, q_l: Array) -> tuple[Array, Array]:
    """F (n, 4n), G (n, n): du = F d(q_l, q_m, dq_l, dq_m) + G dq_ld, links and reference at rest at q_l (n,) [rad]."""
    n, position = law.robot.n, rest_position(law.robot, q_l)
    found = _slope(law.measured_expression)(position, np.zeros(2 * n), q_l, law.gain_values, np.eye(5 * n)).full()
    return found[:, : 4 * n], found[:, 4 * n :]


def rest_position(robot: Robot, q_l: Array) -> Array:
    """(q_l, q_m) (2n,) [rad] at rest: the springs carry the weight."""
    return np.concatenate([q_l, q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l))])


@lru_cache(maxsize=8)
def _slope(measured: ca.Function) -> ca.Function:
    """(position, velocity, q_ld, gains, d) -> derivative of u along d (5n,), the reference at rest in q_ld."""
    n = measured.size1_in("jets")
    sizes = {"position": 2 * n, "velocity": 2 * n, "q_ld": n, "gains": measured.size1_in("gains"), "d": 5 * n}
    position, velocity, q_ld, gains, d = symbols = [ca.SX.sym(name, size) for name, size in sizes.items()]
    u, _ = measured(position, velocity, ca.horzcat(q_ld, ca.SX.zeros(n, JETS - 1)), gains)
    slope = directional(u, ca.vertcat(position, velocity, q_ld), d)
    return ca.Function("slope", symbols, [ca.densify(slope)], {"cse": True})
