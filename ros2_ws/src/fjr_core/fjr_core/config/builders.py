# SPDX-License-Identifier: Apache-2.0
"""Parameters of both nodes, and the builders of the objects that their values describe."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

from .controller import controller_parameters, gain_values, gains
from .law import robust
from .parameter import Parameter
from .plant import initial_state, plant_parameters
from .reference import reference
from .robot import joints_of, robot, robot_parameters

__all__ = [
    "OwnParameters",
    "all_parameters",
    "controller_parameters",
    "gain_values",
    "gains",
    "initial_state",
    "names_of_others",
    "plant_parameters",
    "reference",
    "robot",
    "robust",
]

OwnParameters = Callable[[int], Sequence[Parameter]]
"""Makes a node's own parameters for n joints: plant_parameters or controller_parameters."""


def all_parameters(own: OwnParameters, given: Mapping[str, object]) -> list[Parameter]:
    """Return all parameters of a node for the given model and joints: those of the robot, then its `own`."""
    return [*robot_parameters(given), *own(joints_of(given))]


@cache
def names_of_others(own: OwnParameters) -> frozenset[str]:
    """Return the names that only parameters of other nodes have: a parameter file of all nodes may hold them."""
    others = {parameter.name for node in (plant_parameters, controller_parameters) for parameter in node(1)}
    return frozenset(others - {parameter.name for parameter in own(1)})
