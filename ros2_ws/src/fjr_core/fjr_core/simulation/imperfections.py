# SPDX-License-Identifier: Apache-2.0
"""Checked imperfections of the plant, its sensors and its message channels, and stated errors of the model.

All imperfections are off by default; their equations are in nonideal_plant.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.one_line import one_line
from ..numerics.parameter_field import POINT, VECTOR, declared, parameter_field

if TYPE_CHECKING:
    from ..model.robot import Robot

SIZES = {"payload_mass": 1, "payload_position": 3}  # of the others: one entry per joint


def freeze_within_ranges(owner: object, n: int) -> None:
    """Store the numbers declared by a frozen dataclass as arrays (n,), or as SIZES says; raise ParameterError."""
    for name, parameter in declared(type(owner)).items():
        if isinstance(parameter.default, bool):
            continue
        size, array = SIZES.get(name, n), checks.floats(name, getattr(owner, name), ParameterError)
        if not parameter.infinite:
            checks.finite(name, array, ParameterError)
        array = checks.filled(name, array, (size,), ParameterError)
        if not np.all((array >= parameter.minimum) & (array <= parameter.maximum)):
            unit = f" {parameter.unit}" if parameter.unit not in ("", "1") else ""
            raise ParameterError(f"{name} is {array.tolist()}{unit}; expected {parameter.range}{unit}")
        checks.freeze(owner, name, array)


def _per_joint(default: float, name: str, unit: str, description: str, minimum: float = 0.0, **properties: Any) -> Any:
    return parameter_field(
        default, description, unit, name=name, minimum=minimum, shape=VECTOR, dynamic=True, **properties
    )


_channel = partial(parameter_field, 0.0, minimum=0.0, dynamic=True)


@dataclass(frozen=True, eq=False)
class Imperfections:
    """Imperfections of n joints; each field except n is a scalar or (n,), stored as (n,). All are off by default.

    The fields declare units, ranges and descriptions. Friction of links (_l) and motors (_m) has the level
    coulomb + (static - coulomb) exp(-(v / stribeck)^2) + load |torque of the spring|. With tanh(v / smoothing) in place
    of sign(v), a joint creeps instead of sticking and an explicit integrator stays stable; see friction_rate. The motor
    torque lags after the saturation of the command. payload_position (3,) is in the frame of the last link. Raises
    ParameterError.
    """

    n: int
    coulomb_l: ArrayLike = _per_joint(0.0, "link_coulomb_friction", "N m", "Coulomb friction torque of the links")
    static_l: ArrayLike = _per_joint(
        0.0,
        "link_static_friction",
        "N m",
        "Static (breakaway) friction torque of the links; ignored if below the Coulomb level",
    )
    stribeck_l: ArrayLike = _per_joint(0.1, "link_stribeck_velocity", "rad/s", "Stribeck velocity of the links", 1e-6)
    coulomb_m: ArrayLike = _per_joint(0.0, "motor_coulomb_friction", "N m", "Coulomb friction torque of the motors")
    static_m: ArrayLike = _per_joint(
        0.0,
        "motor_static_friction",
        "N m",
        "Static (breakaway) friction torque of the motors; ignored if below the Coulomb level",
    )
    stribeck_m: ArrayLike = _per_joint(0.1, "motor_stribeck_velocity", "rad/s", "Stribeck velocity of the motors", 1e-6)
    load_l: ArrayLike = _per_joint(
        0.0,
        "link_load_friction",
        "1",
        "Share of the torque of the spring by which the friction of the links grows",
        maximum=1.0,
    )
    load_m: ArrayLike = _per_joint(
        0.0,
        "motor_load_friction",
        "1",
        "Share of the torque of the spring by which the friction of the motors grows",
        maximum=1.0,
    )
    smoothing: ArrayLike = _per_joint(
        0.01,
        "friction_smoothing_velocity",
        "rad/s",
        "Smoothing velocity v0 of friction: sign(v) is replaced by tanh(v/v0)",
        1e-6,
    )
    cubic: ArrayLike = _per_joint(0.0, "cubic_stiffness", "N m/rad^3", "Cubic stiffness of the joints")
    hysteresis: ArrayLike = _per_joint(
        0.0, "hysteresis_torque", "N m", "Torque at which the Maxwell element beside a spring slips"
    )
    slip: ArrayLike = _per_joint(
        1e-3, "hysteresis_deflection", "rad", "Deflection at which the Maxwell element beside a spring slips", 1e-9
    )
    ripple: ArrayLike = _per_joint(0.0, "torque_ripple", "N m", "Amplitude of the motor torque ripple")
    ripple_periods: ArrayLike = _per_joint(
        12.0, "torque_ripple_periods", "1/turn", "Periods of the torque ripple per turn of q_m"
    )
    ripple_phase: ArrayLike = _per_joint(
        0.0, "torque_ripple_phase", "rad", "Phase of the torque ripple at q_m = 0", -np.inf
    )
    effort_limit: ArrayLike = _per_joint(
        np.inf, "effort_limit", "N m", "Saturation limit of the motor torque", infinite=True
    )
    lag: ArrayLike = _per_joint(0.0, "actuator_lag", "s", "Time constant of the motor torque")
    payload_mass: ArrayLike = parameter_field(
        0.0, "Point mass attached to the last link", "kg", minimum=0.0, maximum=1e6, dynamic=True
    )
    payload_position: ArrayLike = parameter_field(
        0.0, "Position of the point mass in the frame of the last link", "m", shape=POINT, dynamic=True
    )

    def __post_init__(self) -> None:
        freeze_within_ranges(self, self.n)

    @property
    def off(self) -> bool:
        """Return whether the robot equals eq. (36)."""
        return not any(np.any(getattr(self, name)) for name in SWITCHES) and bool(np.all(np.isinf(self.effort_limit)))

    @property
    def vector(self) -> Array:
        """Return all numbers in the order of NAMES, the parameters of nonideal_plant."""
        return np.concatenate([getattr(self, name) for name in NAMES])


NAMES = tuple(field.name for field in fields(Imperfections) if field.name != "n")
SWITCHES = (
    *("coulomb_l", "static_l", "load_l", "coulomb_m", "static_m", "load_m"),
    *("cubic", "hysteresis", "ripple", "lag", "payload_mass"),
)
"""If all of these are 0 and there is no effort_limit, the robot equals eq. (36)."""


def friction_rate(imperfections: Imperfections, M_l: ArrayLike, M_m: ArrayLike, load: ArrayLike = 0.0) -> float:
    """Return the largest damping rate [1/s] of friction, which occurs in creep at zero velocity.

    Largest eigenvalue of M^-1 diag(level / smoothing) with the inertias M_l, M_m (n, n) and the levels at rest under
    a load (n,) [N m] of the springs. A Runge-Kutta step of order 4 is stable below 2.78 / dt (E. Hairer, G. Wanner,
    Solving Ordinary Differential Equations II, sec. IV.2); above, a motion that creeps or reverses would chatter.
    """
    i, smoothing = imperfections, np.asarray(imperfections.smoothing)
    sides = ((M_l, i.coulomb_l, i.static_l, i.load_l), (M_m, i.coulomb_m, i.static_m, i.load_m))
    slopes = [
        (np.asarray(M), (np.maximum(coulomb, static) + np.asarray(share) * load) / smoothing)
        for M, coulomb, static, share in sides
    ]
    return max(float(np.max(np.linalg.eigvals(np.linalg.solve(M, np.diag(slope))).real)) for M, slope in slopes)


def largest_load(robot: Robot, q_l: Array, limit: ArrayLike = np.inf) -> Array:
    """Return the load (n,) [N m] that springs are expected to carry: |B_m| times the effort limits.

    Those of robot and `limit`; without, the largest weight at q_l (n,) and with one joint turned by 90 degrees.
    """
    limits = np.minimum(limit, np.inf if robot.limits is None else robot.limits.effort)
    limits = (np.abs(robot.B_m) * np.where(robot.B_m == 0, 0.0, limits)).sum(axis=1)
    turns = np.pi / 2 * np.eye(robot.n, robot.n + 1).T  # the last one: no turn
    weight = np.max([np.abs(robot.grad_P_l(q_l + turn)) for turn in turns], axis=0)
    return np.where(np.isfinite(limits), limits, weight)


def stuck_rate(imperfections: Imperfections, K: Array, M_l: Array, M_m: Array) -> float:
    """Return the largest frequency [rad/s] of the springs while their Maxwell elements stick, 0 without hysteresis.

    Square root of the largest eigenvalue of (M_l^-1 + M_m^-1) (K + diag(hysteresis / slip)), matrices (n, n).
    """
    if not np.any(imperfections.hysteresis):
        return 0.0
    stiffness = K + np.diag(imperfections.hysteresis / np.asarray(imperfections.slip))
    return float(np.sqrt(np.max(np.linalg.eigvals((np.linalg.inv(M_l) + np.linalg.inv(M_m)) @ stiffness).real)))


NANOSECONDS = 1e9
MOST_BITS = 48.0
"""Largest resolution of an encoder; finer steps vanish in double precision."""


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the sensors of n joints; fields are scalars or (n,), stored as (n,).

    White noise is added before quantisation. Bits per turn need not be integers: a motor encoder with gear ratio r has
    log2 r additional bits per turn of q_m. Raises ParameterError.
    """

    n: int
    bits_l: ArrayLike = _per_joint(
        0.0, "link_encoder_bits", "bit", "Encoder bits per turn of q_l; 0: no quantisation", maximum=MOST_BITS
    )
    bits_m: ArrayLike = _per_joint(
        0.0, "motor_encoder_bits", "bit", "Encoder bits per turn of q_m; 0: no quantisation", maximum=MOST_BITS
    )
    position_l: ArrayLike = _per_joint(0.0, "link_position_noise", "rad", "Standard deviation of the noise of q_l")
    position_m: ArrayLike = _per_joint(0.0, "motor_position_noise", "rad", "Standard deviation of the noise of q_m")
    velocity_l: ArrayLike = _per_joint(0.0, "link_velocity_noise", "rad/s", "Standard deviation of the noise of dq_l")
    velocity_m: ArrayLike = _per_joint(0.0, "motor_velocity_noise", "rad/s", "Standard deviation of the noise of dq_m")
    velocities: bool = parameter_field(True, "Publish velocities in the states", name="publish_velocity", dynamic=True)

    def __post_init__(self) -> None:
        freeze_within_ranges(self, self.n)

    @property
    def off(self) -> bool:
        """Return whether the sensors are ideal."""
        return self.velocities and not any(np.any(getattr(self, field.name)) for field in fields(self)[1:-1])


