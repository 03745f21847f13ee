# SPDX-License-Identifier: Apache-2.0
"""Parameters of the controller node: measurement.*, the certificate and its diagnosis, and its topics."""

from __future__ import annotations

from ..model.robot import Robot
from ..monitoring.thresholds import TOLERANCE, Axes
from ..numerics.parameter_field import declared
from ..runtime.measurement_model import OBSERVER, TORQUE, Measurement
from ..runtime.velocity_observer import VelocityObserver
from .law import GAINS, LAW, ROBUST
from .parameter import VECTOR, Parameter, Values, names, number, read, table, vector
from .process import process_parameters
from .reference import MOTION, reference_parameters
from .safety import safety_parameters

AUTOSTART = Parameter("autostart", True, "Configure and activate at the start, without a request")
AUXILIARY_RATE = Parameter(
    "auxiliary_rate",
    100.0,
    "Rate of ~/reference, ~/tracking_error and ~/certificate in real time; 0: every sample, as in simulated time",
    "Hz",
    minimum=0.0,
    maximum=1e5,
)
CERTIFICATE = Parameter(
    "certificate", True, "Publish the certificate of the law for each state, and its diagnosis on /diagnostics"
)
CERTIFICATE_TOLERANCE = Parameter(
    "certificate_tolerance",
    TOLERANCE,
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


def auxiliary_period(values: Values, simulated: bool) -> float:
    """Return the time between two messages on the topics for observers [s]; 0: one per sample."""
    rate = number(values, AUXILIARY_RATE.name)
    return 0.0 if simulated or rate == 0 else 1 / rate


def controller_parameters(n: int) -> list[Parameter]:
    """Return the controller node's own parameters for n joints."""
    first = (*GAINS.values(), *LAW, *ROBUST.values())
    last = (*MOTION, AUTOSTART, AUXILIARY_RATE, CERTIFICATE, CERTIFICATE_TOLERANCE)
    return [
        *(parameter.for_joints(n) for parameter in first),
        *reference_parameters(n),
        *measurement_parameters(n),
        *safety_parameters(n),
        *(parameter.for_joints(n) for parameter in last),
        *process_parameters(),
    ]


def measurement_parameters(n: int) -> list[Parameter]:
    """Return the parameters for n joints."""
    return [*table(_MEASUREMENT, n), OBSERVER_BANDWIDTH]


def measurement(values: Values, robot: Robot) -> Measurement:
    """Return the measurement model of the values; raises ParameterError if they contradict each other."""
    settings = read(_MEASUREMENT, values, robot.n)
    return Measurement(robot.n, **settings, K=robot.K if settings["motor"] == TORQUE else None)


def observer(values: Values, robot: Robot) -> VelocityObserver | None:
    """Return the velocity observer of the values, or None if velocities are measured."""
    if values["measurement.velocity"] != OBSERVER:
        return None
    return VelocityObserver(robot, number(values, OBSERVER_BANDWIDTH.name), compile=bool(values["compile"]))


def axes(values: Values, robot: Robot) -> Axes:
    """Return the joints with the units and tolerances of the diagnosis; raises ParameterError."""
    units = tuple(each.position for each in robot.units)
    return Axes(names(values, "joints"), units, vector(values, CERTIFICATE_TOLERANCE.name, robot.n))
