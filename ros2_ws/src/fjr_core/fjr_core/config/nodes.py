# SPDX-License-Identifier: Apache-2.0
"""The parameters of both nodes: which node declares which, and what a parameter file gives to each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import NamedTuple

from . import robot_file
from .parameter import Parameter, Value, complete, option_parameters, refuse_unknown, resembling, unread_options
from .robot import MODEL, joints_of, robot_parameters

PLANT, CONTROLLER = "fjr_plant", "fjr_controller"
NODES = (PLANT, CONTROLLER)
JOIN_TIME = 1.0  # s; default of start.join_time for an arm of a URDF

OwnParameters = Callable[[int], Sequence[Parameter]]
"""Makes a node's own parameters for n joints: plant_parameters or controller_parameters."""


@cache
def own_parameters(node: str) -> OwnParameters:
    """Return the function that makes the own parameters of a node; a node imports those of the other if it has to."""
    if node == PLANT:
        from .plant import plant_parameters

        return plant_parameters
    from .controller import controller_parameters

    return controller_parameters


def all_parameters(own: OwnParameters, given: Mapping[str, object], user_code: bool = True) -> list[Parameter]:
    """Return all parameters of a node for the given model and joints: those of the robot, its `own`, and options.

    user_code: import the classes of the user that the values name; false: leave out their options.
    """
    parameters = own(joints_of(given))
    of_user = option_parameters(parameters, given) if user_code else ()
    return [*robot_parameters(given), *_with_robot(parameters, given), *of_user]


def _with_robot(parameters: Sequence[Parameter], given: Mapping[str, object]) -> list[Parameter]:
    """Return the parameters with the defaults for the given robot: an arm of a URDF starts by a transition."""
    if given.get(MODEL.name) != "urdf":
        return list(parameters)
    return [replace(each, default=JOIN_TIME) if each.name == "start.join_time" else each for each in parameters]


@cache
def own_names(own: OwnParameters) -> frozenset[str]:
    """Return the names of a node's own parameters, without options of classes of the user."""
    return frozenset(each.name for each in own(1))


@cache
def names_of_others(own: OwnParameters) -> frozenset[str]:
    """Return the names of the parameters that only other nodes declare, without options of classes of the user."""
    return frozenset(each.name for each in _all_of_nodes()) - own_names(own)


def is_of_others(own: OwnParameters, name: str) -> bool:
    """Return whether only other nodes declare a parameter of this name; a shared parameter file may contain it."""
    if name.startswith("robot.") or name in own_names(own):
        return False
    others = names_of_others(own)
    prefixes = (each.options for each in _all_of_nodes() if each.options and each.name in others)
    return name in others or name.startswith(tuple(prefixes))


@cache
def _all_of_nodes() -> tuple[Parameter, ...]:
    """Return the parameters that the nodes declare for one joint."""
    return tuple(each for node in NODES for each in own_parameters(node)(1))


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
    ignored = unread_options(parameters, taken, user_code)
    known = {each.name for each in parameters}
    unknown = taken.keys() - ignored - known
    ignored |= {name for name in unknown & for_any_node if _is_foreign(name, known | names_of_others(own))}
    refuse(own, known, unknown - ignored)
    return NodeParameters(parameters, complete(parameters, taken), sorted(ignored))


def _is_foreign(name: str, known: Set[str]) -> bool:
    """Return whether a name is of no group of these nodes and resembles no known name."""
    groups = {each.partition(".")[0] for each in known}
    return name.partition(".")[0] not in groups and not resembling(name, known, least=0.8)


def refuse(own: OwnParameters, known: Iterable[str], given: Iterable[str]) -> None:
    """Raise ParameterError for given names that are not known, with a suggestion among those of all nodes."""
    if unknown := set(given) - set(known):
        refuse_unknown(known, unknown, names_of_others(own))
