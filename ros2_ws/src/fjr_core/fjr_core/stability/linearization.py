# SPDX-License-Identifier: Apache-2.0
"""Linearise plant and law at equilibria, and form the one-sample map of the loop under hold and delay."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainsError, StateError
from ..law.gains import CheckedGains
from ..law.interfaces import SampledLaw, StaticLaw, check_law
from ..law.linearized import Equilibria, Indices, equilibria_at, error_matrices, feedback, metric_roots, slope_at_rest
from ..law.vdpbc import TrackingLaw
from ..model.configuration_sampling import checked_configurations, sample_configurations
from ..model.port_hamiltonian import Plant
from ..numerics.checks import Array, positive
from ..numerics.one_line import at_least
from ..robust.law import sampled_law
from ..robust.options import Robust
from .linear_controller import At, Controller, Sensing, controller, momentum_matrix, plant_in_velocities, static

OTHER_LAWS = 64  # configurations at which a law without a closed form is checked
INTEGRAL_GAINS = ("integral_gain", "motor_integral_gain")
FEW_FOR_INTEGRAL = 3  # sampled configurations at which the loop with integral action is evaluated
BISECTIONS = 10  # of the logarithm of the factor on the integral gains, between LEAST_FACTOR and 1
LEAST_FACTOR = 1e-4  # on the integral gains


def linearize(
    law: SampledLaw, configurations: ArrayLike | None = None, plant: Plant | None = None, sensing: Sensing | None = None
) -> SampledLoop:
    """Linearise the closed loop of a law and its own robot, or another plant, at configurations (k, n) [rad].

    The links of the plant and the reference are at rest at the configuration; the steady-state error of another plant
    is neglected. z contains the errors of v-dPBC; for another law z = (q_l, q_m, dq_l, dq_m). A law with a controller
    state or with sensing (observer, torque sensors) is linearised at the equilibrium of its own robot. A plant in
    Python is replaced by the model of its robot. Raises StateError for wrong shapes, UserCodeError.
    """
    check_law(law)
    robot, sensing = law.robot if plant is None else plant.robot, sensing or Sensing()
    if robot.n != law.robot.n:
        raise StateError(f"plant and law have {robot.n} and {law.robot.n} joints; expected equal")
    q_l = loop_configurations(law, configurations)
    own, real = equilibria_at(law.robot, q_l), equilibria_at(robot, q_l)
    if not isinstance(law, StaticLaw) or not sensing.plain:
        return on_plant(controller(law, own, sensing), own, real, sensing)
    F = np.array([slope_at_rest(law, q, robot)[0] for q in q_l])
    if isinstance(law, TrackingLaw):
        return _in_error_coordinates(own, law.gains, real, F)
    return SampledLoop(q_l, *plant_in_velocities(real), static(F))


def closed_form(own: Equilibria, gains: CheckedGains, real: Equilibria | None = None) -> SampledLoop:
    """Return the result of `linearize` for v-dPBC at a fraction of its cost; exact if the plant is the law's model.

    own, real: equilibria of the model and of the plant, None: the same. With another plant this is an approximation:
    the Jacobian of the law is taken at the equilibrium of its own robot.
    """
    return _in_error_coordinates(own, gains, real or own, feedback(own, gains) @ momentum_matrix(own))


def _in_error_coordinates(own: Equilibria, gains: CheckedGains, real: Equilibria, F: Array) -> SampledLoop:
    """Return the loop of a plant and u = F (q_l, q_m, dq_l, dq_m) in the coordinates z = P^(1/2) e of the law."""
    A, B = plant_in_velocities(real)
    S = metric_roots(own, gains) @ error_matrices(own, gains) @ momentum_matrix(own)
    S_inverse = np.linalg.inv(S)
    return SampledLoop(own.q_l, S @ A @ S_inverse, S @ B, static(F @ S_inverse))


def on_plant(at: At, own: Equilibria, real: Equilibria, sensing: Sensing) -> SampledLoop:
    """Return the loop of a linearised controller on the real plant; z is (q_l, q_m, dq_l, dq_m)."""
    A, B = plant_in_velocities(real)
    seen = sensing.measured(own.robot, real.K)
    return SampledLoop(own.q_l, A, B, at if seen is None else lambda T: at(T).seeing(seen))


def loop_configurations(law: SampledLaw, configurations: ArrayLike | None) -> Array:
    """Return the given configurations, or sampled ones: fewer for a law without a closed form."""
    few = None if isinstance(law.static, TrackingLaw) else OTHER_LAWS
    return checked_configurations(law.robot, configurations, few)


SCREENED = (0.0, 1.0)  # additional samples of delay at which the worst configurations are selected
HELD = 4  # maps that a loop keeps: a scan of delays asks for that of a whole sample again and again
TERMS = 1 / np.cumprod(np.arange(1.0, 17))  # 1 / (i + 1)! of a series whose next term is 0.5^16 / 17! = 4e-20
AT_ONCE = 32  # configurations whose matrices fit into a processor's cache


@dataclass(frozen=True, eq=False)
class SampledLoop:
    """Plant and controller linearised at k equilibria: dz/dt = A z + B u in continuous time.

    configurations (k, n) [rad], A (k, 4n, 4n), B (k, 4n, n). law: of the sample period [s].
    z is (q_l, q_m, dq_l, dq_m), for v-dPBC alone P^(1/2) (q_tilde_l, q_tilde_m, sigma_l, sigma_m): V = |z|^2 / 2.
    """

    configurations: Array
    A: Array
    B: Array
    law: At
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
        T, (whole, late), law = sample_period, split(delay, sample_period), self.law(sample_period)
        Phi, Gamma = self.held_map((1 - late) * T)
        if not late:
            return map_of_held(Phi, {whole: Gamma}, law)
        Phi_late, Gamma_late = self.held_map(late * T)
        return map_of_held(Phi @ Phi_late, {whole: Gamma, whole + 1: Phi @ Gamma_late}, law)

    def at(self, indices: Indices) -> SampledLoop:
        """Return the loop at the selected configurations."""
        whole = self.law
        parts = self.configurations[indices], self.A[indices], self.B[indices]
        return SampledLoop(*parts, lambda T: whole(T).at(indices))

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
    past = max(*inputs, int(law.S.any() or law.J.any()))
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


def spectral_radius(
    law: SampledLaw,
    sample_period: float,
    delay: float = 0.0,
    configurations: ArrayLike | None = None,
    plant: Plant | None = None,
    sensing: Sensing | None = None,
) -> Array:
    """Return the spectral radii (k,) of the sampled loop at configurations (k, n); below 1: stable."""
    times = checked_times(sample_period, delay)
    return linearize(law, configurations, plant, sensing).radii(*times)


def checked_times(sample_period: float, delay: float) -> tuple[float, float]:
    """Return sample period and delay [s]; raise StateError unless the first is positive and the other not negative."""
    return positive("sample_period", sample_period, StateError), positive("delay", delay, StateError, zero=True)


def refuse_fast_integral(law: StaticLaw, robust: Robust) -> None:
    """Raise GainsError if integral action makes an otherwise stable loop unstable at sample period robust.hold [s].

    The loop consists of the law and its own robot, linearised at a few equilibria, with the delay robust.delay [s].
    """
    if not robust.integrates:
        return
    configurations = sample_configurations(law.robot, FEW_FOR_INTEGRAL)

    def stable(factor: float) -> bool:
        rates = {name: factor * np.asarray(getattr(robust, name)) for name in INTEGRAL_GAINS}
        sampled = sampled_law(law, replace(robust, **rates))  # type: ignore[arg-type]
        return bool(spectral_radius(sampled, robust.hold, robust.delay, configurations).max() < 1)

    if stable(1.0) or not stable(0.0):
        return
    low, high = LEAST_FACTOR, 1.0
    for _ in range(BISECTIONS):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if stable(middle) else (low, middle)
    gains = {name: np.asarray(getattr(robust, name)) for name in INTEGRAL_GAINS if np.any(getattr(robust, name))}
    given = ", ".join(f"{name} is {gain.tolist()}" for name, gain in gains.items())
    most = " and ".join(f"[{', '.join(at_least(low * rate, 3) for rate in gain)}]" for gain in gains.values())
    raise GainsError(
        f"{given} 1/s, which makes the loop unstable at a hold of {robust.hold:g} s; expected at most {most} 1/s"
    )
