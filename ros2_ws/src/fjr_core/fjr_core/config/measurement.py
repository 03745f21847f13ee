# SPDX-License-Identifier: Apache-2.0
"""Parameters measurement.*: the source of velocities and motor positions, and the velocity observer."""

from __future__ import annotations

from ..model.robot import Robot
from ..numerics.parameter_field import declared
from ..runtime.measurement_model import OBSERVER, TORQUE, Measurement
from ..runtime.velocity_observer import VelocityObserver
from .parameter import Parameter, Values, number, read, table

BANDWIDTH = 150.0  # rad/s; chosen in docs/measurements.md
OBSERVER_BANDWIDTH = Parameter(
    "measurement.observer_bandwidth", BANDWIDTH, "Bandwidth of the velocity observer", "rad/s", minimum=1.0, maximum=1e4
)
_DECLARED = declared(Measurement, "measurement.")


def measurement_parameters(n: int) -> list[Parameter]:
    """Return the parameters for n joints."""
    return [*table(_DECLARED, n), OBSERVER_BANDWIDTH]


def measurement(values: Values, robot: Robot) -> Measurement:
    """Return the measurement model of the values; raises ParameterError if they contradict each other."""
    settings = read(_DECLARED, values, robot.n)
    return Measurement(robot.n, **settings, K=robot.K if settings["motor"] == TORQUE else None)


def observer(values: Values, robot: Robot) -> VelocityObserver | None:
    """Return the velocity observer of the values, or None if velocities are measured."""
    if values["measurement.velocity"] != OBSERVER:
        return None
    return VelocityObserver(robot, number(values, OBSERVER_BANDWIDTH.name), compile=bool(values["compile"]))
