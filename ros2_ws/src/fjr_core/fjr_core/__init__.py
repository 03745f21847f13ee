# SPDX-License-Identifier: Apache-2.0
"""Virtual differential passivity based tracking control of flexible-joint robots (v-dPBC), without ROS.

    import fjr_core as fjr
    robot = fjr.single_link(stiffness=31.0)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    run = fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), robot.state(0.5, 0.5, 0, 0), 5.0)

Paper: R. Reyes-Baez, A. van der Schaft, B. Jayawardhana, "Virtual Differential Passivity based Control for
Tracking of Flexible-joints Robots", IFAC LHMNC 2018. Equation numbers in docstrings are its.
"""

from typing import TYPE_CHECKING, Any

from .version import __version__ as __version__

if TYPE_CHECKING:  # each name is exported, PEP 484
    from .errors import FjrError as FjrError
    from .errors import GainsError as GainsError
    from .errors import ParameterError as ParameterError
    from .errors import RobotError as RobotError
    from .errors import StateError as StateError
    from .errors import TrajectoryError as TrajectoryError
    from .errors import UserCodeError as UserCodeError
    from .extensions.python_code import PythonLaw as PythonLaw
    from .extensions.python_code import PythonPlant as PythonPlant
    from .law.gains import PAPER_GAINS as PAPER_GAINS
    from .law.gains import Gains as Gains
    from .law.rate import Rate as Rate
    from .law.vdpbc import Evaluation as Evaluation
    from .law.vdpbc import TrackingLaw as TrackingLaw
    from .model.closed_form_arms import planar_two_link as planar_two_link
    from .model.closed_form_arms import single_link as single_link
    from .model.joints import JointLimits as JointLimits
    from .model.newton_euler import serial_chain as serial_chain
    from .model.port_hamiltonian import Plant as Plant
    from .model.rigid_arm import Body as Body
    from .model.robot import Robot as Robot
    from .model.virtual_system import VirtualSystem as VirtualSystem
    from .monitoring.certificate import Certificate as Certificate
    from .motions.motion_limits import MotionLimits as MotionLimits
    from .motions.motion_limits import check_motion as check_motion
    from .motions.point_to_point import Circle as Circle
    from .motions.point_to_point import Hold as Hold
    from .motions.point_to_point import PointToPoint as PointToPoint
    from .motions.point_to_point import standing as standing
    from .motions.reference import Reference as Reference
    from .motions.sine import MultiSine as MultiSine
    from .motions.sine import Sine as Sine
    from .motions.spline import SampledMotion as SampledMotion
    from .motions.spline import Spline as Spline
    from .motions.transition import time_shifted as time_shifted
    from .motions.transition import transition as transition
    from .runtime.measurement_model import Measurement as Measurement
    from .runtime.velocity_observer import VelocityObserver as VelocityObserver
    from .simulation.closed_loop import Trajectory as Trajectory
    from .simulation.closed_loop import simulate as simulate
    from .stability.linearization import spectral_radius as spectral_radius
    from .urdf.robot import robot_from_urdf as robot_from_urdf

_HOMES = {
    "fjr_core.errors": "FjrError GainsError ParameterError RobotError StateError TrajectoryError UserCodeError",
    "fjr_core.extensions.python_code": "PythonLaw PythonPlant",
    "fjr_core.law.gains": "PAPER_GAINS Gains",
    "fjr_core.law.rate": "Rate",
    "fjr_core.law.vdpbc": "Evaluation TrackingLaw",
    "fjr_core.model.closed_form_arms": "planar_two_link single_link",
    "fjr_core.model.newton_euler": "serial_chain",
    "fjr_core.model.port_hamiltonian": "Plant",
    "fjr_core.model.rigid_arm": "Body",
    "fjr_core.model.joints": "JointLimits",
    "fjr_core.model.robot": "Robot",
    "fjr_core.model.virtual_system": "VirtualSystem",
    "fjr_core.monitoring.certificate": "Certificate",
    "fjr_core.motions.motion_limits": "MotionLimits check_motion",
    "fjr_core.motions.point_to_point": "Circle Hold PointToPoint standing",
    "fjr_core.motions.reference": "Reference",
    "fjr_core.motions.sine": "MultiSine Sine",
    "fjr_core.motions.spline": "SampledMotion Spline",
    "fjr_core.motions.transition": "time_shifted transition",
    "fjr_core.runtime.measurement_model": "Measurement",
    "fjr_core.runtime.velocity_observer": "VelocityObserver",
    "fjr_core.simulation.closed_loop": "Trajectory simulate",
    "fjr_core.stability.linearization": "spectral_radius",
    "fjr_core.urdf.robot": "robot_from_urdf",
    "fjr_monitor.diagnosis.verdict": "Diagnosis",
    "fjr_monitor.diagnosis.record": "Record",
    "fjr_design.stability.sampled_loop": "SampledCheck check",
    "fjr_monitor.diagnosis.diagnosis": "diagnose",
    "fjr_design.tuning.gain_synthesis": "synthesize",
    "fjr_design.testing": "testing",
}
"""Public names by their module, which is imported when one of them is used; `testing` is a module itself."""
_HOME = {name: module for module, names in _HOMES.items() for name in names.split()}
__all__ = sorted([*_HOME, "__version__"])


def __getattr__(name: str) -> Any:
    """Return the object of a public name.

    Raises MissingPackageError if the name is one of another package, which is not installed.
    """
    if name not in _HOME:
        raise AttributeError(f"module 'fjr_core' has no attribute {name!r}")
    from .files import importing

    module = importing.module(_HOME[name])
    found = globals()[name] = getattr(module, name, module)
    return found


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
