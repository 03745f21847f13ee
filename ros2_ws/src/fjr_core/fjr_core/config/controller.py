# SPDX-License-Identifier: Apache-2.0
"""Parameters of the controller node: its topics and certificate, measurement.*, and the safety settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import ParameterError
from ..numerics.checks import Array
from ..numerics.parameter_field import declared
from ..runtime.measurement_model import OBSERVER, TORQUE, Measurement
from ..runtime.safety_settings import Settings
from .law import GAINS, LAW, ROBUST
from .parameter import VECTOR, Parameter, Values, names, number, read, table
from .process import process_parameters
from .reference import MOTION, reference_parameters
from .robot import stated_errors

if TYPE_CHECKING:
    from ..model.robot import Robot
    from ..monitoring.external_torque import ContactObserver, ExternalTorqueObserver
    from ..motions.motion_limits import MotionLimits
    from ..runtime.velocity_observer import VelocityObserver

AUTOSTART = Parameter("autostart", True, "Configure and activate at the start, without a request")
AUXILIARY_RATE = Parameter(
    "auxiliary_rate",
    100.0,
    "Rate of the topics ~/reference, ~/tracking_error, ~/external_torque and ~/certificate in real time; 0: every "
    "sample, as in simulated time",
    "Hz",
    minimum=0.0,
    maximum=1e5,
)
TORQUE_BANDWIDTH = Parameter(
    "external_torque_bandwidth",
    50.0,
    "Bandwidth of the estimate of external torques on the links",
    "1/s",
    minimum=0.1,
    maximum=1e4,
)
CERTIFICATE = Parameter(
    "certificate", True, "Publish the certificate of the law for each state, and its diagnosis on /diagnostics"
)
CERTIFICATE_TOLERANCE = Parameter(
    "certificate_tolerance",
    1e-3,
    "Tracking error of each joint up to which a violation counts as 'degraded'",
    "rad",
    minimum=1e-9,
    shape=VECTOR,
)
BANDWIDTH = 150.0  # rad/s; chosen in docs/measurements.md
OBSERVER_BANDWIDTH = Parameter(
    "measurement.observer_bandwidth", BANDWIDTH, "Bandwidth of the velocity observer", "rad/s", minimum=1.0, maximum=1e4
)
_MEASUREMENT = declared(Measurement, "measurement.")
FROM_ROBOT = Parameter(
    "limits.from_robot",
    False,
    "Apply the robot's own limits too (link range and speed, motor effort); the tighter limit counts",
    dynamic=True,
)
_SAFETY = declared(Settings)


def auxiliary_period(values: Values, simulated: bool) -> float:
    """Return the time between two messages on the topics for observers [s]; 0: one per sample."""
    rate = number(values, AUXILIARY_RATE.name)
    return 0.0 if simulated or rate == 0 else 1 / rate


def controller_parameters(n: int) -> list[Parameter]:
    """Return the controller node's own parameters for n joints."""
    first = (*GAINS.values(), *LAW, *ROBUST.values())
    last = (*MOTION, AUTOSTART, AUXILIARY_RATE, TORQUE_BANDWIDTH, CERTIFICATE, CERTIFICATE_TOLERANCE)
    return [
        *(parameter.for_joints(n) for parameter in first),
        *reference_parameters(n),
        *measurement_parameters(n),
        *safety_parameters(n),
        *(parameter.for_joints(n) for parameter in last),
        *process_parameters(),
    ]


def measurement_parameters(n: int) -> list[Parameter]:
    """Return the parameters measurement.* for n joints."""
    return [*table(_MEASUREMENT, n), OBSERVER_BANDWIDTH]


def measurement(values: Values, robot: Robot) -> Measurement:
    """Return the measurement model of the values; raises ParameterError if they contradict each other."""
    settings = read(_MEASUREMENT, values, robot.n)
    if settings["motor"] == TORQUE and robot.curve:
        raise ParameterError(
            f"parameter 'measurement.motor' is 'torque' with a robot.{robot.curve}; expected 'position', or straight "
            "springs"
        )
    return Measurement(robot.n, **settings, K=robot.K if settings["motor"] == TORQUE else None)


def observer(values: Values, robot: Robot) -> VelocityObserver | None:
    """Return the velocity observer of the values, or None if velocities are measured."""
    if values["measurement.velocity"] != OBSERVER:
        return None
    from ..runtime.velocity_observer import VelocityObserver

    return VelocityObserver(robot, number(values, OBSERVER_BANDWIDTH.name), compile=bool(values["compile"]))


def torque_observer(values: Values, robot: Robot) -> ExternalTorqueObserver:
    """Return the observer of external torques of the values."""
    from ..monitoring.external_torque import ExternalTorqueObserver

    return ExternalTorqueObserver(robot, number(values, TORQUE_BANDWIDTH.name), compile=bool(values["compile"]))


def contact_observer(values: Values, robot: Robot) -> ContactObserver:
    """Return the observer of external torques of the values, with the stated errors of the robot."""
    from ..monitoring.external_torque import ContactObserver

    given = number(values, TORQUE_BANDWIDTH.name), stated_errors(values)
    return ContactObserver(robot, *given, compile=bool(values["compile"]))


def safety_parameters(n: int) -> list[Parameter]:
    """Return the parameters of the safety settings for n joints.

    By default only state_timeout, wiring check and recovery are active.
    """
    return [*table(_SAFETY, n), FROM_ROBOT]


def safety(values: Values, robot: Robot) -> Settings:
    """Return the safety settings of the values.

    Raises ParameterError, also if limits.from_robot is true for a robot without limits.
    """
    own = Settings(names(values, "joints"), **read(_SAFETY, values, robot.n), units=robot.units)
    if values[FROM_ROBOT.name] and robot.limits is None:
        raise ParameterError(f"parameter '{FROM_ROBOT.name}' is true; expected false for a robot without limits")
    return own.tightened(robot.limits) if values[FROM_ROBOT.name] else own


def effort_limits(values: Values, robot: Robot) -> Array:
    """Return the effort limits (n,) [N m]: the tighter of limits.effort and those of the robot, infinite for none."""
    return np.asarray(safety(values, robot).tightened(robot.limits).effort)


def motion_limits(settings: Settings, robot: Robot) -> MotionLimits:
    """Return the limits of trajectories: the tighter of settings and robot; raises ParameterError."""
    from ..motions.motion_limits import MotionLimits

    held = settings.tightened(robot.limits)
    position = held.link_position_lower, held.link_position_upper
    return MotionLimits(*position, held.link_velocity, settings.acceleration, robot.units)
