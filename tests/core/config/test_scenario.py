# SPDX-License-Identifier: Apache-2.0
"""Shipped robots and scenarios are valid; files are read as ROS reads them; a name that no node reads is refused."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import ros_yaml
from fjr_core.config.nodes import CONTROLLER, NODES, PLANT, all_parameters, own_parameters
from fjr_core.config.parameter import refuse_unknown
from fjr_core.config.scenario import Scenario, load_scenario, parse_scenario
from fuzzing import refused

BRINGUP = Path(__file__).parents[3] / "ros2_ws" / "src" / "fjr_bringup"
SCENARIOS = sorted(path.stem for path in (BRINGUP / "scenarios").glob("*.yaml"))
ARMS = ("two_link", "arm7")


@pytest.fixture(scope="module", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Resolve package://fjr_bringup to the source folder."""
    prefix = tmp_path_factory.mktemp("installed")
    (prefix / "share").mkdir()
    (prefix / "share" / "fjr_bringup").symlink_to(BRINGUP)
    with pytest.MonkeyPatch.context() as patched:
        patched.setenv("AMENT_PREFIX_PATH", str(prefix))
        yield


def load(name: str) -> Scenario:
    return load_scenario(BRINGUP / "scenarios" / f"{name}.yaml")


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_shipped_scenario_is_valid_and_both_nodes_have_the_same_robot(name: str) -> None:
    scenario = load(name)
    assert scenario.warnings == ()
    assert scenario.sample_period == 1e-3
    for matrix in ("M_m", "K", "D_l", "D_m", "B_m"):
        np.testing.assert_array_equal(getattr(scenario.robot, matrix), getattr(scenario.plant.robot, matrix))


ROBOTS = {
    "paper_k31": fjr.single_link,
    "paper_k3p1": lambda: fjr.single_link(stiffness=3.1),
    "two_link": fjr.planar_two_link,
}


@pytest.mark.parametrize("name", ROBOTS)
def test_robot_files_equal_the_defaults_of_the_closed_forms(name: str) -> None:
    robot, expected = load(name).robot, ROBOTS[name]()
    q_l = np.full(robot.n, 0.7)
    for matrix in ("M_m", "K", "D_l", "D_m", "B_m"):
        np.testing.assert_array_equal(getattr(robot, matrix), getattr(expected, matrix))
    np.testing.assert_array_equal(robot.M_l(q_l), expected.M_l(q_l))
    np.testing.assert_array_equal(robot.grad_P_l(q_l), expected.grad_P_l(q_l))


@pytest.mark.parametrize("name", ARMS)
def test_arms_converge_within_3_s_from_equilibrium_and_respect_their_limits(name: str) -> None:
    """At the start the springs carry the weight, but for the rounded numbers of the file."""
    scenario = load(name)
    n = scenario.robot.n
    at_start = scenario.plant.derivative(scenario.x0, np.zeros(n))
    np.testing.assert_allclose(at_start[: 3 * n], 0.0, atol=1e-4)
    run = scenario.simulate(3.5)
    error = np.abs(run.x[:, :n] - run.jets[:, 0]).max(axis=1)
    assert np.max(error[run.t >= 3.0]) < 1e-4
    if scenario.robot.limits is not None:
        assert np.all(np.abs(run.u).max(axis=0) < scenario.robot.limits.effort)


def test_document_round_trips() -> None:
    document = {
        "/**": {
            "ros__parameters": {
                "a": ["1e-3", "on", "plain", "", "a: b", "#"],
                "b": [1e-7, 0.1, 1e22, 3.0],
                "c": "<a>\n  \"x\" 'y'\n\n\ttab: [1]\n</a>\n",
                "d": True,
                "e": "<a> trailing \nblanks\n",
                "f": 3,
            }
        }
    }
    assert ros_yaml.parse(ros_yaml.dump(document)) == document
    assert ros_yaml.parse("a: 2024-12-24") == {"a": "2024-12-24"}  # a date is text
    shared = [1.0, 2.0]
    assert "&" not in ros_yaml.dump({"a": shared, "b": shared})  # ROS reads no aliases


