# SPDX-License-Identifier: Apache-2.0
"""How the simulated robot departs from its model, in words; what the words mean is in docs/imperfections.md."""

from __future__ import annotations

import math

from ..errors import ParameterError
from ..robot.robot import Robot
from ..simulation.nonideal_parameters import MOST_BITS, ChannelErrors, Imperfections, SensorErrors
from .parameter import Parameter, Value, Values, named, vector

_DYNAMICS: dict[str, tuple[str, float, str, str, float]] = {  # field: parameter, default, unit, description, minimum
    "coulomb_l": ("link_coulomb_friction", 0.0, "N m", "Coulomb friction at the links", 0.0),
    "static_l": ("link_static_friction", 0.0, "N m", "Friction of the links about rest, where above Coulomb's", 0.0),
    "stribeck_l": ("link_stribeck_velocity", 0.1, "rad/s", "Speed that takes the links from static to Coulomb", 1e-6),
    "coulomb_m": ("motor_coulomb_friction", 0.0, "N m", "Coulomb friction at the motors", 0.0),
    "static_m": ("motor_static_friction", 0.0, "N m", "Friction of the motors about rest, where above Coulomb's", 0.0),
    "stribeck_m": ("motor_stribeck_velocity", 0.1, "rad/s", "Speed that takes the motors from static to Coulomb", 1e-6),
    "smoothing": ("friction_smoothing_velocity", 0.01, "rad/s", "Speed at which friction has tanh 1 of its size", 1e-6),
    "cubic": ("cubic_stiffness", 0.0, "N m/rad^3", "Cubic part of the springs", 0.0),
    "ripple": ("torque_ripple", 0.0, "N m", "Amplitude of the motors' torque ripple", 0.0),
    "ripple_periods": ("torque_ripple_periods", 12.0, "1/turn", "Periods of the ripple in a turn of q_m", 0.0),
    "ripple_phase": ("torque_ripple_phase", 0.0, "rad", "Phase of the ripple at q_m = 0", -math.inf),
    "effort_limit": ("effort_limit", math.inf, "N m", "The motors give no more than this", 0.0),
    "lag": ("actuator_lag", 0.0, "s", "Time constant of the motors' torque", 0.0),
}
_SENSORS: dict[str, tuple[str, str, str, float]] = {  # field: parameter, unit, description, maximum
    "bits_l": ("link_encoder_bits", "bit", "Encoder bits per turn of q_l; 0: no steps", MOST_BITS),
    "bits_m": ("motor_encoder_bits", "bit", "Encoder bits per turn of q_m; 0: no steps", MOST_BITS),
    "position_l": ("link_position_noise", "rad", "Standard deviation of the measured q_l", math.inf),
    "position_m": ("motor_position_noise", "rad", "Standard deviation of the measured q_m", math.inf),
    "velocity_l": ("link_velocity_noise", "rad/s", "Standard deviation of the measured dq_l", math.inf),
    "velocity_m": ("motor_velocity_noise", "rad/s", "Standard deviation of the measured dq_m", math.inf),
}
_CHANNEL = {  # field: unit, description, maximum
    "delay": ("s", "Time that {} take to arrive", 10.0),
    "jitter": ("s", "Largest further time that {} take, uniformly distributed", 10.0),
    "loss": ("1", "Probability that one of {} is lost", 1.0),
    "repetition": ("1", "Probability that one of {} comes twice", 1.0),
}
_SIDES = {"state": "states", "command": "commands"}
MASS, POSITION = "imperfections.payload_mass", "imperfections.payload_position"
SEED, VELOCITIES = "imperfections.seed", "imperfections.publish_velocity"
PERIOD_JITTER, IN_ORDER = "imperfections.period_jitter", "imperfections.messages_in_order"


def imperfection_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints; everything is off by default."""
    return [*_dynamics(n), *_sensors(n), *_messages()]


def _dynamics(n: int) -> list[Parameter]:
    per_joint = [
        Parameter(_of(name), (default,) * n, text, unit, low, dynamic=True, infinite=field == "effort_limit")
        for field, (name, default, unit, text, low) in _DYNAMICS.items()
    ]
    return [
        *per_joint,
        Parameter(MASS, 0.0, "A point mass on the last link", "kg", 0.0, 1e6, dynamic=True),
        Parameter(POSITION, (0.0,) * 3, "Where it is in the last link's frame", "m", dynamic=True),
    ]


def _sensors(n: int) -> list[Parameter]:
    per_joint = [
        Parameter(_of(name), (0.0,) * n, text, unit, 0.0, high, dynamic=True)
        for name, unit, text, high in _SENSORS.values()
    ]
    return [*per_joint, Parameter(VELOCITIES, True, "States carry velocities", dynamic=True)]


def _messages() -> list[Parameter]:
    channels = [
        Parameter(_of(f"{side}_{field}"), 0.0, text.format(what), unit, 0.0, high, dynamic=True)
        for side, what in _SIDES.items()
        for field, (unit, text, high) in _CHANNEL.items()
    ]
    return [
        *channels,
        Parameter(IN_ORDER, True, "Jitter lets no message overtake an earlier one", dynamic=True),
        Parameter(PERIOD_JITTER, 0.0, "Largest lateness of a sample, below the period", "s", 0.0, 1.0, dynamic=True),
        Parameter(SEED, 0, "Which random sequences noise and messages have; a reset begins them anew", "", 0, 2**31),
    ]


def imperfections(values: Values, robot: Robot) -> Imperfections:
    """What the values say of the robot's motion; raises ParameterError."""
    fields = {field: vector(values, _of(word[0]), robot.n) for field, word in _DYNAMICS.items()}
    where = vector(values, POSITION, 3, "its x, y and z")
    if robot.links.hand is None and _number(values, MASS):
        raise ParameterError(f"parameter '{MASS}' is {values[MASS]} kg; expected 0: the links have no place for it")
    words = {field: _of(word[0]) for field, word in _DYNAMICS.items()}
    return named(
        lambda field: words.get(field, "imperfections"),
        lambda: Imperfections(robot.n, **fields, payload_mass=_number(values, MASS), payload_position=where),
    )


def sensor_errors(values: Values, n: int) -> SensorErrors:
    """What the values say of the sensors of n joints; raises ParameterError."""
    fields = {field: vector(values, _of(word[0]), n) for field, word in _SENSORS.items()}
    return SensorErrors(n, **fields, velocities=bool(values[VELOCITIES]))


def channel_errors(values: Values) -> tuple[ChannelErrors, ChannelErrors]:
    """What the values say of states going out and of commands coming in; raises ParameterError."""
    states, commands = (_channel(values, side) for side in _SIDES)
    return states, commands


def period_jitter(values: Values) -> float:
    """The largest lateness of a sample [s]; raises ParameterError unless it is below the period of publish_rate."""
    jitter, period = _number(values, PERIOD_JITTER), 1 / _number(values, "publish_rate")
    if jitter >= period:
        raise ParameterError(f"parameter '{PERIOD_JITTER}' is {jitter} s; expected less than the period, {period:g} s")
    return jitter


def seed(values: Values) -> int:
    """The seed of all random sequences."""
    return int(_number(values, SEED))


def _channel(values: Values, side: str) -> ChannelErrors:
    fields = {field: _number(values, _of(f"{side}_{field}")) for field in _CHANNEL}
    return ChannelErrors(**fields, in_order=bool(values[IN_ORDER]))


def _number(values: Values, name: str) -> float:
    value: Value = values[name]
    assert isinstance(value, (int, float))
    return value


def _of(name: str) -> str:
    return f"imperfections.{name}"
