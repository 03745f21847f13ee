# SPDX-License-Identifier: Apache-2.0
"""Demonstrate Theorem 2: solutions of the virtual system along one measured trajectory converge to each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import StateError
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.motions.reference import JETS, Reference
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_core.numerics.integrators import INNER_STEP, rk4_expression

from .prolonged_system import ProlongedSystem

VISITED = 200  # configurations of a trajectory at which an unproven rate is evaluated


@dataclass(frozen=True)
class Measured:
    """Measured trajectory at k samples: t (k,) [s], x (k, 4n) with the momenta of the law's robot, u (k, n) [N m] held.

    Between samples x follows the model under the held u. Raises StateError for wrong shapes.
    """

    t: Array
    x: Array
    u: Array

    def __post_init__(self) -> None:
        k, n = len(self.t), self.u.shape[-1]
        if k < 2 or self.x.shape != (k, 4 * n) or self.u.shape != (k, n) or not np.all(np.diff(self.t) > 0):
            raise StateError(
                f"t, x and u have shapes {self.t.shape}, {self.x.shape}, {self.u.shape}; expected (k,), (k, 4n) and "
                "(k, n) with at least two increasing instants"
            )


@dataclass(frozen=True)
class Contraction:
    """m virtual trajectories at k instants, and the variations along them.

    t (k,) [s]; x_v (k, m, 4n); distance (k, m (m - 1) / 2) [sqrt J] of each pair in the metric P; to_measured (k, m)
    [sqrt J]: distance to x(t); W (k, m) [J], dW (k, m) [W]: differential storage and its exact rate; beta [1/s]: rate,
    proven or else evaluated at configurations of the trajectory.
    """

    t: Array
    x_v: Array
    distance: Array
    to_measured: Array
    W: Array
    dW: Array
    beta: float
    proven: bool

    @property
    def bound(self) -> Array:
        """Upper bound exp(-beta t) (k,) of every distance relative to its initial value."""
        return np.exp(-self.beta * (self.t - self.t[0]))

    @property
    def rate(self) -> Array:
        """Exact contraction rate -dW / (2 W) (k, m) [1/s] along each variation; at least beta."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.W > 0, -self.dW / (2 * self.W), np.nan)

    @property
    def balance(self) -> float:
        """Largest |W(t) - W(0) - integral of dW| / W(0): the integration error, near 0."""
        steps = np.diff(self.t)[:, None] * (self.dW[1:] + self.dW[:-1]) / 2
        return float(np.max(np.abs(self.W[1:] - self.W[0] - np.cumsum(steps, axis=0)) / self.W[0]))


def scattered(law: TrackingLaw, x: ArrayLike, m: int, spread: float, seed: int = 0) -> Array:
    """Return m random virtual states (m, 4n) around x (4n,).

    Links differ by up to `spread` [rad]; the springs carry the weight; velocities are up to `spread` per 0.1 s.
    """
    robot, rng = law.robot, np.random.default_rng(seed)
    q_l = checks.vector("x", x, 4 * robot.n, StateError)[: robot.n]
    links = q_l + spread * rng.uniform(-1, 1, (m, robot.n))
    motors = [q + np.linalg.solve(robot.K, robot.grad_P_l(q)) for q in links]
    speeds = 10 * spread * rng.uniform(-1, 1, (2, m, robot.n))
    return np.array([robot.state(*sides) for sides in zip(links, motors, *speeds, strict=True)])


