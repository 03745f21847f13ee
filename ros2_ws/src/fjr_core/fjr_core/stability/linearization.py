# SPDX-License-Identifier: Apache-2.0
"""Linearise plant and law at equilibria, and form the one-sample map of the loop under hold and delay."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import StateError
from ..law.gains import CheckedGains
from ..law.interfaces import AsSampledLaw, SampledLaw, StaticLaw, check_law
from ..law.linearized import Equilibria, Indices, equilibria_at, error_matrices, feedback, metric_roots, plant_matrices
from ..law.vdpbc import TrackingLaw
from ..model.configuration_sampling import checked_configurations
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot
from ..motions.reference import JETS
from ..numerics.checks import Array
from ..numerics.symbolic import directional, symbols
from .linear_controller import At, Controller, Sensing, controller, plant_in_velocities, static

OTHER_LAWS = 64  # configurations at which a law without a closed form is checked


def linearize(
    law: StaticLaw | SampledLaw,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
) -> SampledLoop:
    """Linearise the closed loop of a law and its own robot, or another plant, at configurations (k, n) [rad].

    The links of the plant and the reference are at rest at the configuration; the steady-state error of another plant
    is neglected. z contains the momenta of the law, computed from the velocities of the plant; for another law than
    v-dPBC z is the state itself. A law with a controller state or with sensing (observer, torque sensors) is linearised
    at the equilibrium of its own robot, with z = (q_l, q_m, dq_l, dq_m); so is a law in Python, by differences. A plant
    in Python is replaced by the model of its robot. Raises StateError for wrong shapes, UserCodeError.
    """
    law, sensing = as_static(law), sensing or Sensing()
    plant = Plant(law.robot if plant is None else plant.robot) if plant is None or plant.in_python else plant
    if plant.robot.n != law.robot.n:
        raise StateError(f"plant and law have {plant.robot.n} and {law.robot.n} joints; expected equal")
    q_l = loop_configurations(law, configurations)
    own, real = equilibria_at(law.robot, q_l), equilibria_at(plant.robot, q_l)
    if not isinstance(law, StaticLaw) or law.in_python or not sensing.plain:
        return on_plant(controller(as_sampled(law), own, sensing), own, real, sensing)
    A, B, F = _jacobians(law, plant, real)
    A, B = in_momenta_of(own, real, A, B)
    return in_error_coordinates(own, law.gains, A, B, F) if isinstance(law, TrackingLaw) else SampledLoop(q_l, A, B, F)


def on_plant(at: At, own: Equilibria, real: Equilibria, sensing: Sensing) -> SampledLoop:
    """Return the loop of a linearised controller on the real plant; z is (q_l, q_m, dq_l, dq_m)."""
    A, B = plant_in_velocities(real)
    seen = sensing.measured(own.robot, real.robot.K)
    return SampledLoop(own.q_l, A, B, np.swapaxes(B, 1, 2), at if seen is None else lambda T: at(T).seeing(seen))


def as_static(law: StaticLaw | SampledLaw) -> StaticLaw | SampledLaw:
    """Return the static law inside a sampled law without state; any other law unchanged."""
    check_law(law)
    return law.law if isinstance(law, AsSampledLaw) and isinstance(law.law, StaticLaw) else law


def as_sampled(law: StaticLaw | SampledLaw) -> SampledLaw:
    """Return the law as a sampled law."""
    return AsSampledLaw(law) if isinstance(law, StaticLaw) else law


def without_state(law: StaticLaw | SampledLaw) -> StaticLaw | SampledLaw:
    """Return the law without robust action."""
    return getattr(law, "law", law)


def loop_configurations(law: StaticLaw | SampledLaw, configurations: ArrayLike | None) -> Array:
    """Return the given configurations, or sampled ones: fewer for a law without a closed form."""
    few = None if isinstance(without_state(law), TrackingLaw) else OTHER_LAWS
    return checked_configurations(law.robot, configurations, few)


def closed_form(law: TrackingLaw, configurations: Array, plant: Plant) -> SampledLoop:
    """Return the result of `linearize` at a fraction of its cost if the plant equals the model of the law.

    Otherwise an approximation: the Jacobian of the law is taken at the equilibrium of its own robot.
    """
    own = equilibria_at(law.robot, configurations)
    real = own if plant.robot is law.robot else equilibria_at(plant.robot, configurations)
    A, B = in_momenta_of(own, real, *plant_matrices(real))
    return in_error_coordinates(own, law.gains, A, B, feedback(own, law.gains))


def in_momenta_of(own: Equilibria, real: Equilibria, A: Array, B: Array) -> tuple[Array, Array]:
    """Return A and B of a plant in the momenta that its velocities have with the inertia of another robot."""
    one, inverses = np.eye(own.robot.n), (np.linalg.inv(real.M_l), np.linalg.inv(real.robot.M_m))
    T = own.block_diagonal(one, one, own.M_l @ inverses[0], own.robot.M_m @ inverses[1])
    return T @ A @ np.linalg.inv(T), T @ B


def in_error_coordinates(equilibria: Equilibria, gains: CheckedGains, A: Array, B: Array, F: Array) -> SampledLoop:
    """Return the loop dx/dt = A x + B u, u = F x at k equilibria in the coordinates z = P^(1/2) e."""
    S = metric_roots(equilibria, gains) @ error_matrices(equilibria, gains)
    S_inverse = np.linalg.inv(S)
    return SampledLoop(equilibria.q_l, S @ A @ S_inverse, S @ B, F @ S_inverse)


def _jacobians(law: StaticLaw, plant: Plant, equilibria: Equilibria) -> tuple[Array, Array, Array]:
    """Return A, B and F in the state x at equilibria of the plant, with the reference at rest there."""
    n = equilibria.robot.n
    plant_slope, law_slope = _plant_slope(plant), _law_slope(law)
    d_x, d_u = np.split(np.eye(5 * n), [4 * n])
    slopes = [plant_slope(x, u, d_x, d_u).full() for x, u in zip(equilibria.x, equilibria.u, strict=True)]
    F = [law_slope(x, q_l, np.eye(4 * n)).full() for x, q_l in zip(equilibria.x, equilibria.q_l, strict=True)]
    A, B = np.split(np.array(slopes), [4 * n], axis=2)
    return A, B, np.array(F)


@lru_cache(maxsize=2)
def _plant_slope(plant: Plant) -> ca.Function:
    """Build (x, u, d_x, d_u) -> derivative of dx/dt of the plant in the direction (d_x, d_u)."""
    n = plant.robot.n
    x, u, d_x, d_u = (ca.SX.sym(name, size) for name, size in (("x", 4 * n), ("u", n), ("d_x", 4 * n), ("d_u", n)))
    slope = directional(plant.dynamics(x, u), ca.vertcat(x, u), ca.vertcat(d_x, d_u))
    return ca.Function("plant_slope", [x, u, d_x, d_u], [ca.densify(slope)])


@lru_cache(maxsize=2)
def _law_slope(law: StaticLaw) -> ca.Function:
    """Build (x, q_ld, d_x) -> derivative of u(x, x, t) in the direction d_x, with the reference at rest at q_ld."""
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


def slope_at_rest(law: StaticLaw, q_l: Array) -> tuple[Array, Array]:
    """Return F (n, 4n), G (n, n): du = F d(q_l, q_m, dq_l, dq_m) + G dq_ld, links and reference at rest at q_l (n,)."""
    n, position = law.robot.n, rest_position(law.robot, q_l)
    at_rest = np.concatenate([position, np.zeros(2 * n), q_l])
    slope = _slope(law.measured_expression, ca.MX if law.in_python else ca.SX)
    found = slope(at_rest, law.gain_values, np.eye(5 * n)).full()
    law.raise_failure()
    return found[:, : 4 * n], found[:, 4 * n :]


def rest_position(robot: Robot, q_l: Array) -> Array:
    """Return (q_l, q_m) (2n,) [rad] at the equilibrium with links at q_l (n,): the springs carry the weight."""
    return np.concatenate([q_l, q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l))])


@lru_cache(maxsize=8)
def _slope(measured: ca.Function, kind: type) -> ca.Function:
    """Build (z, gains, d) -> derivative of u along d (5n,) at z = (position, velocity, q_ld), the reference at rest."""
    n = measured.size1_in("jets")
    z, gains, d = symbols(kind, z=5 * n, gains=measured.size1_in("gains"), d=5 * n).values()
    position, velocity, q_ld = ca.vertsplit(z, [0, 2 * n, 4 * n, 5 * n])
    u, _ = measured(position, velocity, ca.horzcat(q_ld, ca.DM(n, JETS - 1)), gains)
    return ca.Function("slope", [z, gains, d], [ca.densify(directional(u, z, d))], {"cse": True})


SCREENED = (0.0, 1.0)  # additional samples of delay at which the worst configurations are selected
HELD = 4  # maps that a loop keeps: a scan of delays asks for that of a whole sample again and again
TERMS = 1 / np.cumprod(np.arange(1.0, 17))  # 1 / (i + 1)! of a series whose next term is 0.5^16 / 17! = 4e-20
AT_ONCE = 32  # configurations whose matrices fit into a processor's cache


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """Plant and controller linearised at k equilibria: dz/dt = A z + B u in continuous time.

    configurations (k, n) [rad], A (k, 4n, 4n), B (k, 4n, n). F (k, n, 4n): law u = F z of a static loop, with
    z = P^(1/2) (q_tilde_l, q_tilde_m, sigma_l, sigma_m), so that V = |z|^2 / 2. with_state: controller with a state as
    a function of the sample period [s]; z is then (q_l, q_m, dq_l, dq_m) and F is not used.
    """

    configurations: Array
    A: Array
    B: Array
    F: Array
    with_state: At | None = None
    _held: dict[float, tuple[Array, Array]] = field(default_factory=dict, init=False, repr=False)

    def critical(self, sample_period: float, delay: float, most: int) -> Indices:
        """Return index 0 and the indices of the `most` largest radii at the delay [s] and at one sample more."""
        delays = (delay + samples * sample_period for samples in SCREENED)
        worst = [np.argsort(-self.radii(sample_period, late), kind="stable")[:most] for late in delays]
        return np.unique(np.concatenate([[0], *worst]))

    def radii(self, sample_period: float, delay: float = 0.0) -> Array:
        """Return the spectral radii (k,) of the loop with sample_period [s] and delay [s].

        A command computed from z(t_j) is held from t_j + delay to t_j+1 + delay. Exact for the linear loop.
        """
        loop = self.one_sample_map(sample_period, delay)
        radii = np.full(len(loop), np.inf)
        finite = np.flatnonzero(np.isfinite(loop).all(axis=(1, 2)))
        radii[finite] = np.abs(np.linalg.eigvals(loop[finite])).max(axis=1)
        return radii

    def one_sample_map(self, sample_period: float, delay: float = 0.0) -> Array:
        """Return the map (k, N, N) of (z, controller state, delayed efforts) from one sample to the next."""
        T, (whole, late) = sample_period, split(delay, sample_period)
        law = static(self.F) if self.with_state is None else self.with_state(T)
        Phi, Gamma = self.held_map((1 - late) * T)
        if not late:
            return map_of_held(Phi, {whole: Gamma}, law)
        Phi_late, Gamma_late = self.held_map(late * T)
        return map_of_held(Phi @ Phi_late, {whole: Gamma, whole + 1: Phi @ Gamma_late}, law)

    def at(self, indices: Indices) -> SampledLoop:
        """Return the loop at the selected configurations."""
        whole = self.with_state
        part = None if whole is None else lambda T: whole(T).at(indices)
        return SampledLoop(self.configurations[indices], self.A[indices], self.B[indices], self.F[indices], part)

    def held_map(self, T: float) -> tuple[Array, Array]:
        """Return Phi (k, 4n, 4n) and Gamma (k, 4n, n): z(t + T) = Phi z(t) + Gamma u with u held."""
        if T not in self._held:
            if len(self._held) == HELD:
                del self._held[next(iter(self._held))]
            Phi, Gamma = np.empty_like(self.A), np.empty_like(self.B)
            with np.errstate(over="ignore", invalid="ignore"):  # an unstable plant over a long time
                for first in range(0, len(Phi), AT_ONCE):
                    part = slice(first, first + AT_ONCE)
                    Phi[part], Gamma[part] = held_maps(self.A[part], self.B[part], T)
            self._held[T] = Phi, Gamma
        return self._held[T]


def held_maps(A: Array, B: Array, T: float) -> tuple[Array, Array]:
    """Return exp(A T) and the integral of exp(A s) from 0 to T times B, for stacks A (k, N, N) and B (k, N, n).

    Series over h = T / 2^j, in powers of (A h)^4, doubled j times: with D = exp(A h) - 1, which loses no digits for
    small h, D(2 h) = 2 D + D D and Gamma(2 h) = 2 Gamma + D Gamma. SciPy's expm takes the matrices one by one.
    """
    one, norm = np.eye(A.shape[1]), float(np.abs(A).sum(axis=2).max())
    doublings = max(0, int(np.ceil(np.log2(2 * norm * T)))) if norm * T else 0
    h = T / 2**doublings
    X = A * h
    X2 = X @ X
    X3, X4 = X2 @ X, X2 @ X2
    Psi = np.zeros_like(A)  # the integral of exp(A s) from 0 to h, over h
    for c in TERMS.reshape(-1, 4)[::-1]:
        Psi = Psi @ X4 + (c[0] * one + c[1] * X + c[2] * X2 + c[3] * X3)
    D, Gamma = X @ Psi, h * (Psi @ B)
    for _ in range(doublings):
        Gamma = Gamma + Gamma + D @ Gamma
        D = D + D + D @ D
    return one + D, Gamma


def map_of_held(Phi: Array, inputs: dict[int, Array], law: Controller) -> Array:
    """Return the map of (z, c, earlier efforts): z+ = Phi z + sum of inputs[i] u(i samples ago), u by the law."""
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


def split(delay: float, T: float) -> tuple[int, float]:
    """Split delay / T into whole samples and a fraction; a whole number up to rounding has fraction 0."""
    samples = delay / T
    whole = round(samples) if abs(samples - round(samples)) < 1e-9 else int(samples)
    return whole, max(samples - whole, 0.0)