@dataclass(frozen=True)
class ChannelErrors:
    """Errors of a message channel: delay and jitter [s], probabilities of loss and duplication (`repetition`).

    An item arrives after the delay plus a uniform share of the jitter; a duplicate draws its own share. in_order: no
    item overtakes an earlier one, as with DDS; false: jitter may change the order. Raises ParameterError.
    """

    delay: float = _channel("Transport delay of {}", "s", name="delay", maximum=10.0)
    jitter: float = _channel("Largest additional delay of {}, uniformly distributed", "s", name="jitter", maximum=10.0)
    loss: float = _channel("Probability that one of {} is lost", "1", name="loss", maximum=1.0)
    repetition: float = _channel("Probability that one of {} is duplicated", "1", name="repetition", maximum=1.0)
    in_order: bool = parameter_field(
        True, "Deliver messages in order, whatever their jitter", name="messages_in_order", dynamic=True
    )

    def __post_init__(self) -> None:
        for name in ("delay", "jitter"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ParameterError(f"{name} is {getattr(self, name)} s; expected 0 or more, finite")
        for name in ("loss", "repetition"):
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"{name} is {getattr(self, name)}; expected a probability, 0 to 1")

    @property
    def off(self) -> bool:
        """Return whether every item arrives exactly once without delay."""
        return not (self.delay or self.jitter or self.loss or self.repetition)


