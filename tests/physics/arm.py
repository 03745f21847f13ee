# SPDX-License-Identifier: Apache-2.0
"""A planar chain with elastic joints that shares no code with the product: Lagrange's equations, NumPy alone.

    T' (A_ij cos(theta_i - theta_j) + I) T a_l + T' (A_ij sin(theta_i - theta_j) w_j^2 + g S sin(theta + tilt))
        = tau - D_l v_l - F_l - cable,      B a_m = u - tau_m - D_m v_m - F_m

theta = T q_l are the angles of the links from the vertical, hanging at 0; r_ki is the arm of body k about joint i, in
the direction of link i: A_ij = sum_k m_k r_ki r_kj, S_i = sum_k m_k r_ki. Every array has a row per draw: a batch of
draws is integrated at once, each with steps of its own, by the Rosenbrock method RODAS of order 4(3) (E. Hairer, G.
Wanner, Solving Ordinary Differential Equations II, sec. IV.10), which steep friction does not make unstable.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline

from .laws import Friction, Spring, coulomb, linear

Array, Indices = NDArray[np.float64], NDArray[np.intp]
G = 9.81  # m/s^2
Others = Callable[..., tuple[Array | float, Array | float]]
"""Torques [N m] on links and motors by (arm, q_l, q_m, v_l, v_m, torques of the motors, time [s])."""


@dataclass(frozen=True, eq=False)
class Arm:
    """Draws of an arm, (d, n) each: links, springs, rotors and friction of each side, in SI units.

    offset: of q_m - q_l without spring torque. friction, spring: their laws (`laws`). tip_mass (d,): at the end of the
    last link. tilt (d,) [rad]: of the base. cable (d, n) [N m]: amplitude of a torque -cable sin(q_l) on each link.
    lag [s]: first order, from efforts to torques. others: further torques on links and motors.
    """

    mass: Array
    com: Array
    length: Array
    inertia: Array
    stiffness: Array
    motor_inertia: Array
    link_damping: Array
    motor_damping: Array
    link_friction: Array
    motor_friction: Array
    offset: Array
    friction: Friction = field(default_factory=lambda: coulomb(0.01))
    spring: Spring = field(default_factory=linear)
    tip_mass: Array = field(default_factory=lambda: np.zeros(1))
    tilt: Array = field(default_factory=lambda: np.zeros(1))
    cable: Array = field(default_factory=lambda: np.zeros((1, 1)))
    lag: float = 0.0
    others: Others | None = None

    @property
    def rows(self) -> int:
        """Return the rows of the state: q_l, q_m, v_l, v_m, if needed w_l, w_m, w_spring of laws, torque, time."""
        return 9 if self.lag or self.others else 7 if self.friction.has_state or self.spring.has_state else 4

    @cached_property
    def arms(self) -> tuple[Array, Array, Array, Array]:
        """Return A (d, n, n) [kg m^2], S (d, n) [kg m], I (d, n, n) [kg m^2] and T' (n, n), which sums outwards."""
        d, n = self.mass.shape
        reach = np.zeros((d, n + 1, n))  # of body k about joint i; the last body is the tip mass
        for k in range(n):
            reach[:, k + 1 :, k] = self.length[:, k : k + 1]
            reach[:, k, k] = self.com[:, k]
        mass = np.hstack([self.mass, np.broadcast_to(self.tip_mass, d)[:, None]])
        A, S = np.einsum("dk,dki,dkj->dij", mass, reach, reach), np.einsum("dk,dki->di", mass, reach)
        return A, S, self.inertia[..., None] * np.eye(n), np.triu(np.ones((n, n)))

    def link_inertia(self, q_l: Array) -> Array:
        """Return the inertia (..., d, n, n) of the links in joint coordinates."""
        A, _, inertia, T_t = self.arms
        theta = q_l @ T_t
        return T_t @ (A * np.cos(theta[..., :, None] - theta[..., None, :]) + inertia) @ T_t.T

    def link_torque(self, q_l: Array, v_l: Array) -> Array:
        """Return the torque (..., d, n) of weight and velocities in joint coordinates."""
        A, S, _, T_t = self.arms
        theta, w = q_l @ T_t, v_l @ T_t
        turning = (A * np.sin(theta[..., :, None] - theta[..., None, :])) @ (w**2)[..., None]
        return (turning[..., 0] + G * S * np.sin(theta + self.tilt[:, None])) @ T_t.T

    def rates(self, x: Array, u: Array) -> Array:
        """Return dx/dt (..., d, rows, n) of states x of the same shape under efforts u (d, n)."""
        q_l, q_m, v_l, v_m = (x[..., i, :] for i in range(4))
        w_l, w_m, w_s = (x[..., i, :] for i in (4, 5, 6)) if self.rows > 4 else (np.zeros_like(q_l),) * 3
        u, du = (x[..., 7, :], (u - x[..., 7, :]) / self.lag) if self.lag else (u, 0 * q_l)
        tau, tau_m, dw_s = self.spring.law(self.stiffness, q_l, q_m - self.offset, v_l, v_m, w_s)
        F_l, dw_l = self.friction.law(v_l, self.link_friction, w_l, tau)
        F_m, dw_m = self.friction.law(v_m, self.motor_friction, w_m, tau)
        on_links = tau - self.link_damping * v_l - F_l - self.cable * np.sin(q_l) - self.link_torque(q_l, v_l)
        on_motors = u - tau_m - self.motor_damping * v_m - F_m
        if self.others:
            more = self.others(self, q_l, q_m, v_l, v_m, u, x[..., 8, :])
            on_links, on_motors = on_links + more[0], on_motors + more[1]
        a_l = np.linalg.solve(self.link_inertia(q_l), on_links[..., None])[..., 0]
        a_m = on_motors / self.motor_inertia
        rates = np.empty_like(x)
        for i, row in enumerate((v_l, v_m, a_l, a_m, dw_l, dw_m, dw_s, du, 1 + 0 * q_l)[: self.rows]):
            rates[..., i, :] = row
        return rates

    def energy(self, x: Array) -> Array:
        """Return kinetic energy, that of the weight and of linear springs (..., d) [J]."""
        q_l, q_m, v_l, v_m = (x[..., i, :] for i in range(4))
        kinetic = np.einsum("...i,...ij,...j->...", v_l, self.link_inertia(q_l), v_l) + np.sum(
            self.motor_inertia * v_m**2, -1
        )
        weight = -np.sum(G * self.arms[1] * np.cos(np.cumsum(q_l, axis=-1) + self.tilt[:, None]), axis=-1)
        return kinetic / 2 + weight + np.sum(self.stiffness * (q_m - q_l - self.offset) ** 2, axis=-1) / 2


