# SPDX-License-Identifier: Apache-2.0
"""Estimate external torques on the links from spring torque and motion, and distinguish contact from model errors.

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

from functools import cached_property
from math import erfc, exp, gamma, sqrt
from typing import Any

import casadi as ca
import numpy as np

from ..errors import ParameterError
from ..model import springs
from ..model.rigid_arm import RigidArm
from ..model.robot import Robot
from ..numerics.checks import Array, positive
from ..numerics.jit import CFunction, WorkSpace, compiled_from_inputs
from ..numerics.one_line import brief
from ..numerics.symbolic import PackedVector, dense_function, symbols
from ..robust.disturbance_observer import momenta, next_residual
from ..runtime.velocity_observer import LONGEST_GAP
from ..simulation.deviations import ChangedLinks, has_bodies
from ..simulation.imperfections import StatedErrors


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
        self.robot, self._compile = robot, compile
        self.bandwidth = positive("bandwidth", bandwidth, ParameterError, "1/s")

    @property
    def start(self) -> Array:
        """What is kept before the first sample: NaN."""
        return np.full(self.function.numel_in(0), np.nan)

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
        n, size = self.robot.n, self.momenta.numel_out(0)
        s = symbols(ca.MX, kept=3 * size, position=2 * n, velocity=2 * n, bandwidth=1, dt=1)
        parts = PackedVector({"p": size, "f": size, "r": size})
        p, f = self.momenta(s["position"], s["velocity"])
        kept, dt = parts.unpack(s["kept"]), s["dt"]
        follows = ca.logic_and(_finite(kept["r"][:n]), ca.logic_and(dt >= 0, dt <= LONGEST_GAP))
        r = ca.if_else(follows, next_residual(kept, p, f, 0.0, s["bandwidth"], dt), 0)
        r = ca.if_else(_finite(ca.vertcat(p[:n], f[:n])), r, np.nan)
        return dense_function(self.name, s, {"next": parts.pack({"p": p, "f": f, "r": r})})

    @cached_property
    def momenta(self) -> ca.Function:
        """The function (position, velocity) -> p_l and dp_l/dt - tau (n,)."""
        s = symbols(position=2 * self.robot.n, velocity=2 * self.robot.n)
        p, f = (each[: self.robot.n] for each in momenta(self.robot)(*s.values()))
        return dense_function("link_momenta", s, {"p": p, "f": f})

    def along(self, t: Array, position: Array, velocity: Array, before: Array | None = None) -> Array:
        """Return what is kept (k, 3n) after each of k samples; its last n columns are the estimated torques [N m].

        t (k,) [s]: since the sample of `before` (3n,), None: since any time. position, velocity (k, 2n) [rad, rad/s].
        """
        kept = self.start if before is None else before
        if not len(t):
            return np.zeros((0, len(kept)))
        update, dt = self.function.mapaccum("along", len(t)), np.diff(t, prepend=0.0)[None]
        return np.asarray(update(kept, position.T, velocity.T, self.bandwidth * np.ones_like(dt), dt).full().T)


def _finite(values: ca.MX) -> ca.MX:
    """Return 1 if all values are finite, else 0."""
    return ca.sum1(ca.fabs(values)) < np.inf


DAY = 86_400_000
"""Samples of 24 h at 1 kHz."""
WRONG = 0.355
"""Mean of a Poisson distribution whose probability of 0 or 1 is 95 %."""
STICKING = 0.01
"""Speed [rad/s] below which the sign of Coulomb friction is uncertain."""
LEARNING_PERIOD = 3.0
"""Time between two updates of d^, in 1 / bandwidth: r then forgets its noise to 5 %."""
DRIFT = 600.0
"""Time [s] in which the errors may drift to others of the same distribution."""


def chi_squared_quantile(n: int, beyond: float) -> float:
    """Return what chi^2 of n degrees exceeds with the probability `beyond`, by bisection; a node does without SciPy.

    P(chi^2 > 2 y) = erfc(sqrt(y)) (n odd) + exp(-y) sum_h y^h / Gamma(h + 1), h = n/2 - 1, n/2 - 2, .. >= 0
    (Abramowitz and Stegun 26.4.4, 26.4.5).
    """
    powers = [n / 2 - k for k in range(1, n // 2 + 1)]
    low, high = 0.0, 100.0 + 2 * n
    for _ in range(80):
        y = (low + high) / 2
        tail = exp(-y) * sum(y**h / gamma(h + 1) for h in powers) + (erfc(sqrt(y)) if n % 2 else 0.0)
        low, high = (y, high) if tail > beyond else (low, y)
    return low + high


class ContactObserver(ExternalTorqueObserver):
    """External torques r on the links, and their derivatives -Z by the stated errors, which do not explain contact.

    The stated errors d are independent and standard normal, in units of their standard deviations. The torques that the
    links need are linear in d, so the momentum observer of the model without them obeys exactly

        r = L(s) tau - Z d + v      dz_j/dt = L (dp_j/dt - f_j - z_j)      the same observer, of dp_l/dd_j and df/dd_j

    with the noise v ~ N(0, N). Contact is where the Mahalanobis distance of what d does not explain exceeds its limit:

        e' S^-1 e > limit        e = r + Z d^,   S = Z P Z' + N

    The mean d^ and the covariance P start from 0 and 1, and a Kalman filter improves them while there is no contact
    (runtime/contact.c); N has the rounding of encoders, too. So the threshold of a joint, sqrt(limit S_ii), is large
    where the motion shows an error that is not known yet, else that of noise. De Luca and Mattone have constant ones.

    The limit is the quantile of chi^2 at which a day has at most 0.355 wrong samples on average: then at most one false
    alarm in 24 h has 95 % probability. A sum over all samples needs no independence of theirs.

    Its function keeps (3 n (1 + m),): p_l with its derivatives by the m errors, column by column; their rates without
    tau; r and z [N m].
    """

    name = "contact"

    def __init__(self, robot: Robot, bandwidth: float, errors: StatedErrors, compile: bool = False) -> None:
        super().__init__(robot, bandwidth, compile)
        self.errors = errors  # equal equations may be those of other bodies, and Z depends on these
        bodies = [[np.asarray(value).tolist() for value in vars(body).values()] for body in robot.links.bodies]
        self.stated = str([errors.deviations.tolist(), bodies])

    @cached_property
    def limit(self) -> float:
        """Square of the Mahalanobis distance beyond which there is contact."""
        return chi_squared_quantile(self.robot.n, WRONG / DAY)

    @cached_property
    def momenta(self) -> ca.Function:
        """The function (position, velocity) -> p_l and dp_l/dt - tau (n (1 + m),), with derivatives by columns."""
        n, robot = self.robot.n, self.robot
        s = symbols(position=2 * n, velocity=2 * n)
        q_l, dq_l, theta = s["position"][:n], s["velocity"][:n], ca.SX.sym("theta", len(self.errors.deviations))
        mass, stiffness, damping, friction, constant = ca.vertsplit(theta, n)
        links: RigidArm = robot.links
        common = 1 + mass[0]  # of links whose bodies are not known
        if has_bodies(robot.links):
            links, common = ChangedLinks(robot.links, {"link_mass": 1 + mass}), 1.0
        p = common * (links.M_l(q_l) @ dq_l)
        spring = springs.torque(robot, s["position"][n:] - q_l)
        f = common * (links.grad_T(q_l, dq_l) - links.grad_P_l(q_l))
        f += (1 + stiffness) * spring - (1 + damping) * (ca.DM(robot.D_l) @ dq_l)
        f += constant - friction * ca.tanh(dq_l / STICKING)
        by = ca.substitute(ca.jacobian(ca.vertcat(p, f), theta), theta, 0)
        by = by @ ca.diag(ca.DM(self.errors.deviations))
        nominal = ca.substitute(ca.vertcat(p, f), theta, 0)
        outputs = {"p": ca.horzcat(nominal[:n], by[:n, :]), "f": ca.horzcat(nominal[n:], by[n:, :])}
        return dense_function("contact_momenta", s, {name: ca.vec(each) for name, each in outputs.items()}, cse=True)


class TorqueObserverStruct:
    """A ContactObserver for C; `pointer` is a struct fjr_torque_observer*, valid as long as this object lives.

    ffi: with the types of step.h.
    """

    def __init__(self, ffi: Any, observer: ContactObserver) -> None:
        self._held, self._work = CFunction(ffi, observer.function), WorkSpace(ffi, [observer.function])
        errors, start, robot = len(observer.errors.deviations), observer.start, observer.robot
        period, noise = LEARNING_PERIOD / observer.bandwidth, np.asarray(observer.errors.torque_noise)
        arrays = {"kept": start, "next": start, "d": np.zeros(errors), "P": np.eye(errors), "W": np.zeros(errors)}
        self.arrays = {name: ffi.new("double[]", each.ravel().tolist()) for name, each in arrays.items()}
        numbers = {"bandwidth": observer.bandwidth, "errors": errors, "limit": observer.limit}
        timing = {"period": round(period * 1e9), "stay": float(np.exp(-period / DRIFT))}
        encoders = {"K": robot.K.ravel().tolist(), "step": [np.inf] * 2 * robot.n, "seen": [[np.nan] * 2 * robot.n] * 3}
        given = {"update": self._held.pointer, "noise": (noise**2).tolist(), **numbers, **timing, **encoders}
        self.pointer = ffi.new("struct fjr_torque_observer *", given | self.arrays)
        self._work.lend(self.pointer)