def _stated(default: float, description: str, unit: str = "", minimum: float = 0.0) -> Any:
    return parameter_field(
        default, f"Standard deviation of {description}", unit, minimum=minimum, maximum=1e6, shape=VECTOR
    )


@dataclass(frozen=True, eq=False)
class StatedErrors:
    """Standard deviations of the errors of the model of n joints; each field is a scalar or (n,), stored as (n,).

    Shares are relative to the value of the model. Raises ParameterError unless all are at least 0, and the noise above.
    """

    n: int
    link_mass: ArrayLike = _stated(0.05, "mass and inertia of each link, as a share")
    joint_stiffness: ArrayLike = _stated(0.05, "joint_stiffness, as a share")
    link_damping: ArrayLike = _stated(0.3, "link_damping, as a share")
    link_coulomb_friction: ArrayLike = _stated(0.1, "the Coulomb friction of the links", "N m")
    link_torque: ArrayLike = _stated(0.1, "a constant torque on each link, as by an offset of an encoder", "N m")
    torque_noise: ArrayLike = _stated(0.1, "~/external_torque at standstill", "N m", 1e-9)

    __repr__ = one_line

    def __post_init__(self) -> None:
        freeze_within_ranges(self, self.n)

    @property
    def deviations(self) -> Array:
        """Standard deviations (m,) of the errors of the model, kind by kind."""
        return np.concatenate([np.asarray(getattr(self, each.name)) for each in fields(self)[1:-1]])
