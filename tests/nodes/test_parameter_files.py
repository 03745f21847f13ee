# SPDX-License-Identifier: Apache-2.0
"""fjr_core reads and writes parameter files as rcl does for a node."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from rclpy.node import Node

from fjr_controller.controller_node import ControllerNode
from fjr_core.config import ros_yaml
from fjr_core.config.nodes import OWN_PARAMETERS, self_contained
from fjr_plant.plant_node import PlantNode
from nodes.harness import Ros
from two_link_urdf import JOINTS, MOTOR_INERTIA, STIFFNESS, two_link_urdf

VALUES: dict[str, Any] = {
    "numbers": [1e-7, 0.1, 1e22, 3.0, -5.0],
    "number": 1e-3,
    "whole": 3,
    "truth": False,
    "names": ["1e-3", "on", "plain", "a: b", "#", "3", "true", "null", "~", "x", "y", "N"],
    "text": "<a>\n  \"x\" 'y' é\n\n    indented: [1]\n</a>\n",
    "tabbed": "<a>\n\t<b/>\n</a>",
    "blanks": "<a> \n  <b/>   \n</a>\n\n",
    "branch.leaf": "down",
}
HAND_WRITTEN = """
/**:
  ros__parameters:
    a: 1e-1
    b: [1e-1, 2.5E3]
    c: 0.5
/**/probe:
  ros__parameters:
    c: 1.5e2
    d.e: [x, "y"]
    g: [y, n, true, off]
    d: {f: yes}
/**/other:
  ros__parameters:
    c: 9.0
"""


class Probe(Node):
    """A node that accepts every given parameter."""

    def __init__(self, **node_kwargs: Any) -> None:
        super().__init__("probe", automatically_declare_parameters_from_overrides=True, **node_kwargs)

    def values(self) -> dict[str, Any]:
        own = {name for name in self.get_parameters_by_prefix("") if not name.startswith(("use_sim", "start_type"))}
        return {name: plain(self.get_parameter(name).value) for name in own}


def plain(value: Any) -> Any:
    return value if isinstance(value, (str, bool, int, float)) else list(value)


def seen_by_rcl(ros: Ros, text: str, path: Path) -> dict[str, Any]:
    path.write_text(text, encoding="utf-8")
    return ros.start(Probe, ["--ros-args", "--params-file", str(path)]).values()


def test_written_files_are_read_equally_by_rcl(ros: Ros, tmp_path: Path) -> None:
    text = ros_yaml.dump({"/**/probe": {"ros__parameters": ros_yaml.tree_of(VALUES)}})
    assert seen_by_rcl(ros, text, tmp_path / "written.yaml") == VALUES


def test_files_are_read_as_by_rcl(ros: Ros, tmp_path: Path) -> None:
    values = ros_yaml.values_for("probe", ros_yaml.parse(HAND_WRITTEN))
    assert seen_by_rcl(ros, HAND_WRITTEN, tmp_path / "hand.yaml") == values


@pytest.mark.parametrize("kind", [PlantNode, ControllerNode])
def test_node_starts_from_a_self_contained_scenario_with_embedded_urdf(
    ros: Ros, tmp_path: Path, kind: type[Node]
) -> None:
    (tmp_path / "arm.urdf").write_text(two_link_urdf())
    robot = {
        "robot.model": "urdf",
        "robot.urdf": "arm.urdf",
        "robot.joint_stiffness": STIFFNESS,
        "robot.motor_inertia": MOTOR_INERTIA,
    }
    given = {node: {"joints": JOINTS, "compile": False, **robot} for node in OWN_PARAMETERS}
    path = tmp_path / "scenario.yaml"
    path.write_text(ros_yaml.dump(self_contained(given, tmp_path)))
    (tmp_path / "arm.urdf").unlink()
    node = ros.start(kind, ["--ros-args", "--params-file", str(path)])
    assert node.get_parameter("robot.urdf").value == two_link_urdf()
