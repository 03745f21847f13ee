# SPDX-License-Identifier: Apache-2.0
"""Public names: what dir() shows, and how objects describe themselves."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import fjr_core as fjr
from fuzzing import refused

SOURCES = Path(__file__).parents[2] / "ros2_ws" / "src"
ARM = fjr.planar_two_link()
LAW = fjr.TrackingLaw(ARM, fjr.PAPER_GAINS)
MOTION = fjr.Sine([0.1, 0.2], 1.0)
START = ARM.state(*np.zeros((4, 2)))
RUN = fjr.simulate(fjr.Plant(ARM), LAW, MOTION, START, 0.01, 1e-3)
MANY = np.linspace(-1.0, 1.0, 40)


class Own:
    """A law and a plant of the user."""

    def effort(self, position: np.ndarray, velocity: np.ndarray, jets: np.ndarray) -> np.ndarray:
        return np.zeros(2)

    def derivative(self, x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.zeros(8)


OBJECTS = {
    "Body": fjr.Body(np.eye(3), np.zeros(3), [0, 0, 1], 1.0, np.zeros(3), np.eye(3)),
    "Certificate": fjr.Certificate(LAW),
    "Circle": fjr.Circle([0.1, 0.2], 0.3, 1.0),
    "Diagnosis": fjr.Diagnosis("holding", (), "V decays as proven", {}),
    "Evaluation": LAW.evaluate(START, START, MOTION.jets(0.0)),
    "Gains": fjr.Gains(MANY, MANY, MANY, MANY, MANY, MANY),
    "Hold": fjr.Hold(MANY),
    "JointLimits": fjr.JointLimits(*(np.full(40, v) for v in (-1.0, 1.0, 2.0, 3.0))),
    "Measurement": fjr.Measurement(2, velocity="observer"),
    "MotionLimits": fjr.MotionLimits(-1.0, MANY + 1.0),
    "MultiSine": fjr.MultiSine(np.ones((20, 2)), 1.0),
    "Plant": fjr.Plant(ARM),
    "PointToPoint": fjr.PointToPoint(MANY, -MANY, 2.0),
    "PythonLaw": fjr.PythonLaw(Own(), ARM),
    "PythonPlant": fjr.PythonPlant(Own(), ARM),
    "Rate": LAW.rate(),
    "Record": fjr.Record(
        RUN.t, RUN.x[:, :4], RUN.x[:, 4:], RUN.jets, RUN.u, None, None, None, 1e-3, np.full(2, np.inf)
    ),
    "Robot": ARM,
    "SampledCheck": fjr.check(LAW, 1e-3, configurations=np.zeros((40, 2))),
    "SampledMotion": fjr.SampledMotion(np.arange(40.0), np.zeros((40, 2)), 1e-3),
    "Sine": fjr.Sine(MANY, 1.0),
    "Spline": fjr.Spline(np.arange(40.0), np.zeros((40, 2))),
    "TrackingLaw": LAW,
    "Trajectory": RUN,
    "VelocityObserver": fjr.VelocityObserver(ARM, 100.0),
    "VirtualSystem": fjr.VirtualSystem(ARM),
}
"""An object of each public class."""
MADE = [fjr.transition(MOTION.jets(0.0), 0.0, MOTION, 1.0), fjr.time_shifted(MOTION, 1.0), LAW.gains, ARM.links]
"""Objects that public functions and attributes return."""


def test_an_object_of_each_public_class_is_tried() -> None:
    classes = {name for name in fjr.__all__ if inspect.isclass(getattr(fjr, name))}
    errors = {name for name in classes if issubclass(getattr(fjr, name), Exception)}
    assert classes - errors - {"Reference"} == set(OBJECTS)
    assert all(type(value).__name__ == name for name, value in OBJECTS.items())


@pytest.mark.parametrize("value", [*OBJECTS.values(), *MADE], ids=lambda value: type(value).__name__)
def test_repr_is_one_line_that_begins_with_the_type(value: object) -> None:
    text = repr(value)
    assert text.startswith(f"{type(value).__name__}(")
    assert "\n" not in text
    assert "array([" not in text
    assert len(text) < 250


def test_repr_names_joints_law_and_gains() -> None:
    assert repr(fjr.PAPER_GAINS) == "Gains(Lambda_l=10, Pi_l=20, K_ld=0.6, Lambda_m=15, Pi_m=60, K_md=0.3)"
    assert repr(fjr.single_link(stiffness=31.0)) == "Robot(1 joint, K=31, M_m=0.004)"
    assert repr(LAW).startswith("TrackingLaw(2 joints, CheckedGains(Lambda_l=10,")
    assert repr(MOTION) == "Sine(amplitude=[0.1, 0.2], frequency=1)"
    assert repr(RUN).startswith("Trajectory(2 joints, 11 instants, 0 to 0.01 s,")


def test_dir_shows_the_public_names_only() -> None:
    assert dir(fjr) == sorted(fjr.__all__)
    assert all(not name.startswith("_") or name == "__version__" for name in dir(fjr))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        fjr.nonsense  # noqa: B018


def test_all_packages_have_the_version_of_fjr_core() -> None:
    versions = {file.parent.name: ElementTree.parse(file).findtext("version") for file in SOURCES.glob("*/package.xml")}
    assert len(versions) == 10
    assert set(versions.values()) == {fjr.__version__}


def never(*_: object) -> float:
    raise AssertionError


OF_LAWS: list[Callable[[Any], object]] = [
    lambda law: fjr.simulate(fjr.Plant(ARM), law, MOTION, START, 0.1, 1e-3),
    lambda law: fjr.check(law, 1e-3),
    lambda law: fjr.spectral_radius(law, 1e-3),
]
OF_REFERENCES: list[Callable[[Any], object]] = [
    lambda reference: fjr.simulate(fjr.Plant(ARM), LAW, reference, START, 0.1, 1e-3),
    lambda reference: fjr.check_motion(reference, fjr.MotionLimits([-1.0, -1.0], 1.0)),
    lambda reference: fjr.transition(np.zeros((5, 2)), 0.0, reference, 1.0),
    lambda reference: fjr.time_shifted(reference, 1.0),
]


OF_ROBOTS: list[Callable[[Any], object]] = [
    lambda robot: fjr.TrackingLaw(robot, fjr.PAPER_GAINS),
    lambda robot: fjr.PythonLaw(Own(), robot),
    fjr.Plant,
    fjr.VirtualSystem,
    lambda robot: fjr.VelocityObserver(robot, 100.0),
    lambda robot: fjr.synthesize(robot, 1.0, 1.0),
]


@pytest.mark.parametrize("other", [LAW, fjr.single_link, None], ids=["law", "function", "None"])
@pytest.mark.parametrize("use", OF_ROBOTS)
def test_something_else_than_a_robot_is_refused_by_kind(use: Callable[[Any], object], other: object) -> None:
    with pytest.raises(fjr.RobotError, match=r"^robot is a .*; expected a robot, e\.g\. fjr\.single_link\(\)$"):
        use(other)


def test_a_reference_without_bounds_of_its_motion_is_refused_by_what_it_lacks() -> None:
    class Mine:
        n, jets = 2, MOTION.jets

    refused(fjr.TrajectoryError, lambda: OF_REFERENCES[1](Mine()), "reference is a Mine without motion_bounds")


def test_limits_and_a_certificate_are_made_of_what_they_need() -> None:
    own = fjr.JointLimits([-1.0, -1.0], [1.0, 1.0], [1.0, 1.0], [1.0, 1.0])
    refused(fjr.TrajectoryError, lambda: fjr.check_motion(MOTION, own), "limits is a JointLimits; expected a fjr.Mo")
    fjr.check_motion(MOTION, fjr.MotionLimits.of(own, 2))
    refused(fjr.StateError, lambda: fjr.Certificate(ARM), "law is a Robot; expected v-dPBC, a fjr.TrackingLaw")
    body = fjr.Body(np.eye(3), np.zeros(3), [0, 0, 1], [2.0], np.zeros(3), np.eye(3))
    assert fjr.serial_chain([body]).M_l([0.0]) == 1.0


def test_a_run_shorter_than_a_step_is_refused() -> None:
    plant = fjr.Plant(ARM)
    refused(fjr.StateError, lambda: fjr.simulate(plant, LAW, MOTION, START, 5e-4, 1e-3), "at least one step of 0.001 s")
    assert len(fjr.simulate(plant, LAW, MOTION, START, 1e-3, 1e-3).t) == 2


@pytest.mark.parametrize("other", [never, lambda x: x, fjr.Robot, 1.0], ids=["function", "lambda", "class", "number"])
def test_something_else_than_a_law_or_a_reference_is_refused_by_kind(other: object) -> None:
    for use in OF_LAWS:
        with pytest.raises(fjr.StateError, match=r"^law is (a|the) .*; expected a law of fjr_core"):
            use(other)
    for use in OF_REFERENCES:
        with pytest.raises(fjr.TrajectoryError, match=r"^reference is (a|the) .*; expected a reference"):
            use(other)
