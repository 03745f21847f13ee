# SPDX-License-Identifier: Apache-2.0
"""A parameter on the command line takes effect with any parameter file, or the node refuses to start."""

from __future__ import annotations

from pathlib import Path

import pytest

import fjr_core as fjr
from fjr_controller.controller_node import ControllerNode
from fjr_msgs_py.node.command_line import parameter_rules
from fjr_plant.plant_node import PlantNode
from nodes.harness import Ros
from system.executables import scenario

HOLD = ("-p", "reference.type:=hold")
SINE = "ros__parameters: {compile: false, reference: {type: sine}}"
SECTIONS = ("/**/fjr_controller", "/fjr_controller", "fjr_controller")


def controller(ros: Ros, *arguments: str) -> ControllerNode:
    return ros.start(ControllerNode, ["--ros-args", "-p", "autostart:=false", *arguments])


@pytest.mark.parametrize("name", ["paper_k31", "arm7"])
def test_bare_parameter_after_a_scenario_file_overrides_it(ros: Ros, name: str) -> None:
    node = controller(ros, "--params-file", scenario(name), *HOLD)
    assert node.get_parameter("reference.type").value == "hold"


def test_bare_parameter_overrides_in_a_namespace(ros: Ros) -> None:
    node = controller(ros, "-r", "__ns:=/left", "--params-file", scenario("paper_k31"), *HOLD)
    assert node.get_parameter("reference.type").value == "hold"


def test_a_parameter_before_the_file_that_sets_it_is_refused(ros: Ros) -> None:
    with pytest.raises(fjr.ParameterError, match=r"'-p reference.type:=hold' has no effect: .* sets .* to 'sine'"):
        controller(ros, *HOLD, "--params-file", scenario("paper_k31"))


@pytest.mark.parametrize("section", SECTIONS)
@pytest.mark.parametrize("after", [True, False])
def test_node_section_applies_and_a_conflicting_bare_parameter_is_refused(
    ros: Ros, tmp_path: Path, section: str, after: bool
) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(f"{section}:\n  {SINE}\n")
    file = ("--params-file", str(path))
    assert controller(ros, *file).get_parameter("reference.type").value == "sine"
    with pytest.raises(fjr.ParameterError, match="reference.type:=hold' has no effect.*section /\\*\\*"):
        controller(ros, *((*file, *HOLD) if after else (*HOLD, *file)))


def test_parameter_with_node_name_overrides_the_node_section(ros: Ros, tmp_path: Path) -> None:
    path = tmp_path / "own.yaml"
    path.write_text(f"/**/fjr_controller:\n  {SINE}\n")
    node = controller(ros, "--params-file", str(path), "-p", "fjr_controller:reference.type:=hold")
    assert node.get_parameter("reference.type").value == "hold"


def test_last_of_two_parameters_applies_and_those_of_other_nodes_are_ignored(ros: Ros) -> None:
    node = controller(ros, "-p", "reference.type:=sine", *HOLD, "-p", "fjr_plant:reference.type:=sine")
    assert node.get_parameter("reference.type").value == "hold"


@pytest.mark.parametrize("kind", [PlantNode, ControllerNode])
def test_node_reads_only_its_own_parameters_of_a_shared_file(ros: Ros, kind: type, capfd) -> None:
    node = ros.start(kind, ["--ros-args", "--params-file", scenario("paper_k31"), "-p", "compile:=false"])
    assert node.has_parameter("publish_rate") == (kind is PlantNode)
    assert node.has_parameter("gains.K_ld") == (kind is ControllerNode)
    assert "unknown parameter" not in capfd.readouterr().err


def test_rules_are_read_only_between_ros_args_and_its_end() -> None:
    words = ["-p", "a:=1", "--ros-args", "--param", "b:=[1.0]", "-r", "x:=y", "-p", "n:c:=on", "--", "-p", "d:=1"]
    found = [(rule.node, rule.name, rule.value) for rule in parameter_rules(words)]
    assert found == [("", "b", [1.0]), ("n", "c", True)]
