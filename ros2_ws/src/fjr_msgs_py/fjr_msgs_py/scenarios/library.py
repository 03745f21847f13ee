# SPDX-License-Identifier: Apache-2.0
"""Find scenarios and apply the parameter changes of the command line."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from fjr_core.config import robot_file, ros_yaml
from fjr_core.config.nodes import CONTROLLER, all_parameters, own_parameters
from fjr_core.config.parameter import refuse_unknown
from fjr_core.config.scenario import Scenario, given_to_nodes, parse_scenario, self_contained
from fjr_core.errors import FjrError, ParameterError, prefixed
from fjr_msgs_py.scenarios import installed


class ScenarioError(FjrError):
    """A scenario does not exist, or may not be written."""


def find(name: str | None, kind: str = "scenario") -> Path:
    """Return the path of a scenario or suite given by name or file; raises ScenarioError with the installed ones."""
    there = installed(f"{kind}s")
    if name in there:
        return there[name]
    if name and os.path.isfile(name):
        if kind == "scenario":
            with open(name, "rb") as file:
                start = file.read(1024).lstrip(b"\xef\xbb\xbf \t\r\n")
            if start.startswith(b"<"):
                raise ScenarioError(f"{name} is a URDF or other XML; expected a scenario: fjr new {name} writes one")
        return Path(name)
    what = f"unknown {kind} '{name}'" if name else f"no {kind} given"
    raise ScenarioError(f"{what}: expected a YAML file or one of {', '.join(there)}")


def parse_assignments(assignments: Iterable[str]) -> dict[str, Any]:
    """Return the values of ``name:=value`` assignments: YAML, including numbers such as 1e-3. Raises ParameterError."""
    values = {}
    for text in assignments:
        name, separator, value = text.partition(":=")
        if not (name and separator):
            raise ParameterError(f"'{text}' is no assignment; expected name:=value, e.g. robot.joint_stiffness:=[31.0]")
        with prefixed(f"value of '{name}' "):
            values[name.strip()] = ros_yaml.parse(value)
    return values


def load(name: str | None, assignments: Iterable[str] = (), robot_only: bool = False) -> Scenario:
    """Return a scenario, given by name or by file, with parameters changed; raises ScenarioError or ParameterError.

    robot_only: see as_run.
    """
    return as_run(find(name), parse_assignments(assignments), robot_only)[1]


def as_run(path: Path, overrides: Mapping[str, Any], robot_only: bool = False) -> tuple[str, Scenario]:
    """Return a scenario with parameters changed, as self-contained YAML text and as a Scenario.

    The text includes everything that the file takes from other files. Raises ParameterError with the scenario's name,
    also for the robot file of a URDF, which has neither motion nor gains, unless it may have the robot_only.
    """
    if not robot_only:
        _refuse_robot_file(path, overrides)
    with prefixed(f"scenario {path.stem}: "):
        text = _changed(path.name, ros_yaml.read(path, "scenario"), path.parent, overrides)
        return text, parse_scenario(path.stem, text)


def text_with(name: str, text: str, overrides: Mapping[str, Any]) -> str:
    """Return the text of a self-contained scenario with parameters changed; raises ParameterError."""
    return _changed(name, ros_yaml.parse(text), Path.cwd(), overrides)


def is_robot_file(path: Path) -> bool:
    """Return whether a parameter file holds joints, robot.* and imperfections.* only; raises ParameterError."""
    return all(map(robot_file.is_of_robot, _given_names(path)))


def _given_names(path: Path) -> set[str]:
    """Return the names of the parameters that a file gives to the nodes."""
    with prefixed(f"scenario {path.stem}: "):
        return set().union(*given_to_nodes(ros_yaml.read(path, "scenario")).values())


def _refuse_robot_file(path: Path, overrides: Mapping[str, Any]) -> None:
    """Raise ScenarioError for the robot file of a URDF; it names a scenario of the folder that uses the file."""
    own = (name for name in overrides if str(name).startswith(("gains.", "law.", "reference.")))
    given = {*_given_names(path), *own}
    if robot_file.URDF not in {*given, *overrides} or not all(map(robot_file.is_of_robot, given)):
        return
    hint = f"fjr excite {path} writes one"
    for other in sorted(path.parent.glob("*.yaml"), reverse=True):
        with suppress(ParameterError):
            named = ros_yaml.values_for(CONTROLLER, ros_yaml.read(other, "scenario")).get(robot_file.FILE, "")
            if other != path and (other.parent / str(named)).resolve() == path.resolve():
                hint = f"such as {other}, which names it"
    raise ScenarioError(f"{path} is a robot file, without motion and gains; expected a scenario, {hint}")


def _changed(name: str, document: Any, folder: Path, overrides: Mapping[str, Any]) -> str:
    """Return the text of a parameter file in `folder` with parameters changed, without reference to other files."""
    given = given_to_nodes(document)
    for parameter, value in overrides.items():
        nodes = _nodes_with(parameter, given, folder)
        for node in given:
            if node in nodes or parameter in given[node]:  # the section for all nodes gives it to every node
                given[node] |= robot_file.absolute({parameter: value}, Path.cwd())  # relative to the current folder
    header = f"# {name} as it was run" + (", with" if overrides else "")
    for parameter, value in overrides.items():
        text = " ".join(str(value).split())
        header += f"\n#   {parameter}:={text if len(text) <= 80 else f'{text[:80]} ...'}"
    return f"{header}\n{ros_yaml.dump(self_contained(given, folder))}"


def _nodes_with(name: str, given: Mapping[str, Mapping[str, object]], folder: Path) -> list[str]:
    """Return the nodes that declare a parameter; raises ParameterError if none does."""
    if not isinstance(name, str):
        raise ParameterError(f"the name of a parameter is {name!r}; expected text")
    by_node = {}
    for node, values in given.items():
        parameters = all_parameters(own_parameters(node), robot_file.merged(values, node, folder))
        by_node[node] = [parameter.name for parameter in parameters]
    nodes = [node for node, names in by_node.items() if name in names]
    if not nodes:
        refuse_unknown(set().union(*by_node.values()), [name])
    return nodes
