# SPDX-License-Identifier: Apache-2.0
"""Installed scenarios, and the one file a run really uses: a scenario with what the command line changes."""

from __future__ import annotations

import copy
import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from ament_index_python.packages import PackageNotFoundError, get_package_share_directory

from fjr_core import config
from fjr_core.errors import FjrError, ParameterError
from fjr_core.scenario import CONTROLLER, PLANT

PARAMETERS = {PLANT: config.plant_parameters, CONTROLLER: config.controller_parameters}


class ScenarioError(FjrError):
    """A scenario that does not exist, or a workspace that is not sourced."""


def folder() -> Path:
    """Where the scenarios are installed."""
    try:
        return Path(get_package_share_directory("fjr_bringup"), "scenarios")
    except (PackageNotFoundError, OSError) as error:  # OSError: no workspace is sourced at all
        raise ScenarioError(
            "package fjr_bringup is not installed here: build with `colcon build` in ros2_ws, "
            "then `. ros2_ws/install/setup.sh`"
        ) from error


def known() -> dict[str, Path]:
    """Installed scenarios by name."""
    return {path.stem: path for path in sorted(folder().glob("*.yaml"))}


def summary(path: Path) -> str:
    """First sentence of a scenario's first comment: what it is."""
    lines = path.read_text(encoding="utf-8").splitlines()
    comments = [line.lstrip("# ") for line in lines if line.startswith("#") and "SPDX" not in line]
    return comments[0].partition(". ")[0] if comments else ""


def find(name: str | None) -> Path:
    """Path of a scenario given by installed name or by file; raises ScenarioError naming the known ones."""
    scenarios = known()
    if name in scenarios:
        return scenarios[name]
    if name and Path(name).is_file():
        return Path(name)
    what = f"unknown scenario '{name}'" if name else "no scenario given"
    raise ScenarioError(f"{what}: expected a YAML file or one of {', '.join(scenarios)}")


def parse_assignment(text: str) -> tuple[str, Any]:
    """``name:=value`` with the value as YAML (numbers like 1e-3 included); raises ParameterError."""
    name, separator, value = text.partition(":=")
    if not (name and separator):
        raise ParameterError(f"'{text}' is not an assignment; expected name:=value, e.g. robot.joint_stiffness:=[31.0]")
    try:
        return name.strip(), _numbers(yaml.safe_load(value))
    except yaml.YAMLError as error:
        raise ParameterError(f"value of '{name}' is not valid YAML: {' '.join(str(error).split())}") from None


def with_overrides(path: Path, overrides: Mapping[str, Any]) -> str:
    """Text of the scenario file with parameters changed; unchanged to the byte when there are none."""
    text = path.read_text(encoding="utf-8")
    if not overrides:
        return text
    document = yaml.safe_load(text)
    for name, value in overrides.items():
        for node in _nodes_with(name, document):
            _assign(document, node, name, value)
    header = f"# {path.name} with " + ", ".join(f"{name}:={value}" for name, value in overrides.items())
    return header + "\n" + yaml.safe_dump(document, sort_keys=False)


def _nodes_with(name: str, document: Any) -> list[str]:
    """The nodes that have a parameter; raises ParameterError for a name that none has."""
    by_node = {node: _parameter_names(node, document) for node in PARAMETERS}
    nodes = [node for node, names in by_node.items() if name in names]
    if not nodes:
        everything = sorted(set().union(*by_node.values()))
        close = difflib.get_close_matches(name, everything, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else f": expected one of {', '.join(everything)}"
        raise ParameterError(f"unknown parameter '{name}'{hint}")
    return nodes


def _parameter_names(node: str, document: Any) -> Sequence[str]:
    model = str(_lookup(document, "robot.model") or config.MODEL.default)
    if model not in config.MODELS:
        model = str(config.MODEL.default)
    return [parameter.name for parameter in config.all_parameters(PARAMETERS[node], model)]


def _lookup(document: Any, name: str) -> Any:
    """Value of a parameter in any section of the file, None when absent."""
    for content in document.values():
        tree: Any = content.get("ros__parameters", {})
        for part in name.split("."):
            tree = tree.get(part) if isinstance(tree, dict) else None
        if tree is not None:
            return tree
    return None


def _assign(document: Any, node: str, name: str, value: Any) -> None:
    """Set a parameter in the node's own section, which stands after the shared one and so wins."""
    section = next((key for key in (f"/**/{node}", f"/{node}", node) if key in document), f"/**/{node}")
    tree = document.setdefault(section, {}).setdefault("ros__parameters", {})
    *parents, leaf = name.split(".")
    for part in parents:
        tree = tree.setdefault(part, {})
    tree[leaf] = copy.deepcopy(value)  # shared by both nodes it would become a YAML alias, which ROS refuses


def _numbers(value: Any) -> Any:
    """YAML 1.1 reads 1e-3 as text; ROS 2 reads a number."""
    if isinstance(value, list):
        return [_numbers(entry) for entry in value]
    if isinstance(value, str):
        try:
            return float(value)
        except ValueError:
            return value
    return value
