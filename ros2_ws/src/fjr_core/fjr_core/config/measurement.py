# SPDX-License-Identifier: Apache-2.0
"""What the joints' states really hold, in words: the parameters measurement.*, and what their values describe."""

from __future__ import annotations

from ..estimation.measurement_model import MEASURED, OBSERVER, POSITION, TORQUE, Measurement
from ..estimation.velocity_observer import VelocityObserver
from ..robot.robot import Robot
from .parameter import Parameter, Values, vector

BANDWIDTH = 150.0  # rad/s; docs/measurements.md says why


def measurement_parameters(n: int) -> list[Parameter]:
    """The parameters for n joints."""
    return [
        Parameter(
            "measurement.velocity",
            MEASURED,
            "Velocities: those of the states, or by an observer from positions and effort",
            choices=(MEASURED, OBSERVER),
        ),
        Parameter(
            "measurement.observer_bandwidth",
            BANDWIDTH,
            "Bandwidth of the velocity observer",
            "rad/s",
            minimum=1.0,
            maximum=1e4,
        ),
        Parameter(
            "measurement.motor",
            POSITION,
            "Motor side: its position, or the joint's torque sensor (effort of the joint's own name)",
            choices=(POSITION, TORQUE),
        ),
        Parameter(
            "measurement.gear_ratio",
            (1.0,) * n,
            "Turns of the motor in the states for one of q_m; negative: the other way round",
            "1",
            constraint="not 0",
        ),
    ]


def measurement(values: Values, robot: Robot) -> Measurement:
    """What the states of the robot hold by these values; raises ParameterError for what does not go together."""
    velocity, motor = str(values["measurement.velocity"]), str(values["measurement.motor"])
    ratio = vector(values, "measurement.gear_ratio", robot.n)
    return Measurement(robot.n, velocity, motor, ratio, robot.K if motor == TORQUE else None)


def observer(values: Values, robot: Robot) -> VelocityObserver | None:
    """The observer that the values ask for; None where velocities are measured."""
    if values["measurement.velocity"] != OBSERVER:
        return None
    bandwidth = float(values["measurement.observer_bandwidth"])  # type: ignore[arg-type]
    return VelocityObserver(robot, bandwidth, compile=bool(values["compile"]))
