# SPDX-License-Identifier: Apache-2.0
"""Robots, gains and random points that the tests run on.

Every robot comes with its matrices and a hand-written closed form for floats and mpmath numbers, so that reference
values are never computed by fjr_core.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import fjr_core as fjr

Array = NDArray[Any]


class SingleLink:
    """The paper's joint (Table 1): constant M_l, P_l = load (1 - cos q)."""

    n = 1

    def __init__(self, inertia: float = 0.031, load: float = 0.8) -> None:
        self.inertia, self.load = inertia, load

    def M(self, q: Array, f: Any = np) -> Array:
        return np.array([[self.inertia]])

    def C(self, q: Array, v: Array, f: Any = np) -> Array:
        return np.array([[0.0]])

    def P(self, q: Array, f: Any = np) -> Any:
        return self.load * (1 - f.cos(q[0]))

    def grad_P(self, q: Array, f: Any = np) -> Array:
        return np.array([self.load * f.sin(q[0])])


class PlanarTwoLink:
    """Two links in a vertical plane, relative angles, hanging at q = 0."""

    n = 2

    def __init__(self, m: Any, l1: float, c: Any, inertia: Any, g: float = 9.81) -> None:
        """Set masses, length of the first link, centres of mass and the inertias about them."""
        (m1, m2), (c1, c2), (I1, I2) = m, c, inertia
        self.M22 = I2 + m2 * c2**2
        self.M11 = I1 + m1 * c1**2 + m2 * l1**2 + self.M22
        self.h = m2 * l1 * c2
        self.g1, self.g2 = g * (m1 * c1 + m2 * l1), g * m2 * c2

    def M(self, q: Array, f: Any = np) -> Array:
        h = self.h * f.cos(q[1])
        return np.array([[self.M11 + 2 * h, self.M22 + h], [self.M22 + h, self.M22 + 0 * h]])

    def C(self, q: Array, v: Array, f: Any = np) -> Array:
        h = self.h * f.sin(q[1])
        return np.array([[-h * v[1], -h * (v[0] + v[1])], [h * v[0], 0 * h]])

    def P(self, q: Array, f: Any = np) -> Any:
        return self.g1 * (1 - f.cos(q[0])) + self.g2 * (1 - f.cos(q[0] + q[1]))

    def grad_P(self, q: Array, f: Any = np) -> Array:
        outer = self.g2 * f.sin(q[0] + q[1])
        return np.array([self.g1 * f.sin(q[0]) + outer, outer])


