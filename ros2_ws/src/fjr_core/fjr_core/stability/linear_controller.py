# SPDX-License-Identifier: Apache-2.0
"""Linearise the sampled controller at equilibria: velocity observer, law and controller state in one sample.

    u  = F y + C c + S s          y: measured positions and velocities, c: controller state, s: the last effort sent
    c+ = G y + H c + J s

All are deviations from the equilibrium. The step function of the law is linearised by its Jacobian. The observer has a
closed form, because a Runge-Kutta step about an equilibrium is a polynomial of the plant matrix.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import casadi as ca
import numpy as np

from ..errors import StateError
from ..law.interfaces import ARGUMENTS, SampledLaw, StaticLaw
from ..law.linearized import Equilibria, Indices, feedback, plant_matrices, slope_at_rest
from ..law.vdpbc import TrackingLaw
from ..model.robot import Robot
from ..motions.point_to_point import standing
from ..numerics.checks import Array, positive
from ..runtime.velocity_observer import LONGEST_CALL, corrections, steps_of

DIRECTIONS = 16  # columns of a Jacobian per evaluation
MOST_SAMPLES = 64  # until the controller state is stationary at an equilibrium: more than any delay has


@dataclass(frozen=True, eq=False)
class Controller:
    """Matrices at k equilibria: F (k, n, 4n), C (k, n, m), S (k, n, n), G (k, m, 4n), H (k, m, m), J (k, m, n)."""

    F: Array
    C: Array
    S: Array
    G: Array
    H: Array
    J: Array

    @property
    def states(self) -> int:
        """Return m, the size of the controller state."""
        return int(self.H.shape[1])

    def seeing(self, measured: Array) -> Controller:
        """Return the controller whose measurement is `measured` (4n, 4n), or (k, 4n, 4n), times y."""
        return replace(self, F=self.F @ measured, G=self.G @ measured)

    def at(self, indices: Indices) -> Controller:
        """Return the controller at the selected equilibria."""
        return replace(self, **{name: getattr(self, name)[indices] for name in "FCSGHJ"})


At = Callable[[float], Controller]
"""Return the controller at a sample period [s]."""


@dataclass(frozen=True, eq=False)
class Sensing:
    """Measurements of the law.

    bandwidth [rad/s]: of the velocity observer; None: velocities are measured. by_torque: motor positions are computed
    from joint torque sensors, q_m = q_l + K^-1 tau with the K of the law. Raises StateError for another bandwidth.
    """

    bandwidth: float | None = None
    by_torque: bool = False

    def __post_init__(self) -> None:
        if self.bandwidth is not None:
            object.__setattr__(self, "bandwidth", positive("bandwidth", self.bandwidth, StateError, "rad/s"))

    @property
    def plain(self) -> bool:
        """Return whether the law measures the state of the plant directly."""
        return self.bandwidth is None and not self.by_torque

    def measured(self, own: Robot, K: Array) -> Array | None:
        """Return the map (4n, 4n) from the state of a plant with stiffness K to the measurement; None: identity.

        A stack of stiffnesses (k, n, n) gives a stack of maps.
        """
        if not self.by_torque:
            return None
        n, ratio = own.n, np.linalg.solve(own.K, K)
        seen = np.zeros((*K.shape[:-2], 4 * n, 4 * n)) + np.eye(4 * n)
        seen[..., n : 2 * n, :n], seen[..., n : 2 * n, n : 2 * n] = np.eye(n) - ratio, ratio
        return seen


def static(F: Array) -> At:
    """Return a controller without state, u = F y, the same at every sample period."""
    k, n, N = F.shape
    empty = np.zeros((k, n, 0))
    law = Controller(F, empty, np.zeros((k, n, n)), np.zeros((k, 0, N)), np.zeros((k, 0, 0)), np.zeros((k, 0, n)))
    return lambda _period: law


def controller(law: SampledLaw, equilibria: Equilibria, sensing: Sensing) -> At:
    """Return the controller of a law, linearised at equilibria of its own robot with the reference at rest there."""
    if isinstance(law, TrackingLaw):
        alone = static(feedback(equilibria, law.gains) @ momentum_matrix(equilibria))
    elif isinstance(law, StaticLaw):
        alone = static(np.array([slope_at_rest(law, q)[0] for q in equilibria.q_l]))
    else:
        alone = None

    @lru_cache(maxsize=2)
    def at(T: float) -> Controller:
        measuring = _linearised(law, equilibria, T) if alone is None else alone(T)
        return measuring if sensing.bandwidth is None else _behind_observer(measuring, equilibria, sensing.bandwidth, T)

    return at


def momentum_matrix(equilibria: Equilibria) -> Array:
    """Return T (k, 4n, 4n) with dx = T dy at equilibria: from velocities to momenta."""
    one = np.eye(equilibria.robot.n)
    return equilibria.block_diagonal(one, one, equilibria.M_l, equilibria.robot.M_m)


def plant_in_velocities(equilibria: Equilibria) -> tuple[Array, Array]:
    """Return A (k, 4n, 4n) and B (k, 4n, n) of a robot at its equilibria, in y = (q_l, q_m, dq_l, dq_m)."""
    A, B = plant_matrices(equilibria)
    T = momentum_matrix(equilibria)
    return np.asarray(np.linalg.solve(T, A @ T)), np.asarray(np.linalg.solve(T, B))


def _linearised(law: SampledLaw, equilibria: Equilibria, T: float) -> Controller:
    """Linearise the step function of a law at each equilibrium for the sample period T [s]."""
    n, m = equilibria.robot.n, len(law.memory)
    step, gains, blocks = law.step_function, law.gain_values, []
    for x, u in zip(equilibria.x, equilibria.u, strict=True):
        measured = x[: 2 * n], np.zeros(2 * n), standing(x[:n]).T, gains
        at = [*measured, *_at_rest(step, measured, law.memory, u, T), T]
        blocks.append(np.split(_jacobian(step, at), [n]))
    law.raise_failure()
    of_u, of_next = (np.array(rows) for rows in zip(*blocks, strict=True))
    parts = [np.split(rows, [4 * n, 4 * n + m], axis=2) for rows in (of_u, of_next)]
    return _without_constant_states(Controller(*parts[0], *parts[1]))


def _without_constant_states(law: Controller) -> Controller:
    """Remove states that no other signal changes, such as an integral of gain 0: they stay constant."""
    while law.states:
        others = law.H * (1 - np.eye(law.states))
        moves = np.concatenate([law.G, law.J, others], axis=2).any(axis=(0, 2))
        if moves.all():
            break
        law = Controller(
            law.F, law.C[:, :, moves], law.S, law.G[:, moves], law.H[:, moves][:, :, moves], law.J[:, moves]
        )
    return law


def _at_rest(step: ca.Function, measured: Sequence[Array], state: Array, u: Array, T: float) -> tuple[Array, Array]:
    """Return the stationary controller state (m,) and effort (n,), from a first state and the effort of the model.

    The effort of the law differs from that by rounding, which integral action takes for a saturation.
    """
    for k in range(MOST_SAMPLES if len(state) else 0):
        before = state
        effort, _, after = step(*measured, state, u, T if k else 0.0)
        state, u = after.full().ravel(), effort.full().ravel()
        if k > 1 and np.allclose(state, before, rtol=1e-12, atol=1e-12):
            break
    return state, u


def _jacobian(step: ca.Function, at: list[Array]) -> Array:
    """Return the Jacobian (n + m, 5 n + m) of (u, next) in (position, velocity, memory, sent)."""
    slope = _slope(step)
    total = slope.size1_in("along")
    found = slope(*at, np.eye(total, -(-total // DIRECTIONS) * DIRECTIONS)).full()
    return np.asarray(found[:, :total])


@lru_cache(maxsize=4)
def _slope(step: ca.Function) -> ca.Function:
    """Build (arguments of the step, along (5 n + m, DIRECTIONS)) -> derivatives of (u, next) along these columns."""
    s = dict(zip(ARGUMENTS, step.mx_in(), strict=True))
    moved = ca.vertcat(*(s[name] for name in ("position", "velocity", "memory", "sent")))
    u, _, after = step(*s.values())
    along = ca.MX.sym("along", moved.numel(), DIRECTIONS)
    derivatives = ca.densify(ca.jtimes(ca.vertcat(u, after), moved, along))
    return ca.Function("slope", [*s.values(), along], [derivatives], [*s, "along"], ["derivatives"])


def _behind_observer(law: Controller, equilibria: Equilibria, bandwidth: float, T: float) -> Controller:
    """Return the law with the estimate of the observer as measurement and as part of the controller state.

    Equations: see runtime.velocity_observer.
    """
    n = equilibria.robot.n
    g, h = corrections(bandwidth, T)
    correct = np.vstack([g * np.eye(2 * n), h / T * np.eye(2 * n)])
    Phi, Gamma = _predicted(equilibria, T)
    X, U = Phi - correct @ Phi[:, : 2 * n], Gamma - correct @ Gamma[:, : 2 * n]
    Y = np.broadcast_to(np.hstack([correct, np.zeros((4 * n, 2 * n))]), Phi.shape)
    stacked = [np.concatenate([a, b], axis=1) for a, b in ((law.G @ Y, Y), (law.J + law.G @ U, U))]
    none = np.zeros((len(Phi), 4 * n, law.states))
    H = np.concatenate([np.concatenate([law.H, law.G @ X], axis=2), np.concatenate([none, X], axis=2)], axis=1)
    return Controller(
        law.F @ Y, np.concatenate([law.C, law.F @ X], axis=2), law.S + law.F @ U, stacked[0], H, stacked[1]
    )


def _predicted(equilibria: Equilibria, T: float) -> tuple[Array, Array]:
    """Return Phi (k, 4n, 4n) and Gamma (k, 4n, n) of the observer's Runge-Kutta prediction over T [s], effort held."""
    n = equilibria.robot.n
    A, B = plant_in_velocities(equilibria)
    steps = math.ceil(T / LONGEST_CALL) * steps_of(equilibria.robot)
    whole = np.zeros((len(A), 5 * n, 5 * n))
    whole[:, : 4 * n, : 4 * n], whole[:, : 4 * n, 4 * n :] = A * (T / steps), B * (T / steps)
    step = one = np.eye(5 * n)
    for i in (4, 3, 2, 1):
        step = one + whole @ step / i
    over = np.linalg.matrix_power(step, steps)
    return over[:, : 4 * n, : 4 * n], over[:, : 4 * n, 4 * n :]
