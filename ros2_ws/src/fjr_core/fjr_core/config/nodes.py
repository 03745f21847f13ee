# SPDX-License-Identifier: Apache-2.0
"""The parameters of both nodes: which node declares which, and what a parameter file gives to each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence, Set
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import ParameterError
from . import robot_file, ros_yaml
from .controller import controller_parameters, with_robot
from .parameter import Parameter, Value, complete, names, option_parameters, refuse_unknown, resembling, unread_options
from .plant import plant_parameters
from .reference import motion_inlined
from .robot import JOINTS, joints_of, robot_parameters

PLANT, CONTROLLER = "fjr_plant", "fjr_controller"
OWN_PARAMETERS = {PLANT: plant_parameters, CONTROLLER: controller_parameters}

OwnParameters = Callable[[int], Sequence[Parameter]]
"""Makes a node's own parameters for n joints: plant_parameters or controller_parameters."""


def all_parameters(own: OwnParameters, given: Mapping[str, object], user_code: bool = True) -> list[Parameter]:
    """Return all parameters of a node for the given model and joints: those of the robot, its `own`, and options.

    user_code: import the classes of the user that the values name; false: leave out their options.
    """
    parameters = own(joints_of(given))
    of_user = option_parameters(parameters, given) if user_code else ()
    return [*robot_parameters(given), *with_robot(parameters, given), *of_user]


@cache
def names_of_others(own: OwnParameters) -> frozenset[str]:
    """Return the names of the parameters that only other nodes declare, without options of classes of the user."""
    return frozenset(each.name for each in _all_of_nodes()) - {each.name for each in own(1)}


def is_of_others(own: OwnParameters, name: str) -> bool:
    """Return whether only other nodes declare a parameter of this name; a shared parameter file may contain it."""
    others = names_of_others(own)
    prefixes = (each.options for each in _all_of_nodes() if each.options and each.name in others)
    return name in others or name.startswith(tuple(prefixes))


@cache
def _all_of_nodes() -> tuple[Parameter, ...]:
    """Return the parameters that the nodes declare for one joint."""
    return tuple(each for own in OWN_PARAMETERS.values() for each in own(1))


def given_to_nodes(document: Any) -> dict[str, dict[str, object]]:
    """Return the values that a parameter file gives to each node; raises ParameterError.

    Sections of other nodes are left out, unless their name resembles one of these nodes' or there are no others.
    """
    given = {node: ros_yaml.values_for(node, document) for node in OWN_PARAMETERS}
    own = {section for node in OWN_PARAMETERS for section in ros_yaml.sections(node)}
    for section in document:
        name = str(section).rpartition("/")[2]
        close = resembling(name, OWN_PARAMETERS, least=0.8)
        if section not in own and close and name != close:
            raise ParameterError(f"has the section '{section}', of another node; did you mean '/**/{close}'?")
    if document and not own & set(document):
        raise ParameterError(
            f"has no section of these nodes ({', '.join(map(str, document))}); expected {ros_yaml.SHARED}, "
            + " or ".join(f"/**/{node}" for node in OWN_PARAMETERS)
        )
    return given


class NodeParameters(NamedTuple):
    """What a node makes of given values: its parameters, complete values by name, and the given names it ignores."""

    declared: list[Parameter]
    values: dict[str, Value]
    ignored: list[str]


def resolve(
    own: OwnParameters,
    given: Mapping[str, object],
    node: str,
    folder: Path,
    for_any_node: Set[str] = frozenset(),
    user_code: bool = True,
) -> NodeParameters:
    """Return what a node makes of the values given to it and of the robot file that they name; raises ParameterError.

    node: whose sections of that file count. folder: where relative paths in `given` start. user_code: see
    all_parameters. Ignored: options where no class of the user is named; names that files give to all nodes
    (for_any_node), if they are of no group of these nodes and resemble no known name.
    """
    merged = robot_file.merged(given, node, folder)
    taken = {name: value for name, value in merged.items() if name in given or not is_of_others(own, name)}
    parameters = all_parameters(own, taken, user_code)
    own_names, others = [each.name for each in parameters], names_of_others(own)
    known = {*own_names, *others}
    groups = {name.partition(".")[0] for name in known}
    foreign = {
        name
        for name in for_any_node - known
        if name.partition(".")[0] not in groups and not resembling(name, known, least=0.8)
    }
    ignored = taken.keys() & (foreign | unread_options(parameters, taken, user_code))
    refuse_unknown(own_names, taken.keys() - ignored, others)
    return NodeParameters(parameters, complete(parameters, taken), sorted(ignored))


def checked_values(
    document: Any, folder: Path, user_code: bool = True
) -> tuple[dict[str, dict[str, Value]], tuple[str, ...]]:
    """Return the complete values of each node that a parameter file in `folder` describes, and the warnings.

    user_code: see all_parameters. Raises ParameterError.
    """
    checked, warnings, by_node = {}, [], given_to_nodes(document)
    private = {section: content for section, content in document.items() if section != ros_yaml.SHARED}
    for node, direct in by_node.items():
        own, alone = OWN_PARAMETERS[node], ros_yaml.values_for(node, private)
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
        inlined = motion_inlined(robot_file.inlined(merged), joints)
        whole[node] = {name: value for name, value in inlined.items() if not is_of_others(OWN_PARAMETERS[node], name)}

    def is_common(name: str, value: object) -> bool:
        """Return whether every node that has the parameter is given this value."""
        return all(
            repr(values[name]) == repr(value)  # nan equals nan, 1 differs from 1.0
            if name in values
            else is_of_others(OWN_PARAMETERS[node], name)
            for node, values in whole.items()
        )

    shared = {name: value for values in whole.values() for name, value in values.items() if is_common(name, value)}
    sections = {ros_yaml.SHARED: shared}
    for node, values in whole.items():
        sections[f"/**/{node}"] = {name: value for name, value in values.items() if name not in shared}
    return {section: {"ros__parameters": ros_yaml.tree_of(values)} for section, values in sections.items() if values}