GAMMA = 0.25
STAGES = (
    ((), ()),
    ((1.544,), (-5.6688,)),
    ((0.9466785280815826, 0.2557011698983284), (-2.430093356833875, -0.2063599157091915)),
    (
        (3.314825187068521, 2.896124015972201, 0.9986419139977817),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
    ),
    (
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
    ),
    (
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
        (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
    ),
)
"""Coefficients a and c of each stage of RODAS; the last stage is the estimate of the error."""
TOLERANCE = np.array([1e-9, 1e-9, 1e-7, 1e-7, 1e-7, 1e-7, 1e-5, 1e-6, 1e-6])  # of a step, by row of the state
DIFFERENCE = np.array([1e-7, 1e-7, 1e-9, 1e-9, 1e-9, 1e-9, 1e-6, 1e-6, 1e-6])
SMALLEST = 1e-7  # s


def rodas(arm: Arm, x: Array, u: Array, h: Array) -> tuple[Array, Array]:
    """Return x (d, rows, n) after steps h (d,) [s] under efforts u (d, n), and errors (d,) in units of TOLERANCE."""
    d, rows, n = x.shape
    size = rows * n
    delta = np.repeat(DIFFERENCE[:rows], n)
    moved = x + (np.diag(delta)).reshape(size, 1, rows, n)
    f = arm.rates(np.concatenate([x[None], moved]), u).reshape(size + 1, d, size)
    J = np.moveaxis((f[1:] - f[0]) / delta[:, None, None], 0, -1)
    inverse = np.linalg.inv(np.eye(size) / (GAMMA * h[:, None, None]) - J)
    y, slopes, K = x.reshape(d, size), f[0], np.empty((len(STAGES), d * size))
    for i, (a, c) in enumerate(STAGES):
        if i:
            at = y + np.dot(a, K[:i]).reshape(d, size)
            slopes = arm.rates(at.reshape(d, rows, n), u).reshape(d, size)
        right = slopes + np.dot(c, K[:i]).reshape(d, size) / h[:, None]
        K[i] = (inverse @ right[..., None]).ravel()
    error = np.max(np.abs(K[-1].reshape(d, rows, n)) / TOLERANCE[:rows, None], axis=(1, 2))
    return (at + K[-1].reshape(d, size)).reshape(d, rows, n), error


@dataclass(frozen=True, eq=False)
class Motion:
    """States x (k + 1, d, rows, n) at times t (k + 1, d) [s], between which the efforts u (k, d, n) were held."""

    t: Array
    x: Array
    u: Array

    def position(self, side: int, t: Array) -> Array:
        """Return q_l (side 0) or q_m (1), (m, d, n) at times t (m, d), by cubic Hermite interpolation."""
        draws = ((of, self.x[:, i, side], self.x[:, i, side + 2]) for i, of in enumerate(self.t.T))
        return np.stack([CubicHermiteSpline(*of)(at) for of, at in zip(draws, t.T, strict=True)], axis=1)


def simulated(arm: Arm, x: Array, t: Array, control: Callable[[Indices, Indices, Array], Array]) -> Motion:
    """Return the motion from x (d, rows, n) over the times t (k + 1, d), at which the efforts change.

    control(k, i, x): efforts (m, n) of draws i (m,) in states x (m, rows, n) from t[k] on, k (m,). Draws advance
    independently: each has its own step and interval.
    """
    last, d, n = len(t) - 1, x.shape[0], x.shape[2]
    X, U = np.empty((last + 1, *x.shape)), np.empty((last, d, n))
    X[0] = x
    k, now, h = np.zeros(d, dtype=int), t[0].copy(), np.full(d, 1e-4)
    every, finished = np.arange(d), np.zeros(d, dtype=bool)
    U[0] = control(k, every, x)
    while not finished.all():
        at = np.minimum(k, last - 1)
        left = np.maximum(t[at + 1, every] - now, SMALLEST)
        step = np.minimum(h, left)
        trial, error = rodas(arm, x, U[at, every], step)
        good = ((error < 1) | (step <= SMALLEST)) & ~finished
        x = np.where(good[:, None, None], trial, x)
        now = np.where(good, now + step, now)
        grown = step * np.clip(0.85 * np.maximum(error, 1e-8) ** -0.25, 0.2, 4.0)
        h = np.maximum(np.where(good & (step < h) & (grown > step), np.maximum(h, grown), grown), SMALLEST)
        ends = np.flatnonzero(good & (step >= left))
        k[ends] += 1
        now[ends], X[k[ends], ends] = t[k[ends], ends], x[ends]
        finished = k >= last
        going = ends[~finished[ends]]
        U[k[going], going] = control(k[going], going, x[going])

    return Motion(t, X, U)
