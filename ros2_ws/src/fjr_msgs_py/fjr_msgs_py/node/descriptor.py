# SPDX-License-Identifier: Apache-2.0
"""ROS descriptors of parameters: type, description with unit, range, constraints, when a value may change."""

from __future__ import annotations

import math

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, ParameterType

from fjr_core.config.parameter import Parameter

_TYPES = {
    bool: ParameterType.PARAMETER_BOOL,
    int: ParameterType.PARAMETER_INTEGER,
    float: ParameterType.PARAMETER_DOUBLE,
    str: ParameterType.PARAMETER_STRING,
}
_LIST_TYPES = {float: ParameterType.PARAMETER_DOUBLE_ARRAY, str: ParameterType.PARAMETER_STRING_ARRAY}


def descriptor(parameter: Parameter, managed: bool) -> ParameterDescriptor:
    """Return the ROS descriptor of a parameter; managed: of a lifecycle node."""
    read_only = not parameter.dynamic and not managed
    description = f"{parameter.description} [{parameter.unit}]" if parameter.unit else parameter.description
    message = ParameterDescriptor(name=parameter.name, description=description, read_only=read_only)
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
    message.additional_constraints = "; ".join(filter(None, [_constraints(parameter), _when(parameter, managed)]))
    return message


def _when(parameter: Parameter, managed: bool) -> str:
    if parameter.dynamic:
        return "may change while the node is active" if managed else "may change while the node runs"
    return "may change only while the node is unconfigured" if managed else "fixed while the node runs"


def _constraints(parameter: Parameter) -> str:
    if parameter.choices:
        return f"one of {parameter.listed_choices}"
    if parameter.infinite:
        least = f"at least {parameter.minimum}, " if math.isfinite(parameter.minimum) else ""
        return f"{least}infinite for none"
    if math.isfinite(parameter.minimum) and not math.isfinite(parameter.maximum):
        return f"finite, at least {parameter.minimum}"
    example = parameter.default[0] if isinstance(parameter.default, tuple) else parameter.default
    return parameter.constraint or ("finite" if isinstance(example, float) else "")