@pytest.mark.parametrize("values", [{"a": 1, "a.b": 2}, {"a.b": 2, "a.b.c": 1}])
def test_a_name_that_is_a_prefix_of_another_is_rejected(values: dict[str, int]) -> None:
    with pytest.raises(fjr.ParameterError, match="which has a value"):
        ros_yaml.tree_of(values)


NAMES = {node: {each.name for each in all_parameters(own_parameters(node), {})} for node in NODES}
EVERY = sorted(set().union(*NAMES.values()))


def misspelled(name: str) -> str:
    """Return the name with two letters of its last word exchanged, or one left out if that changes nothing."""
    k = (name.rfind(".") + 1 + len(name)) // 2
    swapped = f"{name[: k - 1]}{name[k]}{name[k - 1]}{name[k + 1 :]}"
    return swapped if swapped != name else name[:k] + name[k + 1 :]


@pytest.mark.parametrize("name", EVERY)
def test_each_misspelled_parameter_of_a_file_is_refused_with_a_suggestion(name: str) -> None:
    wrong = misspelled(name)
    assert wrong not in EVERY
    said = f"unknown parameter '{wrong}'"
    refused(fjr.ParameterError, lambda: refuse_unknown(NAMES[PLANT], [wrong], NAMES[CONTROLLER]), said, "did you mean")
    refused(fjr.ParameterError, lambda: parse_scenario("mine", f"/**: {{ros__parameters: {{{wrong}: 1.0}}}}"), said)


REFUSED = {
    "{robot: {joint_stiffness: [3.1]}}": "has 'robot' at the top, where only sections of nodes are read",
    "{joints: [a]}": "has 'joints' at the top",
    "{/**: {ros__parameters: {}}, limits: {effort: [1.0]}}": "has 'limits' at the top",
    "{/**: {joints: [a]}}": "section '/**' has no 'ros__parameters' mapping",
    "{/**/fjr_controler: {ros__parameters: {}}}": "section '/**/fjr_controler', of another node; did you mean",
    "{fjr_plnat: {ros__parameters: {}}, /**: {ros__parameters: {}}}": "did you mean '/**/fjr_plant'",
    "{/left/fjr_plant: {ros__parameters: {}}}": "has no section of these nodes (/left/fjr_plant); expected /**,",
    "{driver: {ros__parameters: {}}}": "has no section of these nodes (driver)",
    "{/**/fjr_plant: {ros__parameters: {gains.K_ld: [1.0]}}}": "'gains.K_ld'; it is a parameter of another node",
    "{/**: {ros__parameters: {limits.efort: [1.0], gain.K_ld: [1.0]}}}": "'gain.K_ld' (and limits.efort); did you mean",
    "{/**: {ros__parameters: {camera: {rate: 5.0}}}}": "'camera.rate'; expected one of, or a name in,",
    "{fjr_plant: {ros__parameters: {joints: [a]}}, fjr_controller: {ros__parameters: {joints: [b]}}}": "the same",
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_no_node_would_read_is_refused_in_one_sentence(text: str) -> None:
    refused(fjr.ParameterError, lambda: parse_scenario("mine", text), REFUSED[text])


def test_sections_of_other_nodes_and_namespaces_are_left_to_them() -> None:
    scenario = parse_scenario(
        "mine",
        "{/**: {ros__parameters: {robot.joint_stiffness: [3.1]}}, driver: {ros__parameters: {limits.efort: 1}},"
        " /left/fjr_plant: {ros__parameters: {publish_rate: 5.0}}, right: {arm: {driver: {ros__parameters: {a: 1}}}}}",
    )
    assert scenario.robot.K.tolist() == [[3.1]]
    assert scenario.sample_period == parse_scenario("default", "{}").sample_period


def test_a_node_starts_without_scipy() -> None:
    """To import SciPy takes half of the time in which a node starts."""
    code = "import sys, fjr_core.config.scenario; print([name for name in sys.modules if name.startswith('scipy')])"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    assert subprocess.check_output([sys.executable, "-c", code], env=environment, text=True).strip() == "[]"
