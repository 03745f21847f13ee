# SPDX-License-Identifier: Apache-2.0
"""Virtual differential passivity based tracking control of flexible-joint robots (v-dPBC), without ROS.

    import fjr_core as fjr
    robot = fjr.single_link(stiffness=31.0)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    run = fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), robot.state(0.5, 0.5, 0, 0), 5.0)

Paper: R. Reyes-Baez, A. van der Schaft, B. Jayawardhana, "Virtual Differential Passivity based Control for
Tracking of Flexible-joints Robots", IFAC LHMNC 2018. Equation numbers in docstrings are its.
"""

from .arms import planar_two_link, single_link
from .bodies import Body
from .certificate import Balance
from .circle import Circle
from .errors import FjrError, GainsError, ParameterError, RobotError, StateError, TrajectoryError
from .gains import PAPER_GAINS, Gains
from .intervals import Record
from .joining import join, shifted
from .limits import JointLimits
from .measurement import Measurement
from .motion_limits import MotionLimits, check_motion
from .multi_sine import MultiSine
from .newton_euler import serial_chain
from .observer import VelocityObserver
from .plant import Plant
from .reference import Reference, Sine
from .references import Hold, PointToPoint, standing
from .robot import Robot
from .sampled_loop import SampledCheck, check, spectral_radius
from .simulate import Trajectory, simulate
from .spline import Spline
from .synthesis import synthesize
from .urdf import robot_from_urdf
from .vdpbc.law import Evaluation, TrackingLaw
from .vdpbc.rate import Rate
from .verdict import Verdict, judge
from .virtual import VirtualSystem

__all__ = [
    "PAPER_GAINS",
    "Balance",
    "Body",
    "Circle",
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
    "Rate",
    "Record",
    "Reference",
    "Robot",
    "RobotError",
    "SampledCheck",
    "Sine",
    "Spline",
    "StateError",
    "TrackingLaw",
    "Trajectory",
    "TrajectoryError",
    "VelocityObserver",
    "Verdict",
    "VirtualSystem",
    "check",
    "check_motion",
    "join",
    "judge",
    "planar_two_link",
    "robot_from_urdf",
    "serial_chain",
    "shifted",
    "simulate",
    "single_link",
    "spectral_radius",
    "standing",
    "synthesize",
]
