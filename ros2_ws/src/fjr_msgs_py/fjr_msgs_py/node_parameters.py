# SPDX-License-Identifier: Apache-2.0
"""A node's parameters from their table in fjr_core.config, with descriptors, units and ranges."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType
from rclpy.node import Node

from fjr_core import ParameterError, config, robot_file
from fjr_core.parameters import Parameter, Value, complete, unknown

_FOREIGN = ("use_sim_time", "start_type_description_service", "qos_overrides.")

_TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}
_LIST_TYPES = {float: ParameterType.PARAMETER_DOUBLE_ARRAY, str: ParameterType.PARAMETER_STRING_ARRAY}


class ParameterNode(Node):
    """A node whose parameters are a table of fjr_core.config; `values` holds them, checked.

    Given values win over those of the robot file that they name, and these over defaults; paths of files are
    relative to the current directory.
    Raises ParameterError for a value that does not fit. Every parameter is read-only: none changes while
    the node runs. A name that no parameter has is reported and ignored.
    """

    def __init__(self, name: str, own: Callable[[int], Sequence[Parameter]], **node_kwargs: Any) -> None:
        """own: config.plant_parameters or config.controller_parameters; node_kwargs: as rclpy's Node."""
        try:
            super().__init__(name, automatically_declare_parameters_from_overrides=True, **node_kwargs)
        except ValueError as error:  # rclpy cannot declare a list without entries
            raise ParameterError(f"a parameter is an empty list; expected at least one entry ({error})") from None
        try:
            self.values: dict[str, Any] = self._checked_values(own)
            self.build()
        except Exception:
            self.destroy_node()  # a node that cannot be built leaves the graph at once
            raise

    def build(self) -> None:
        """Make publishers, subscriptions and the rest from the checked values; raises FjrError."""

    def _checked_values(self, own: Callable[[int], Sequence[Parameter]]) -> dict[str, Any]:
        own_names = (name for name in self.get_parameters_by_prefix("") if not name.startswith(_FOREIGN))
        overrides = {name: self.get_parameter(name).value for name in own_names}
        given = robot_file.merged(overrides, self.get_name(), Path.cwd())
        parameters = config.all_parameters(own, given)
        for sentence in unknown(parameters, given):
            self.get_logger().warning(sentence)
        values = dict(complete(parameters, given))
        for parameter in parameters:
            self._declare(parameter, values[parameter.name], parameter.name in overrides)
        return values

    def _declare(self, parameter: Parameter, value: Value, overridden: bool) -> None:
        """Declare a parameter with its descriptor, in place of the bare one that rclpy made for an override."""
        if overridden:
            self.undeclare_parameter(parameter.name)
        listed = list(value) if isinstance(value, tuple) else value
        self.declare_parameter(parameter.name, listed, descriptor(parameter), ignore_override=True)


def descriptor(parameter: Parameter) -> ParameterDescriptor:
    """The ROS descriptor of a parameter."""
    message = ParameterDescriptor(name=parameter.name, description=_description(parameter), read_only=True)
    kind = type(parameter.default)
    if isinstance(parameter.default, tuple):
        message.type = _LIST_TYPES[type(parameter.default[0])]
    else:
        message.type = _TYPES[kind]
    bounded = math.isfinite(parameter.minimum) and math.isfinite(parameter.maximum)
    if kind is float and bounded:
        message.floating_point_range = [FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)]
    if kind is int and bounded:
        message.integer_range = [IntegerRange(from_value=int(parameter.minimum), to_value=int(parameter.maximum))]
    message.additional_constraints = _constraints(parameter)
    return message


def _constraints(parameter: Parameter) -> str:
    if parameter.choices:
        return f"one of {', '.join(parameter.choices)}"
    if math.isfinite(parameter.minimum) and not math.isfinite(parameter.maximum):
        return f"finite, at least {parameter.minimum}"
    example = parameter.default[0] if isinstance(parameter.default, tuple) else parameter.default
    return parameter.constraint or ("finite" if isinstance(example, float) else "")


def _description(parameter: Parameter) -> str:
    return f"{parameter.description} [{parameter.unit}]" if parameter.unit else parameter.description
