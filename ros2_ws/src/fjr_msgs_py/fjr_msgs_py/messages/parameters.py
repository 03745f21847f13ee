# SPDX-License-Identifier: Apache-2.0
"""Convert text to a parameter message of the type that a node declares."""

from __future__ import annotations

from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.parameter import Parameter

from fjr_core.config import ros_yaml
from fjr_core.errors import ParameterError

EXAMPLES = {
    Parameter.Type.BOOL: "true or false",
    Parameter.Type.INTEGER: "an integer",
    Parameter.Type.DOUBLE: "a number",
    Parameter.Type.DOUBLE_ARRAY: "a list of numbers, e.g. [0.5]",
    Parameter.Type.INTEGER_ARRAY: "a list of integers, e.g. [1]",
    Parameter.Type.BOOL_ARRAY: "a list such as [true, false]",
    Parameter.Type.STRING_ARRAY: "a list of texts, e.g. [joint1]",
}
FLOATS = (Parameter.Type.DOUBLE, Parameter.Type.DOUBLE_ARRAY)


def parameter_message(name: str, kind: int, text: str) -> ParameterMessage:
    """Return a parameter whose value is YAML text of a type (rcl_interfaces/ParameterType; NOT_SET: as the YAML says).

    Raise ParameterError if the text is not of this type.
    """
    declared = Parameter.Type(kind)
    value = text if declared == Parameter.Type.STRING else ros_yaml.parse(text)
    if declared == Parameter.Type.STRING and text[:1] in ("'", '"'):
        value = ros_yaml.parse(text)
    if declared in FLOATS:
        value = _as_floats(value)
    try:
        made = Parameter(name, value=value) if declared == Parameter.Type.NOT_SET else Parameter(name, declared, value)
    except (ValueError, TypeError):
        expected = EXAMPLES.get(declared, "a value or a list of values of one type")
        raise ParameterError(f"{name} is {text}; expected {expected}") from None
    return made.to_parameter_msg()


def parameter_value(message: ParameterMessage) -> Any:
    """Return the value of a parameter message; a list for an array."""
    value = Parameter.from_parameter_msg(message).value
    return list(value) if hasattr(value, "__len__") and not isinstance(value, str) else value


def _as_floats(value: Any) -> Any:
    """Return integers, also those in a list, as floats; anything else as it is."""
    if isinstance(value, list):
        return [_as_floats(entry) for entry in value]
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value