def contraction(
    law: TrackingLaw,
    reference: Reference,
    measured: Measured,
    starts: Array,
    compile: bool = False,
    inner_step: float = INNER_STEP,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Contraction:
    """Run the virtual closed loop from the states `starts` (m, 4n) along a measured trajectory.

    The initial variation of each start points from the measured state to it. inner_step [s]: longest Runge-Kutta step.
    compile: use machine code. on_progress: called with the simulated time [s] after each sample. Raises StateError for
    wrong shapes and for numbers that are not finite.
    """
    n = law.robot.n
    if starts.ndim != 2 or starts.shape[1] != 4 * n or len(starts) < 2:
        raise StateError(f"starts have shape {starts.shape}; expected (m, {4 * n}), m at least 2")
    system = ProlongedSystem(law, compile)
    columns = _integrated(system, reference, measured, starts, inner_step, on_progress)
    jets = reference.jets(measured.t)
    x_v, delta = columns[:, :, : 4 * n], columns[:, :, 4 * n :]
    distance, to_measured = _distances(system, measured.x, x_v, jets)
    storage = np.array(
        [
            [system.storage(a, x, b, now) for a, b in zip(row, variations, strict=True)]
            for row, variations, x, now in zip(x_v, delta, measured.x, jets, strict=True)
        ]
    )
    rate = law.rate()
    if not rate.proven:
        rate = law.rate(measured.x[:: max(1, len(measured.x) // VISITED), :n])
    return Contraction(measured.t, x_v, distance, to_measured, storage[..., 0], storage[..., 1], rate.beta, rate.proven)


def _integrated(
    system: ProlongedSystem,
    reference: Reference,
    measured: Measured,
    starts: Array,
    inner_step: float,
    on_progress: Callable[[float], None],
) -> Array:
    """Return virtual states and variations (k, m, 8n)."""
    longest = float(np.max(np.diff(measured.t)))
    steps = int(np.ceil(longest / inner_step - 1e-9))
    step = _step(system, len(starts))
    columns = np.empty((len(measured.t), len(starts), 2 * starts.shape[1]))
    columns[0] = np.hstack([starts, starts - measured.x[0]])
    for k, (t, end) in enumerate(zip(measured.t[:-1], measured.t[1:], strict=True)):
        dt, x, z = (end - t) / steps, measured.x[k], columns[k].T
        jets = reference.jets(t + dt / 2 * np.arange(2 * steps + 1))
        for i in range(steps):
            x, z = step(x, z, measured.u[k], *(jet.T for jet in jets[2 * i : 2 * i + 3]), dt)
        columns[k + 1] = np.asarray(z).T
        if not np.isfinite(columns[k + 1]).all():
            raise StateError(f"the virtual system is not finite at t = {end:.6g} s; expected a shorter inner step")
        on_progress(end - measured.t[0])
    return columns


def _step(system: ProlongedSystem, m: int) -> ca.Function:
    """Build one Runge-Kutta step of x under a held u and of m columns (x_v, delta) along it: (x, z, u, jets.., dt)."""
    n, plant = system.law.robot.n, Plant(system.law.robot)
    x, z, u, dt = ca.MX.sym("x", 4 * n), ca.MX.sym("z", 8 * n, m), ca.MX.sym("u", n), ca.MX.sym("dt")
    jets = [ca.MX.sym(name, n, JETS) for name in ("start", "middle", "end")]
    field = system.function.map(m)

    def f(state: ca.MX, now: ca.MX) -> ca.MX:
        x, z = state[: 4 * n], ca.reshape(state[4 * n :], 8 * n, m)
        dx_v, d_delta = field(z[: 4 * n, :], x, z[4 * n :, :], now)
        return ca.vertcat(plant.dynamics(x, u), ca.vec(ca.vertcat(dx_v, d_delta)))

    after = rk4_expression(f, ca.vertcat(x, ca.vec(z)), tuple(jets), dt)
    outputs = [after[: 4 * n], ca.reshape(after[4 * n :], 8 * n, m)]
    return ca.Function("contraction_step", [x, z, u, *jets, dt], outputs)


def _distances(system: ProlongedSystem, x: Array, x_v: Array, jets: Array) -> tuple[Array, Array]:
    """Return the distances of all pairs (k, pairs) and those to the measured state (k, m)."""
    pairs = list(combinations(range(x_v.shape[1]), 2))
    between, from_x = np.empty((len(x), len(pairs))), np.empty(x_v.shape[:2])
    for k, (state, row, now) in enumerate(zip(x, x_v, jets, strict=True)):
        errors = np.array([system.errors(y, state, now) for y in (state, *row)])
        y = system.in_metric(errors, state)
        from_x[k] = np.linalg.norm(y[1:] - y[0], axis=1)
        between[k] = [np.linalg.norm(y[1 + i] - y[1 + j]) for i, j in pairs]
    return between, from_x
