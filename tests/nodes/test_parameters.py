# SPDX-License-Identifier: Apache-2.0
"""Parameters of the nodes: from the command line and from files, checked, dumped, changed; options of own code."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.node import Node
from rclpy.parameter import Parameter

import fjr_core as fjr
import own_code
from fjr_controller.controller_node import SUCCESS, ControllerNode
from fjr_core.config import ros_yaml
from fjr_core.config.scenario import parse_scenario
from fjr_core.robust.law import RobustLaw
from fjr_msgs_py.node.parameters import parameter_rules
from fjr_plant.plant_node import PlantNode
from nodes.harness import Peer, Ros, stamped
from nodes.managed import Manager
from system.executables import scenario

BAD: list[tuple[str, dict[str, Any], str]] = [
    ("plant", {"robot__joint_stiffness": [31]}, "write 31.0"),
    ("plant", {"robot__model": "planar_two_link", "joints": ["a", "a"]}, "holds 'a' twice"),
    ("plant", {"publish_rate": -1.0}, "-1.0 Hz; expected 1.0 to"),
    ("plant", {"inner_steps": 4.0}, "expected an integer"),
    ("plant", {"lockstep": 1}, "expected true or false"),
    ("controller", {"gains__Lambda_l": [-10.0]}, r"gains.Lambda_l.*condition \(32\)"),
    ("plant", {"publish_rat": 500.0}, "unknown parameter 'publish_rat'; did you mean 'publish_rate'"),
    ("controller", {"law__type": "pd_gravity", "law__tuned": False, "law__natural_frequency": 0.1}, "law.type"),
]
"""One of each kind; the others are in tests/core."""


@pytest.mark.parametrize(("kind", "parameters", "sentence"), BAD)
def test_invalid_parameters_are_refused(ros: Ros, kind: str, parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(fjr.FjrError, match=sentence) as caught:
        ros.start({"plant": PlantNode, "controller": ControllerNode}[kind], **parameters)
    assert "\n" not in str(caught.value)


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
    assert node.has_parameter("publish_rate") == (kind is PlantNode)
    assert node.has_parameter("limits.effort") == (kind is ControllerNode)
    said = capfd.readouterr().err
    assert "parameter 'camera.gain' is ignored" in said
    assert "parameter 'robot_description' is ignored" in said
    assert "publish_rate" not in said


SECTIONS_READ = {
    "": False,
    "hello": False,
    "/fjr_controler: {ros__parameters: {state_timeout: 0.5}}": False,
    "/right/fjr_controller: {ros__parameters: {state_timeout: 0.5}}": False,
    "/**/fjr_plant: {ros__parameters: {publish_rate: 500.0}}": False,
    "/**: {ros__parameters: {state_timeout: 0.5}}": True,
    "/**/fjr_controller: {ros__parameters: {state_timeout: 0.5}}": True,
    "/*/fjr_controller: {ros__parameters: {state_timeout: 0.5}}": True,
    "left/fjr_controller: {ros__parameters: {state_timeout: 0.5}}": True,
    "/left: {fjr_controller: {ros__parameters: {state_timeout: 0.5}}}": True,
}
"""Files by whether they give the controller in the namespace /left a parameter."""


@pytest.mark.parametrize("text", SECTIONS_READ)
def test_a_file_without_a_section_of_the_node_is_named(ros: Ros, tmp_path: Path, text: str, capfd) -> None:
    words = in_file(tmp_path, text.replace("0.5", "0.25"))
    node = ros.start(ControllerNode, [*words, "-r", "__ns:=/left", "-p", "autostart:=false"])
    assert (node.get_parameter("state_timeout").value == 0.25) == SECTIONS_READ[text]
    said = "given.yaml has no section of /left/fjr_controller ("
    assert (said not in capfd.readouterr().err) == SECTIONS_READ[text]


def test_a_controller_without_autostart_waits_for_known_parameters_only(ros: Ros, tmp_path: Path, capfd) -> None:
    arguments = in_file(tmp_path, "/**: {ros__parameters: {autostart: false, limits.efort: [1.0]}}")
    node = ros.start(ControllerNode, arguments)
    assert "waiting for valid parameters: unknown parameter 'limits.efort'" in capfd.readouterr().err
    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
    (result,) = node.set_parameters([Parameter("limits.efort")])
    assert result.successful, result.reason
    assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS


def in_file(folder: Path, text: str) -> list[str]:
    path = folder / "given.yaml"
    path.write_text(text, encoding="utf-8")
    return ["--ros-args", "--params-file", str(path)]


HOLD = ("-p", "reference.type:=hold")
FILE = ("--params-file", scenario("paper_k31"))


def controller(ros: Ros, *arguments: str) -> ControllerNode:
    return ros.start(ControllerNode, ["--ros-args", "-p", "autostart:=false", *arguments])


HOLDS = {
    "after a scenario": (*FILE, *HOLD),
    "after an arm's": ("--params-file", scenario("arm7"), *HOLD),
    "in a namespace": ("-r", "__ns:=/left", *FILE, *HOLD),
    "the last of two": ("-p", "reference.type:=sine", *HOLD, "-p", "fjr_plant:reference.type:=sine"),
}


@pytest.mark.parametrize("case", HOLDS)
def test_a_parameter_of_the_command_line_overrides_files(ros: Ros, case: str) -> None:
    assert controller(ros, *HOLDS[case]).get_parameter("reference.type").value == "hold"


def test_a_parameter_before_the_file_that_sets_it_is_refused(ros: Ros) -> None:
    with pytest.raises(fjr.ParameterError, match=r"'-p reference.type:=hold' has no effect: .* sets .* to 'sine'"):
        controller(ros, *HOLD, *FILE)


def test_node_section_applies_and_a_conflicting_bare_parameter_is_refused(ros: Ros, tmp_path: Path) -> None:
    text = "/**/fjr_controller:\n  ros__parameters: {compile: false, reference: {type: sine}}\n"
    _, *file = in_file(tmp_path, text)
    assert controller(ros, *file).get_parameter("reference.type").value == "sine"
    named = controller(ros, *file, "-p", "fjr_controller:reference.type:=hold")
    assert named.get_parameter("reference.type").value == "hold"
    for words in ((*file, *HOLD), (*HOLD, *file)):
        with pytest.raises(fjr.ParameterError, match="reference.type:=hold' has no effect.*section /\\*\\*"):
            controller(ros, *words)


def test_rules_are_read_only_between_ros_args_and_its_end() -> None:
    words = ["-p", "a:=1", "--ros-args", "--param", "b:=[1.0]", "-r", "x:=y", "-p", "n:c:=on", "--", "-p", "d:=1"]
    found = [(rule.node, rule.name, rule.value) for rule in parameter_rules(words)]
    assert found == [("", "b", [1.0]), ("n", "c", True)]


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
    b: [1e-1, 1E3, 1.5e2, +2e-1, -.5e+1, 0.3, .inf]
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
    seen = seen_by_rcl(ros, HAND_WRITTEN, tmp_path / "hand.yaml")
    assert repr(sorted(seen.items())) == repr(sorted(values.items()))  # with their types: 1E3 is no integer


def dump(ros: Ros, peer: Peer, node: str) -> list[ParameterMessage]:
    names = peer.call(ListParameters, f"{node}/list_parameters").result.names
    values = peer.call(GetParameters, f"{node}/get_parameters", names=names).values
    return [ParameterMessage(name=name, value=value) for name, value in zip(names, values, strict=True)]


def load(ros: Ros, peer: Peer, node: str, parameters: list[ParameterMessage]) -> list[str]:
    """Set parameters as `ros2 param load` does; return the reasons of refusals."""
    results = peer.call(SetParameters, f"{node}/set_parameters", parameters=parameters).results
    return [result.reason for result in results if not result.successful]


def other(name: str, value: Any) -> list[ParameterMessage]:
    return [Parameter(name, value=value).to_parameter_msg()]


@pytest.mark.parametrize("lockstep", [True, False])
def test_a_plant_loads_its_own_dump(ros: Ros, peer: Peer, lockstep: bool) -> None:
    ros.plant(lockstep=lockstep)
    parameters = dump(ros, peer, "fjr_plant")
    assert len(parameters) > 40
    assert load(ros, peer, "fjr_plant", parameters) == []
    assert dump(ros, peer, "fjr_plant") == parameters
    (refused,) = load(ros, peer, "fjr_plant", other("publish_rate", 500.0))
    assert refused


def test_controller_loads_its_own_dump_in_every_state_without_any_change(ros: Ros, manager: Manager) -> None:
    ros.controller(autostart=False)
    for transition in ("", "configure", "activate"):
        assert not transition or manager.change(transition)
        parameters = dump(ros, manager, "fjr_controller")
        assert len(parameters) > 80
        assert load(ros, manager, "fjr_controller", parameters) == []
        assert dump(ros, manager, "fjr_controller") == parameters
        ros.settle()
        assert not {"gains changed", "settings changed"} & set(manager.kinds())
        refused = load(ros, manager, "fjr_controller", other("state_timeout", 2.5 if transition else 1.5))
        assert bool(refused) == bool(transition)


# A law of the user by its name module:Class, and a motion of a file; docs/own_law.md: a plant.


def test_publishes_the_effort_of_the_law_with_its_options(ros: Ros, peer: Peer) -> None:
    node = ros.controller(law__type="own_code:Pd", law__options__K_p=30.0, law__options__weights=[2.0])
    law = own_code.Pd(fjr.single_link(), K_p=30.0, weights=(2.0,))
    assert node.get_parameter("law.options.K_d").value == 2.0
    assert "or module:Class of your own" in node.describe_parameter("law.type").additional_constraints
    for k in range(3):
        t, position, velocity = 0.001 * k, [0.5, 0.5 + 0.02 * k], [0.1 * k, -0.1 * k]
        command = peer.ask(stamped(t, position, velocity))
        expected = law.effort(np.array(position), np.array(velocity), fjr.Sine(1.0, 1.0).jets(t))
        np.testing.assert_allclose(command.effort, expected, rtol=1e-9)


def test_law_and_options_change_while_the_node_is_unconfigured(ros: Ros) -> None:
    ros.plant(law__type="own_code:Pd", law__options__K_p=30.0)  # ignores the options of the controller
    node = ros.controller(autostart=False, plant__options__damping=1.0)

    def set_one(name: str, value: object) -> tuple[bool, str]:
        (result,) = node.set_parameters([Parameter(name, value=value)])
        return result.successful, result.reason

    for name, value in {"law.type": "own_code:Pd", "law.options.K_p": 30.0}.items():
        assert set_one(name, value) == (True, "")
    assert "unknown parameter 'law.option.K_p'" in set_one("law.option.K_p", 30.0)[1]
    assert node.trigger_configure() == SUCCESS
    assert (node.values["law.options.K_p"], node.values["law.options.K_d"]) == (30.0, 2.0)
    done, reason = set_one("law.options.K_p", 40.0)
    assert not done
    assert "'law.options.K_p' can be set only while the node is unconfigured" in reason


def test_a_scenario_builds_the_law_of_the_parameters() -> None:
    text = "/**/fjr_controller:\n  ros__parameters:\n    robust: {residual_gain: [30.0], delay: 0.002, hold: 0.002}\n"
    scenario = parse_scenario("robust", text)
    assert isinstance(scenario.sampled_law, RobustLaw)
    assert scenario.sampled_law.robust.residual_gain == 30.0
    assert scenario.sampled_law.lead == 0.003
    assert scenario.warnings == ("fjr_controller: parameter 'robust.hold' is 0.002 s; the states' period is 0.001 s",)
    assert len(scenario.simulate(0.05).u) == 51
    slow = parse_scenario("slow", text.replace("residual_gain: [30.0], delay: 0.002", "integral_gain: [5.0]"))
    assert slow.warnings == scenario.warnings
    with pytest.raises(fjr.ParameterError, match="parameter 'robust.integral_gain': integral_gain is "):
        parse_scenario("bad", text.replace("residual_gain: [30.0]", "integral_gain: [-1.0]"))
    with pytest.raises(fjr.ParameterError, match="with 'law.type' 'friction_observer': .* of 0"):
        parse_scenario("bad", text.replace("robust:", "law: {type: friction_observer}\n    robust:"))


# A motion from a file, which the controller reads when it is configured.


T = np.arange(1501) / 1000  # s


def test_a_running_node_changes_to_the_file_that_it_read_when_it_was_configured(ros: Ros, tmp_path: Path) -> None:
    file = tmp_path / "motion.csv"
    np.savetxt(file, np.stack([T, np.sin(T)], axis=1), "%.6f", ",", header="time,joint1", comments="")
    node = ros.controller(reference__file__path=str(file))
    file.unlink()
    (result,) = node.set_parameters([Parameter("reference.type", value="file")])
    assert result.successful, result.reason
    (result,) = node.set_parameters([Parameter("reference.file.path", value="other.csv")])
    assert not result.successful
    assert "can be set only while the node is unconfigured" in result.reason
