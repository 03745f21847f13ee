# SPDX-License-Identifier: Apache-2.0
"""Messages and parameters of any type to and from plain Python values and YAML text."""

from __future__ import annotations

import re
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from rcl_interfaces.msg import Parameter as ParameterMessage
from rclpy.parameter import Parameter

from fjr_core.config import ros_yaml
from fjr_core.errors import ParameterError


def plain(value: Any) -> Any:
    """Return a message as a dict of its fields in their order; sequences as lists, a byte as an integer."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if value is None or isinstance(value, (str, bool, int, float)):
        return value
    if hasattr(value, "tolist"):  # array.array and NumPy's
        return value.tolist()
    return [plain(entry) for entry in value]


def fill(message: Any, values: Any) -> None:
    """Set the fields of a message that are named in a mapping.

    Raise ParameterError for a wrong name, and for a wrong type if the message was made with check_fields.
    """
    kinds = message.get_fields_and_field_types()
    expected = ", ".join(f"{name} ({kind})" for name, kind in kinds.items()) or "nothing"
    if not isinstance(values, Mapping):
        raise ParameterError(f"{type(message).__name__} is {values!r}; expected a mapping with {expected}")
    for field, value in values.items():
        if field not in kinds:
            raise ParameterError(f"{field!r} is not a field of {type(message).__name__}; expected {expected}")
        try:
            setattr(message, field, _converted(kinds[field], value))
        except (AssertionError, TypeError, OverflowError):
            raise ParameterError(f"{field} is {value!r}; expected {kinds[field]}") from None


def _converted(kind: str, value: Any) -> Any:
    """Return a value as the setter of a field of this type takes it: messages built, integers as floats or a byte."""
    element = re.fullmatch(r"sequence<([^,>]*)(?:, \d+)?>|(.*)\[\d+\]", kind)
    if element and isinstance(value, list):
        return [_converted(element[1] or element[2], entry) for entry in value]
    if "/" in kind and isinstance(value, Mapping):
        package, _, name = kind.partition("/")
        nested = getattr(import_module(f"{package}.msg"), name)(check_fields=True)
        fill(nested, value)
        return nested
    if kind == "octet" and isinstance(value, int) and 0 <= value < 256:
        return bytes([value])
    if kind in ("double", "float") and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value


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
    bare = declared == Parameter.Type.STRING and text[:1] not in ("'", '"')
    value = text if bare else ros_yaml.parse(text)
    if declared in FLOATS:
        value = _converted("sequence<double>" if isinstance(value, list) else "double", value)
    try:
        made = Parameter(name, value=value) if declared == Parameter.Type.NOT_SET else Parameter(name, declared, value)
    except (ValueError, TypeError):
        expected = EXAMPLES.get(declared, "a value or a list of values of one type")
        raise ParameterError(f"{name} is {text}; expected {expected}") from None
    return made.to_parameter_msg()
