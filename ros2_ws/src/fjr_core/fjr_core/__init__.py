# SPDX-License-Identifier: Apache-2.0
"""Virtual differential passivity based tracking control of flexible-joint robots (v-dPBC), without ROS.

    import fjr_core as fjr
    robot = fjr.single_link(stiffness=31.0)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    run = fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), robot.state(0.5, 0.5, 0, 0), 5.0)

Paper: R. Reyes-Baez, A. van der Schaft, B. Jayawardhana, "Virtual Differential Passivity based Control for
Tracking of Flexible-joints Robots", IFAC LHMNC 2018. Equation numbers in docstrings are its.
"""

from typing import Any

from .errors import FjrError, GainsError, ParameterError, RobotError, StateError, TrajectoryError, UserCodeError
from .extensions.python_code import PythonLaw, PythonPlant
from .files import importing
from .law.gains import PAPER_GAINS, Gains
from .law.rate import Rate
from .law.vdpbc import Evaluation, TrackingLaw
from .model.closed_form_arms import planar_two_link, single_link
from .model.newton_euler import serial_chain
from .model.port_hamiltonian import Plant
from .model.rigid_arm import Body
from .model.robot import JointLimits, Robot
from .model.virtual_system import VirtualSystem
from .monitoring.certificate import Certificate
from .motions.motion_limits import MotionLimits, check_motion
from .motions.point_to_point import Circle, Hold, PointToPoint, standing
from .motions.reference import Reference
from .motions.sine import MultiSine, Sine
from .motions.spline import SampledMotion, Spline
from .motions.transition import time_shifted, transition
from .runtime.measurement_model import Measurement
from .runtime.velocity_observer import VelocityObserver
from .simulation.closed_loop import Trajectory, simulate
from .stability.linearization import spectral_radius
from .urdf.robot import robot_from_urdf
from .version import __version__

__all__ = [
    "PAPER_GAINS",
    "Body",
    "Certificate",
    "Circle",
    "Diagnosis",
    "Evaluation",
    "FjrError",
    "Gains",
    "GainsError",
    "Hold",
    "JointLimits",
    "Measurement",
    "MotionLimits",
    "MultiSine",
    "ParameterError",
    "Plant",
    "PointToPoint",
    "PythonLaw",
    "PythonPlant",
    "Rate",
    "Record",
    "Reference",
    "Robot",
    "RobotError",
    "SampledCheck",
    "SampledMotion",
    "Sine",
    "Spline",
    "StateError",
    "TrackingLaw",
    "Trajectory",
    "TrajectoryError",
    "UserCodeError",
    "VelocityObserver",
    "VirtualSystem",
    "__version__",
    "check",
    "check_motion",
    "diagnose",
    "planar_two_link",
    "robot_from_urdf",
    "serial_chain",
    "simulate",
    "single_link",
    "spectral_radius",
    "standing",
    "synthesize",
    "testing",
    "time_shifted",
    "transition",
]

_ELSEWHERE = {
    "Diagnosis": "fjr_monitor.diagnosis.verdict",
    "Record": "fjr_monitor.diagnosis.record",
    "SampledCheck": "fjr_design.stability.sampled_loop",
    "check": "fjr_design.stability.sampled_loop",
    "diagnose": "fjr_monitor.diagnosis.diagnosis",
    "synthesize": "fjr_design.tuning.gain_synthesis",
    "testing": "fjr_design.testing",
}
"""Public names of other packages, each with its module, which is imported on use; `testing` is a module itself."""


def __getattr__(name: str) -> Any:
    """Return the object of a public name of another package.

    Raises MissingPackageError if that package is not installed.
    """
    if name in _ELSEWHERE:
        module = importing.module(_ELSEWHERE[name])
        return getattr(module, name, module)
    raise AttributeError(f"module 'fjr_core' has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
