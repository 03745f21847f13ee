# SPDX-License-Identifier: Apache-2.0
"""Parameters imperfections.*: non-idealities of the simulated robot (docs/imperfections.md)."""

from __future__ import annotations

from dataclasses import replace

from ..errors import ParameterError
from ..model.robot import Robot
from ..numerics.parameter_field import declared
from ..simulation.nonideal_parameters import ChannelErrors, Nonidealities, SensorErrors
from .parameter import Parameter, Values, number, read, table

_GROUP = "imperfections."
_DYNAMICS = declared(Nonidealities, _GROUP)
_SENSORS = declared(SensorErrors, _GROUP)
_CHANNEL = declared(ChannelErrors)
_IN_ORDER = "in_order"  # the field that both channels share
_SUBJECTS = {"state": "states", "command": "commands"}
PERIOD_JITTER = Parameter(
    f"{_GROUP}period_jitter", 0.0, "Largest delay of a sample, below the sample period", "s", 0.0, 1.0, dynamic=True
)
SEED = Parameter(f"{_GROUP}seed", 0, "Seed of noise, jitter and message loss; a reset restarts them", "", 0, 2**31)


def _channel(side: str) -> dict[str, Parameter]:
    """Return the declarations of one channel: "state" or "command"."""
    own = {field: each for field, each in _CHANNEL.items() if field != _IN_ORDER}
    return {
        field: replace(each, name=f"{_GROUP}{side}_{each.name}", description=each.description.format(_SUBJECTS[side]))
        for field, each in own.items()
    } | {_IN_ORDER: replace(_CHANNEL[_IN_ORDER], name=_GROUP + _CHANNEL[_IN_ORDER].name)}


_STATES, _COMMANDS = _channel("state"), _channel("command")


def imperfection_parameters(n: int) -> list[Parameter]:
    """Return the parameters for n joints; every non-ideality is off by default."""
    channels = {each.name: each for side in (_STATES, _COMMANDS) for each in side.values()}
    return [*table(_DYNAMICS, n), *table(_SENSORS, n), *table(channels, n), PERIOD_JITTER, SEED]


def imperfections(values: Values, robot: Robot) -> Nonidealities:
    """Return the non-idealities of the robot's dynamics; raises ParameterError."""
    mass = _DYNAMICS["payload_mass"].name
    if robot.links.end_effector is None and values[mass]:
        raise ParameterError(
            f"parameter '{mass}' is {values[mass]} kg; expected 0: the robot model has no end effector"
        )
    return Nonidealities(robot.n, **read(_DYNAMICS, values, robot.n))


def sensor_errors(values: Values, n: int) -> SensorErrors:
    """Return the sensor errors of n joints; raises ParameterError."""
    return SensorErrors(n, **read(_SENSORS, values, n))


def channel_errors(values: Values) -> tuple[ChannelErrors, ChannelErrors]:
    """Return the channel errors of states and of commands; raises ParameterError."""
    return ChannelErrors(**read(_STATES, values, 0)), ChannelErrors(**read(_COMMANDS, values, 0))


def period_jitter(values: Values) -> float:
    """Return the largest delay of a sample [s]; raises ParameterError unless it is below the sample period."""
    jitter, period = number(values, PERIOD_JITTER.name), 1 / number(values, "publish_rate")
    if jitter >= period:
        raise ParameterError(
            f"parameter '{PERIOD_JITTER.name}' is {jitter} s; expected less than the period, {period:g} s"
        )
    return jitter


def seed(values: Values) -> int:
    """Return the seed of all random sequences."""
    return int(number(values, SEED.name))
