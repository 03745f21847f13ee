# SPDX-License-Identifier: Apache-2.0
"""Invalid parameters are refused in one sentence before the node is created."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rclpy.lifecycle import TransitionCallbackReturn

import fjr_core as fjr
from fjr_controller.controller_node import ControllerNode
from fjr_plant.plant_node import PlantNode
from nodes.harness import Ros
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

NAN = float("nan")
URDF = {
    "joints": JOINTS,
    "robot__model": "urdf",
    "robot__urdf": two_link_urdf(),
    "robot__joint_stiffness": STIFFNESS,
    "robot__motor_inertia": MOTOR_INERTIA,
}
BAD: list[tuple[str, dict[str, Any], str]] = [
    ("plant", {"robot__joint_stiffness": [31]}, "write 31.0"),
    ("plant", {"robot__joint_stiffness": [-31.0]}, "expected a positive definite matrix"),
    ("plant", {"robot__motor_inertia": [0.0]}, "robot.motor_inertia.*positive definite"),
    ("plant", {"robot__link_inertia": [-0.031]}, "link_inertia is .*expected positive"),
    ("plant", {"robot__link_damping": [-0.1]}, "robot.link_damping.*positive semidefinite"),
    ("plant", {"robot__input_gain": [0.0]}, "robot.input_gain.*invertible"),
    ("plant", {"robot__joint_stiffness": [1.0, 2.0]}, "has 2 entries; expected 1"),
    ("plant", {"robot__joint_stiffness": [NAN]}, "holds nan; expected a finite number"),
    ("plant", {"robot__joint_stiffness": "stiff"}, "expected a list"),
    ("plant", {"robot__model": "scara"}, "'scara'; expected one of single_link, planar_two_link"),
    ("plant", {"joints": ["a", "b"]}, "expected the names of 1, as single_link has"),
    ("plant", {"robot__model": "planar_two_link", "joints": ["a", "a"]}, "holds 'a' twice"),
    ("plant", {"publish_rate": 1000}, "write 1000.0"),
    ("plant", {"publish_rate": -1.0}, "-1.0 Hz; expected 1.0 to"),
    ("plant", {"publish_rate": NAN}, "finite"),
    ("plant", {"inner_steps": 0}, "expected 1 to"),
    ("plant", {"inner_steps": 4.0}, "expected an integer"),
    ("plant", {"integrator": "euler"}, "expected one of rk4, implicit_midpoint"),
    ("plant", {"lockstep": 1}, "expected true or false"),
    ("plant", {"initial_link_position": [0.5, 0.5]}, "has 2 entries; expected 1"),
    ("plant", {"initial_link_position": [float("inf")]}, "finite"),
    ("plant", {"command_timeout": 0.0}, "expected 0.001 to"),
    ("controller", {"gains__Pi_l": [-20.0]}, "gains.Pi_l.*positive definite"),
    ("controller", {"gains__Lambda_l": [-10.0]}, r"gains.Lambda_l.*condition \(32\)"),
    ("controller", {"gains__Gamma_m": [-1.0]}, r"condition \(41\)"),
    ("controller", {"gains__K_ld": [0.6, 0.6, 0.6]}, "has 3 entries; expected 1"),
    ("controller", {"gains__K_ld": [1]}, "write 1.0"),
    ("controller", {"reference__type": "square"}, "expected one of sine"),
    ("controller", {"reference__amplitude": [1.0, 1.0]}, "has 2 entries; expected 1"),
    ("controller", {"reference__frequency": [-1.0]}, "expected at least 0.0 rad/s"),
    ("controller", {"state_timeout": -0.5}, "expected 0.001 to"),
    ("controller", {"compile": 1}, "expected true or false"),
    ("plant", {"robot__file": "/there/is/no.yaml"}, "robot.file.*cannot read robot file /there/is/no.yaml"),
    ("plant", {"robot__file": "package://nobody/arm.yaml"}, "robot.file.*'nobody'.*AMENT_PREFIX_PATH"),
    ("plant", {"robot__model": "urdf"}, "'joints' is not given"),
    ("plant", {"robot__model": "urdf", "joints": ["a"]}, "'robot.urdf' is not given"),
    ("controller", {"robot__model": "urdf", "joints": ["a"], "robot__urdf": "<a/>"}, "joint_stiffness' is not given"),
    ("controller", {**URDF, "robot__joint_stiffness": [1.0]}, "robot.joint_stiffness' has 1 entries; expected 2"),
    ("controller", {**URDF, "robot__gravity": [0.0, -9.81]}, "robot.gravity' has 2 entries; expected 3"),
    ("controller", {**URDF, "joints": ["shoulder", "elbw"]}, "no joint 'elbw'.*did you mean 'elbow'"),
    ("plant", {**URDF, "robot__locked_joints": ["knee"]}, "robot.urdf.*'knee'"),
]


@pytest.mark.parametrize(("kind", "parameters", "sentence"), BAD)
def test_invalid_parameters_are_refused(ros: Ros, kind: str, parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(fjr.FjrError, match=sentence) as caught:
        getattr(ros, kind)(**parameters)
    assert "\n" not in str(caught.value)


def test_an_unknown_parameter_is_refused_with_a_suggestion(ros: Ros) -> None:
    with pytest.raises(fjr.ParameterError, match="unknown parameter 'publish_rat'; did you mean 'publish_rate'"):
        ros.start(PlantNode, publish_rat=500.0)


@pytest.mark.parametrize("kind", [PlantNode, ControllerNode])
@pytest.mark.parametrize("section", ["/**", "OWN", "/OWN", "/**/OWN"])
def test_a_misspelled_limit_in_a_file_is_refused(ros: Ros, tmp_path: Path, section: str, kind: type) -> None:
    named = section.replace("OWN", "fjr_plant" if kind is PlantNode else "fjr_controller")
    with pytest.raises(fjr.ParameterError, match=r"'limits.efort'; did you mean 'limits.effort'\?"):
        ros.start(kind, in_file(tmp_path, f"{named}: {{ros__parameters: {{limits.efort: [1.0]}}}}"))


@pytest.mark.parametrize("kind", [PlantNode, ControllerNode])
def test_parameters_of_other_nodes_in_a_shared_file_are_left_to_them(
    ros: Ros, tmp_path: Path, kind: type, capfd
) -> None:
    text = (
        "/**: {ros__parameters: {publish_rate: 500.0, limits.effort: [9.0], robot_description: x, camera.gain: 1}}\n"
        "/left/driver: {ros__parameters: {limits.efort: [1.0]}}\n"
        "camera: {ros__parameters: {publish_rat: 5.0}}\n"
    )
    node = ros.start(kind, in_file(tmp_path, text))
    assert node.values["joints"] == ("joint1",)
    said = capfd.readouterr().err
    assert "parameter 'camera.gain' is ignored" in said
    assert "parameter 'robot_description' is ignored" in said
    assert "publish_rate" not in said


def test_a_controller_without_autostart_waits_for_known_parameters_only(ros: Ros, tmp_path: Path, capfd) -> None:
    arguments = in_file(tmp_path, "/**: {ros__parameters: {autostart: false, limits.efort: [1.0]}}")
    node = ros.start(ControllerNode, arguments)
    assert "waiting for valid parameters: unknown parameter 'limits.efort'" in capfd.readouterr().err
    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    from rclpy.parameter import Parameter

    (result,) = node.set_parameters([Parameter("limits.efort")])
    assert result.successful, result.reason
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS


def in_file(folder: Path, text: str) -> list[str]:
    path = folder / "given.yaml"
    path.write_text(text, encoding="utf-8")
    return ["--ros-args", "--params-file", str(path)]


def test_running_node_refuses_another_robot(ros: Ros) -> None:
    from rclpy.parameter import Parameter

    node = ros.controller()
    (result,) = node.set_parameters([Parameter("robot.link_damping", value=[0.7])])
    assert not result.successful
    assert result.reason == "parameter 'robot.link_damping' can be set only while the node is unconfigured"
    assert list(node.get_parameter("robot.link_damping").value) == [0.2]
