# SPDX-License-Identifier: Apache-2.0
"""How a simulated robot departs from eq. (36): the numbers, checked, all off by default, and what they are off from.

The equations are in nonideal_plant.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..numerics import checks
from ..numerics.checks import Array

POSITIVE = ("stribeck_l", "stribeck_m", "smoothing")
SIGNED = ("ripple", "ripple_periods", "ripple_phase", "payload_position")
SIZES = {"payload_mass": 1, "payload_position": 3}  # of the others: one entry per joint


@dataclass(frozen=True, eq=False)
class Imperfections:
    """Departures of n joints; every field but n is a scalar or (n,), kept as (n,). Off by default.

    coulomb_l, static_l [N m], stribeck_l [rad/s]: friction of the links, of level coulomb + (static - coulomb)
    exp(-(v / stribeck)^2); a static level below the Coulomb level counts as that. coulomb_m, static_m, stribeck_m:
    of the motors. smoothing [rad/s]: both are multiplied by tanh(v / smoothing) in place of sign(v), so that a
    joint creeps instead of sticking and an explicit integrator stays stable: see friction_rate.
    cubic [N m/rad^3]: springs K zeta + cubic zeta^3. ripple [N m], ripple_periods [1/turn], ripple_phase [rad]:
    motor torque ripple sin(periods q_m + phase). effort_limit [N m]: the command is cut off there, inf: no limit.
    lag [s]: time constant of the motor's torque behind that, 0: none.
    payload_mass [kg], payload_position (3,) [m]: a point on the last link, in its frame.
    Raises ParameterError.
    """

    n: int
    coulomb_l: ArrayLike = 0.0
    static_l: ArrayLike = 0.0
    stribeck_l: ArrayLike = 0.1
    coulomb_m: ArrayLike = 0.0
    static_m: ArrayLike = 0.0
    stribeck_m: ArrayLike = 0.1
    smoothing: ArrayLike = 0.01
    cubic: ArrayLike = 0.0
    ripple: ArrayLike = 0.0
    ripple_periods: ArrayLike = 12.0
    ripple_phase: ArrayLike = 0.0
    effort_limit: ArrayLike = np.inf
    lag: ArrayLike = 0.0
    payload_mass: ArrayLike = 0.0
    payload_position: ArrayLike = 0.0

    def __post_init__(self) -> None:
        for name in NAMES:
            array = self._checked(name)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @property
    def off(self) -> bool:
        """Whether the robot is eq. (36) itself."""
        return not any(np.any(getattr(self, name)) for name in SWITCHES) and bool(np.all(np.isinf(self.effort_limit)))

    @property
    def vector(self) -> Array:
        """All numbers in the order of NAMES, as nonideal_plant takes them."""
        return np.concatenate([getattr(self, name) for name in NAMES])

    def _checked(self, name: str) -> Array:
        value = getattr(self, name)
        if name == "effort_limit":
            array = _limit(value, self.n)
        else:
            array = checks.vector(name, value, SIZES.get(name, self.n), ParameterError)
        if name in POSITIVE and not np.all(array > 0):
            raise ParameterError(f"{name} is {array.tolist()} rad/s; expected positive numbers")
        if name not in SIGNED and not np.all(array >= 0):
            raise ParameterError(f"{name} is {array.tolist()}; expected 0 or more")
        return array


NAMES = tuple(field.name for field in fields(Imperfections) if field.name != "n")
SWITCHES = ("coulomb_l", "static_l", "coulomb_m", "static_m", "cubic", "ripple", "lag", "payload_mass")
"""With all of these 0 and no effort_limit nothing departs from eq. (36)."""


def _limit(value: ArrayLike, n: int) -> Array:
    array = np.array(value, dtype=float)
    if array.shape not in ((), (n,)) or np.any(np.isnan(array)):
        raise ParameterError(f"effort_limit is {value!r}; expected a scalar or ({n},), inf for no limit")
    return np.broadcast_to(array, n).copy()


def friction_rate(imperfections: Imperfections, M_l: ArrayLike, M_m: ArrayLike) -> float:
    """The fastest rate [1/s] that friction damps a joint with, in the creep about rest where it is steepest.

    An eigenvalue of M^-1 diag(level / smoothing) with the inertias (n, n) and the levels at rest. A Runge-Kutta
    step of order 4 needs it below 2.78 / dt (E. Hairer, G. Wanner, Solving Ordinary Differential Equations II,
    sec. IV.2); a motion that creeps or turns would chatter beyond.
    """
    i = imperfections
    sides = ((M_l, i.coulomb_l, i.static_l), (M_m, i.coulomb_m, i.static_m))
    slopes = [(np.asarray(M), np.maximum(coulomb, static) / i.smoothing) for M, coulomb, static in sides]
    return max(float(np.max(np.linalg.eigvals(np.linalg.solve(M, np.diag(slope))).real)) for M, slope in slopes)


NANOSECONDS = 1e9
MOST_BITS = 48.0
"""Finer steps of an encoder are no longer seen in double precision."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the sensors of n joints; fields are scalars or (n,), kept as (n,).

    bits_l, bits_m: encoder bits per turn of q_l and of q_m (0: no quantisation; a motor's encoder behind a gear
    of ratio r has log2 r bits more per turn of q_m, so they need not be whole). position_l, position_m [rad] and
    velocity_l, velocity_m [rad/s]: standard deviations of white noise, before the quantisation.
    velocities: whether velocities are measured at all. Raises ParameterError.
    """

    n: int
    bits_l: ArrayLike = 0.0
    bits_m: ArrayLike = 0.0
    position_l: ArrayLike = 0.0
    position_m: ArrayLike = 0.0
    velocity_l: ArrayLike = 0.0
    velocity_m: ArrayLike = 0.0
    velocities: bool = True

    def __post_init__(self) -> None:
        for field in fields(self)[1:-1]:
            array = checks.vector(field.name, getattr(self, field.name), self.n, ParameterError)
            largest = MOST_BITS if field.name.startswith("bits") else np.inf
            if not np.all((array >= 0) & (array <= largest)):
                raise ParameterError(f"{field.name} is {array.tolist()}; expected 0 to {largest}")
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)

    @property
    def off(self) -> bool:
        """Whether the sensors are perfect."""
        return self.velocities and not any(np.any(getattr(self, field.name)) for field in fields(self)[1:-1])


@dataclass(frozen=True)
class ChannelErrors:
    """What happens to messages on their way: delay and jitter [s], loss and repetition (probabilities).

    An item takes delay plus a uniform share of jitter; a repeated one comes twice, the copy with a share of its
    own. in_order: no item overtakes an earlier one, as with DDS; else jitter may change the order.
    Raises ParameterError.
    """

    delay: float = 0.0
    jitter: float = 0.0
    loss: float = 0.0
    repetition: float = 0.0
    in_order: bool = True

    def __post_init__(self) -> None:
        for name in ("delay", "jitter"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"{name} is {getattr(self, name)} s; expected 0 or more, finite")
        for name in ("loss", "repetition"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"{name} is {getattr(self, name)}; expected a probability, 0 to 1")

    @property
    def off(self) -> bool:
        """Whether every item arrives once and at once."""
        return not (self.delay or self.jitter or self.loss or self.repetition)
