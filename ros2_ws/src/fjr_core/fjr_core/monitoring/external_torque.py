# SPDX-License-Identifier: Apache-2.0
"""Estimate external torques on the links from spring torque and motion.

    dp_l/dt = f + tau,   f = phi(q_m - q_l) + C' dq_l - grad P_l - D_l dq_l          the links of eq. (36)
    r = L (p_l - p_l(0) - integral of (f + r) dt)        dr/dt = L (tau - r)

This is the generalised momentum observer (A. De Luca, R. Mattone, ICRA 2005; S. Haddadin, A. De Luca,
A. Albu-Schaeffer, "Robot collisions", IEEE T-RO 33, 2017) behind the springs: it needs neither motor torque nor
acceleration. r is tau through a low-pass of bandwidth L, in every motion of an exact model; friction of the links, a
payload and errors of the model count as external. In samples it is of order 2 (robust/disturbance_observer.py).

Velocities of an observer of bandwidth w [rad/s] add the low-pass w^2 / (s + w)^2, and damping an error of
2 D_l / (M_l w) of a constant torque.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from ..errors import ParameterError
from ..model.robot import Robot
from ..numerics.checks import Array, positive
from ..numerics.jit import compiled_from_inputs
from ..numerics.one_line import brief
from ..numerics.symbolic import PackedVector, dense_function, symbols
from ..robust.disturbance_observer import momenta, next_residual
from ..runtime.velocity_observer import LONGEST_GAP


class ExternalTorqueObserver:
    """External torques on the links of a robot.

    bandwidth [1/s]: L above; ParameterError unless positive and finite. compile: to machine code (numerics.jit).
    """

    name = "external_torque"
    """Of the function, also in the code cache."""
    stated = ""
    """What the function depends on beside the robot."""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.robot!r}, bandwidth={brief(self.bandwidth)} 1/s)"

    def __init__(self, robot: Robot, bandwidth: float, compile: bool = False) -> None:
        positive("bandwidth", bandwidth, ParameterError, "1/s")
        self.robot, self.bandwidth, self._compile = robot, float(bandwidth), compile

    @property
    def start(self) -> Array:
        """What is kept before the first sample (3n,): NaN."""
        return np.full(3 * self.robot.n, np.nan)

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (kept, position, velocity, bandwidth, dt) -> kept at this sample.

        kept (3n,): p_l, its rate without tau, r [N m]. position, velocity (2n,) [rad, rad/s]. dt [s]: since the last
        sample; below 0, above LONGEST_GAP or after r = NaN, r restarts from 0. It is NaN where a value is not finite.
        """
        if not self._compile:
            return self._function()
        return compiled_from_inputs(self.name, self.robot.fingerprint(), self.stated, self._function)

    def _function(self) -> ca.Function:
        n, of_both_sides = self.robot.n, momenta(self.robot)
        return observer_function(self.name, n, n, lambda q, dq: [each[:n] for each in of_both_sides(q, dq)])

    def along(self, t: Array, position: Array, velocity: Array, before: Array | None = None) -> Array:
        """Return what is kept (k, 3n) after each of k samples; its last n columns are the estimated torques [N m].

        t (k,) [s]: since the sample of `before` (3n,), None: since any time. position, velocity (k, 2n) [rad, rad/s].
        """
        kept = self.start if before is None else before
        if not len(t):
            return np.zeros((0, len(kept)))
        bandwidth, dt = np.full((1, len(t)), self.bandwidth), np.diff(t, prepend=0.0)[None]
        found = self.function.mapaccum("along", len(t))(kept, position.T, velocity.T, bandwidth, dt)
        return np.asarray(found.full().T)


def observer_function(name: str, n: int, size: int, momentum: Callable[[ca.MX, ca.MX], Sequence[ca.MX]]) -> ca.Function:
    """Return the function (kept, position, velocity, bandwidth, dt) -> kept of a momentum observer of n joints.

    momentum: (position, velocity) -> p, dp/dt - tau (size,), finite if their first n are. kept (3 size,): both, r.
    """
    s = symbols(ca.MX, kept=3 * size, position=2 * n, velocity=2 * n, bandwidth=1, dt=1)
    parts = PackedVector({"p": size, "f": size, "r": size})
    p, f = momentum(s["position"], s["velocity"])
    kept, dt = parts.unpack(s["kept"]), s["dt"]
    follows = ca.logic_and(_finite(kept["r"][:n]), ca.logic_and(dt >= 0, dt <= LONGEST_GAP))
    r = ca.if_else(follows, next_residual(kept, p, f, 0.0, s["bandwidth"], dt), 0)
    r = ca.if_else(_finite(ca.vertcat(p[:n], f[:n])), r, np.nan)
    return dense_function(name, s, {"next": parts.pack({"p": p, "f": f, "r": r})})


def _finite(values: ca.MX) -> ca.MX:
    """Return 1 if all values are finite, else 0."""
    return ca.sum1(ca.fabs(values)) < np.inf