class Torsion:
    """Odd torsion curves through points (2, m, n) with the slope K (n,) at zero, for floats and mpmath numbers.

    Tangents are linear between knots: 0, the points, and the middles between them. At a point the tangent is the
    harmonic mean of both chords; in a middle it is such that its mean over the interval is the chord; beyond the last
    middle it is constant. Torque and energy are its integrals, by the trapezoidal rule and Simpson's, which are exact.
    """

    def __init__(self, K: Array, points: Array) -> None:
        self.knots, self.tangents = [], []
        for stiffness, z, t in zip(K, *np.moveaxis(points, 2, 1), strict=True):
            chord = np.diff(t, prepend=0.0) / np.diff(z, prepend=0.0)
            at = [stiffness, *(2 / (1 / a + 1 / b) for a, b in zip(chord, chord[1:], strict=False))]
            knots, tangents = [], []
            for i, start in enumerate([0.0, *z[:-1]]):
                last = i + 1 == len(z)
                beyond = (4 * chord[i] - at[i]) / 3 if last else at[i + 1]
                knots += [start, (start + z[i]) / 2]
                tangents += [at[i], beyond if last else 2 * chord[i] - (at[i] + beyond) / 2]
            self.knots.append(knots)
            self.tangents.append(tangents)

    def tangent(self, j: int, zeta: Any) -> Any:
        knots, tangents = self.knots[j], self.tangents[j]
        size = abs(zeta)
        for a, b, low, high in zip(knots, knots[1:], tangents, tangents[1:], strict=False):
            if size < b:
                return low + (high - low) * (size - a) / (b - a)
        return tangents[-1] + 0 * size

    def _pieces(self, j: int, zeta: Any) -> list[tuple[Any, Any]]:
        ends = [knot for knot in self.knots[j] if knot < abs(zeta)] + [abs(zeta)]
        return list(zip(ends, ends[1:], strict=False))

    def torque(self, j: int, zeta: Any) -> Any:
        found = sum((b - a) * (self.tangent(j, a) + self.tangent(j, b)) / 2 for a, b in self._pieces(j, zeta))
        return found if zeta > 0 else -found

    def energy(self, j: int, zeta: Any) -> Any:
        return sum(
            (b - a) * (self.torque(j, a) + 4 * self.torque(j, (a + b) / 2) + self.torque(j, b)) / 6
            for a, b in self._pieces(j, zeta)
        )

    def deflection(self, j: int, tau: Any, f: Any) -> Any:
        """Return the root of torque(zeta) = tau on its piece, by the formula for a quadratic equation."""
        start = max((knot for knot in self.knots[j] if self.torque(j, knot) <= abs(tau)), default=0.0)
        k, r, d = self.knots[j].index(start), abs(tau) - self.torque(j, start), self.tangent(j, start)
        last = k + 1 == len(self.knots[j])
        c = 0 if last else (self.tangents[j][k + 1] - self.tangents[j][k]) / (self.knots[j][k + 1] - start)
        zeta = start + ((f.sqrt(d * d + 2 * c * r) - d) / c if c else r / d)
        return zeta if tau > 0 else -zeta

    def each(self, of: Any, *values: Array) -> Array:
        """Return a function of joint and value at the values (n,) of the joints."""
        return np.array([of(j, *each) for j, each in enumerate(zip(*values, strict=True))])


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot of fjr_core with the numbers from which it was built."""

    name: str
    robot: fjr.Robot
    links: SingleLink | PlanarTwoLink
    K: Array
    M_m: Array
    D_l: Array
    D_m: Array
    B_m: Array
    cubic: Array
    torsion: Torsion | None = None
    load: float = 0.0
    """Largest torque [N m] of the springs at random points; 0: they deflect by up to 0.3 rad."""

    @property
    def n(self) -> int:
        return self.links.n

    def deflection(self, share: Array) -> Array:
        return np.linalg.solve(self.K, self.load * share) if self.load else 0.3 * share

    @property
    def grain(self) -> float:
        """Steps of differences relative to those of straight springs, whose law is nearly a polynomial."""
        return 0.05 if self.cubic.any() else 1.0

    def spring(self, zeta: Array) -> Array:
        if self.torsion is not None:
            return self.torsion.each(self.torsion.torque, zeta)
        return self.K @ zeta + self.cubic * zeta**3


@dataclass(frozen=True, eq=False)
class GainSet:
    """Gains as matrices, and as fjr.Gains."""

    name: str
    gains: fjr.Gains
    Lambda_l: Array
    Pi_l: Array
    K_ld: Array
    Lambda_m: Array
    Pi_m: Array
    K_md: Array
    Gamma_l: Array
    Gamma_m: Array

    def phi_l(self, e: Array) -> Array:
        return self.Lambda_l @ e + self.Gamma_l @ e**3

    def phi_m(self, e: Array) -> Array:
        return self.Lambda_m @ e + self.Gamma_m @ e**3

    def dphi_l(self, e: Array) -> Array:
        return self.Lambda_l + 3 * self.Gamma_l @ np.diag(e**2)

    def dphi_m(self, e: Array) -> Array:
        return self.Lambda_m + 3 * self.Gamma_m @ np.diag(e**2)


def square(value: Any, n: int) -> Array:
    """Return a scalar or vector as a diagonal matrix, a matrix unchanged."""
    value = np.asarray(value, dtype=float)
    return value if value.ndim == 2 else np.diag(np.broadcast_to(value, (n,)))


PLANAR = {
    "link_mass": (1.2, 0.8),
    "link_length": (0.3, 0.25),
    "link_com": (0.15, 0.12),
    "link_inertia": (0.010, 0.005),
    "gravity": 9.81,
}
FULL = {
    "stiffness": [[30.0, 4.0], [4.0, 20.0]],
    "motor_inertia": [[0.02, 0.003], [0.003, 0.01]],
    "link_damping": [[0.2, 0.05], [0.05, 0.1]],
    "motor_damping": [[0.02, -0.004], [-0.004, 0.01]],
    "input_gain": [[1.2, 0.1], [-0.2, 0.8]],
}


def single(stiffness: float) -> Arm:
    values = {"stiffness": stiffness, "motor_inertia": 0.004, "link_damping": 0.2, "motor_damping": 0.007}
    return _arm(
        f"single-{stiffness}", fjr.single_link(stiffness=stiffness), SingleLink(), {**values, "input_gain": 1.0}
    )


def planar(name: str, stiffness: Any, **overrides: Any) -> Arm:
    values = {
        "stiffness": stiffness,
        "motor_inertia": (0.02, 0.01),
        "link_damping": (0.2, 0.1),
        "motor_damping": (0.02, 0.01),
        "input_gain": 1.0,
        **overrides,
    }
    links = PlanarTwoLink(PLANAR["link_mass"], 0.3, PLANAR["link_com"], PLANAR["link_inertia"])
    return _arm(f"planar-{name}", fjr.planar_two_link(**PLANAR, **values), links, values)


def _arm(name: str, robot: fjr.Robot, links: Any, values: dict[str, Any]) -> Arm:
    keys = ("stiffness", "motor_inertia", "link_damping", "motor_damping", "input_gain")
    return Arm(name, robot, links, *(square(values[key], links.n) for key in keys), np.zeros(links.n))


def hardened(arm: Arm, at: float) -> Arm:
    """Return the arm with springs that carry twice the torque of straight ones at a deflection [rad]."""
    cubic = np.diag(arm.K) / at**2
    return replace(arm, name=f"{arm.name}-hard", robot=replace(arm.robot, cubic=cubic), cubic=cubic)


def on_torsion_curves(arm: Arm, deflection: Any, torque: Any) -> Arm:
    """Return the arm with torsion curves through points (m, n) [rad, N m]."""
    points = np.array([deflection, torque])
    robot, torsion = replace(arm.robot, torsion=points), Torsion(np.diag(arm.K), points)
    return replace(arm, name=f"{arm.name}-torsion", robot=robot, torsion=torsion)


def gain_set(name: str, n: int, **values: Any) -> GainSet:
    values = {"Gamma_l": 0.0, "Gamma_m": 0.0, **values}
    return GainSet(name, fjr.Gains(**values), **{key: square(value, n) for key, value in values.items()})


def linear(n: int) -> GainSet:
    return gain_set("linear", n, Lambda_l=10.0, Pi_l=20.0, K_ld=0.6, Lambda_m=15.0, Pi_m=60.0, K_md=0.3)


def cubic(n: int) -> GainSet:
    scalars = {"Lambda_l": 10.0, "Pi_l": 20.0, "K_ld": 0.6, "Lambda_m": 15.0, "Pi_m": 60.0, "K_md": 0.3}
    return gain_set("cubic", n, **scalars, Gamma_l=4.0, Gamma_m=2.0)


def full() -> GainSet:
    """Return gains without diagonal matrices; for full Pi, conditions (32) and (41) require Gamma = Pi^-1 diag(..)."""
    Pi_l, Pi_m = np.array([[20.0, 5.0], [5.0, 12.0]]), np.array([[60.0, -10.0], [-10.0, 40.0]])
    return gain_set(
        "full",
        2,
        Lambda_l=[[10.0, 1.0], [-2.0, 8.0]],
        Pi_l=Pi_l,
        K_ld=[[0.6, 0.1], [0.1, 0.5]],
        Lambda_m=[[15.0, -3.0], [2.0, 12.0]],
        Pi_m=Pi_m,
        K_md=[[0.3, 0.05], [0.05, 0.2]],
        Gamma_l=np.linalg.inv(Pi_l) @ np.diag([30.0, 20.0]),
        Gamma_m=np.linalg.inv(Pi_m) @ np.diag([20.0, 40.0]),
    )


ARMS = (single(31.0), single(3.1), planar("31", 31.0), planar("3.1", 3.1), planar("full", **FULL))
TORSION = (
    on_torsion_curves(ARMS[0], [[0.04], [0.1], [0.25]], [[1.5], [5.0], [20.0]]),
    on_torsion_curves(ARMS[2], [[0.05, 0.1], [0.15, 0.2]], [[1.8, 2.6], [7.0, 4.3]]),
)
"""Springs on a table: the first hardens; of the second one joint hardens, the other one softens."""
HARD = (hardened(ARMS[0], 0.2), hardened(ARMS[2], 0.4))
LOOPS = tuple((arm, gains(arm.n)) for arm in ARMS + HARD for gains in (linear, cubic)) + ((ARMS[-1], full()),)
LOOP_NAMES = tuple(f"{arm.name}-{gains.name}" for arm, gains in LOOPS)


@dataclass(frozen=True, eq=False)
class Point:
    """An instant: virtual and measured state, reference and its rates, external input, and effort u of the plant."""

    x_v: Array
    x: Array
    jets: Array
    djets: Array
    omega: Array
    u: Array


def random_state(arm: Arm, rng: np.random.Generator, spread: float = 1.5) -> Array:
    """Return a state with positions and velocities of order one; momenta use the closed form of M_l."""
    q_l = rng.uniform(-spread, spread, arm.n)
    q_m = q_l + arm.deflection(rng.uniform(-1, 1, arm.n))
    dq_l, dq_m = rng.uniform(-2, 2, (2, arm.n))
    return np.concatenate([q_l, q_m, arm.links.M(q_l) @ dq_l, arm.M_m @ dq_m])


def random_point(arm: Arm, seed: int, same: bool = False, pushed: bool = True) -> Point:
    """Return a random point, with x_v = x if `same` and omega = 0 unless `pushed`; u of the plant is arbitrary."""
    rng = np.random.default_rng(seed)
    x, x_v = random_state(arm, rng), random_state(arm, rng)
    jets = rng.uniform(-1, 1, (6, arm.n))
    omega, u = rng.uniform(-5, 5, (2, arm.n))
    return Point(x.copy() if same else x_v, x, jets[:5], jets[1:], omega if pushed else np.zeros(arm.n), u)


POINTS = ((0, True, True), (1, False, True), (2, False, False))
"""Arguments of random_point: seed, x_v = x or not, omega or none."""
