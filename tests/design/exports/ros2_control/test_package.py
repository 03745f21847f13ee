# SPDX-License-Identifier: Apache-2.0
"""The exported package: the step gives Python's efforts bit by bit; its files, interfaces and names."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

import fjr_core as fjr
from design.exports.c_program import scenario
from design.exports.ros2_control.exported_package import exported, replayed
from fjr_core.config.scenario import parse_scenario
from fjr_core.runtime.events import ERRORS, KINDS, WARNINGS
from fjr_core.runtime.library import HEADER, text
from fjr_design.exports.ros2_control.package import export_package, package_name_of

PACKAGE = "two_link_ros2_control"
MORE = {
    "torque": "{measurement.velocity: observer, measurement.motor: torque}",
    "transition": "{start.join_time: 0.1, start.ramp_time: 0.05, limits.effort_rate: [500.0], on_stop: gravity_hold}",
}
"""Parameters of scenarios by name for parts of the step that the scenarios of test_export_c.py do not use."""


@pytest.mark.parametrize("name", MORE)
def test_step_gives_the_efforts_of_python_with(name: str, tmp_path: Path) -> None:
    made = parse_scenario(name, f"/**: {{ros__parameters: {MORE[name]}}}")
    assert replayed(exported(made, tmp_path), package_name_of(name)) == (200, 0)


def test_urdf_holds_every_interface_that_the_controller_claims() -> None:
    texts = export_package(scenario("two_link"), PACKAGE, 1)
    robot = ElementTree.fromstring(texts[f"urdf/{PACKAGE}.urdf"])
    (system,) = robot.findall("ros2_control")
    assert system.findtext("hardware/plugin") == f"{PACKAGE}/ElasticArm"
    found = {f"{c.get('name')}/{i.get('name')}" for c in system for i in c.findall("state_interface")}
    efforts = {f"{c.get('name')}/{i.get('name')}" for c in system for i in c.findall("command_interface")}
    parameters = yaml.safe_load(texts["config/controllers.yaml"])["tracking_controller"]["ros__parameters"]
    sides = [*parameters["joints"], *parameters["motors"]]
    assert {f"{side}/{kind}" for side in sides for kind in ("position", "velocity")} <= found
    assert parameters["stamp_interface"] in found
    assert efforts == {f"{joint}/effort" for joint in parameters["command_joints"]}
    joints = {joint.get("name") for joint in robot.findall("joint")}
    assert {joint.get("name") for joint in system.findall("joint")} <= joints


def test_event_kinds_are_those_of_the_step_in_order() -> None:
    body = re.search(r"enum fjr_kind \{(.*?)\}", text(HEADER), re.DOTALL)
    assert body is not None
    names = [name.removeprefix("FJR_").lower().replace("_", " ") for name in re.findall(r"FJR_\w+", body[1])][:-1]
    kinds = [kind.replace(":", "").removesuffix(" than the last") for kind in KINDS]
    assert names == kinds
    assert {*ERRORS, *WARNINGS} <= set(KINDS)


@pytest.mark.parametrize(
    ("scenario", "package"),
    [("arm-7 B", "arm_7_b_ros2_control"), ("7", "robot_7_ros2_control"), ("ä", "robot_ros2_control")],
)
def test_package_is_named_after_the_scenario(scenario: str, package: str) -> None:
    assert package_name_of(scenario) == package


@pytest.mark.parametrize("package", ["", "Arm", "a-b", "7a", "a__b", "a_", "a" * 61])
def test_invalid_package_names_are_refused(package: str) -> None:
    with pytest.raises(fjr.ParameterError, match=r"package is '.*'; expected a lower-case letter"):
        export_package(scenario("paper_k31"), package)
