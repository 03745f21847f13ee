# SPDX-License-Identifier: Apache-2.0
"""What a parameter file gives to each node: its values, checked, and a file of them that needs no other one."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import ParameterError
from . import robot_file, ros_yaml
from .nodes import NODES, is_of_others, own_parameters, resolve
from .parameter import Value, complete, names, resembling
from .robot import JOINTS


def given_to_nodes(document: Any) -> dict[str, dict[str, object]]:
    """Return the values that a parameter file gives to each node; raises ParameterError.

    Sections of other nodes are left out, unless their name resembles one of these nodes' or there are no others.
    """
    given = {node: ros_yaml.values_for(node, document) for node in NODES}
    own = {section for node in NODES for section in ros_yaml.sections(node)}
    for section in document:
        name = str(section).rpartition("/")[2]
        close = resembling(name, NODES, least=0.8)
        if section not in own and close and name != close:
            raise ParameterError(f"has the section '{section}', of another node; did you mean '/**/{close}'?")
    if document and not own & set(document):
        raise ParameterError(
            f"has no section of these nodes ({', '.join(map(str, document))}); expected {ros_yaml.SHARED}, "
            + " or ".join(f"/**/{node}" for node in NODES)
        )
    return given


def checked_values(
    document: Any, folder: Path, user_code: bool = True
) -> tuple[dict[str, dict[str, Value]], tuple[str, ...]]:
    """Return the complete values of each node that a parameter file in `folder` describes, and the warnings.

    user_code: see all_parameters. Raises ParameterError.
    """
    checked, warnings, by_node = {}, [], given_to_nodes(document)
    private = {section: content for section, content in document.items() if section != ros_yaml.SHARED}
    for node, direct in by_node.items():
        own, alone = own_parameters(node), ros_yaml.values_for(node, private)
        given = {name: value for name, value in direct.items() if name in alone or not is_of_others(own, name)}
        found = resolve(own, given, node, folder, user_code=user_code)
        checked[node] = found.values
        warnings += [f"{node}: parameter '{name}' is ignored: there is no class with options" for name in found.ignored]
    return checked, tuple(warnings)


def self_contained(given: Mapping[str, Mapping[str, object]], folder: Path) -> dict[str, Any]:
    """Return a parameter file of the values given to each node that needs no other file: robot, URDF, motion.

    Values that the nodes share are in the section /**, which is also the section of `-p` on a command line.
    Relative paths in `given` start at `folder`. Raises ParameterError.
    """
    whole = {}
    for node, values in given.items():
        merged = robot_file.merged(values, node, folder)
        joints = names(complete([JOINTS], merged), JOINTS.name)
        inlined = robot_file.motion_inlined(robot_file.inlined(merged), joints)
        whole[node] = {name: value for name, value in inlined.items() if not is_of_others(own_parameters(node), name)}

    def is_common(name: str, value: object) -> bool:
        """Return whether every node that has the parameter is given this value."""
        return all(
            repr(values[name]) == repr(value)  # nan equals nan, 1 differs from 1.0
            if name in values
            else is_of_others(own_parameters(node), name)
            for node, values in whole.items()
        )

    shared = {name: value for values in whole.values() for name, value in values.items() if is_common(name, value)}
    sections = {ros_yaml.SHARED: shared}
    for node, values in whole.items():
        sections[f"/**/{node}"] = {name: value for name, value in values.items() if name not in shared}
    return {section: {"ros__parameters": ros_yaml.tree_of(values)} for section, values in sections.items() if values}
