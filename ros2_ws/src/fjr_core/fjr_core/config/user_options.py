# SPDX-License-Identifier: Apache-2.0
"""Parameters of classes of the user: the options of their constructors, as law.options.* and plant.options.*."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..errors import ParameterError
from ..files import importing as python_class
from ..law.interfaces import StaticLaw
from .parameter import LIST, SCALAR, Parameter, Value, Values


def option_parameters(parameters: Sequence[Parameter], given: Mapping[str, object]) -> list[Parameter]:
    """Return the options of each class that the given values name, as parameters; raises ParameterError."""
    found = []
    for parameter in parameters:
        name = given.get(parameter.name)
        if parameter.options and python_class.is_named(name):
            found += _options(parameter, str(name))
    return found


def options(parameter: Parameter, values: Values) -> dict[str, Value]:
    """Return the values of the options of the class that this parameter names, by argument of its constructor."""
    names = python_class.option_defaults(str(values[parameter.name]))
    return {name: values[parameter.options + name] for name in names}


def in_python(parameter: Parameter, values: Values) -> str:
    """Return the sentence that a class which this parameter names is not compiled; empty for anything else.

    A class made of expressions, which derives from StaticLaw, is compiled.
    """
    name = str(values[parameter.name])
    if not python_class.is_named(name) or issubclass(python_class.load(name), StaticLaw):
        return ""
    return (
        f"{parameter.name} {name} is evaluated in Python: sweeps and comparisons are not compiled, so they take longer"
    )


def unread_options(parameters: Iterable[Parameter], given: Mapping[str, object], user_code: bool = True) -> set[str]:
    """Return the given options of parameters that name no class; with user_code false, of all parameters."""
    return {
        name
        for parameter in parameters
        if parameter.options and not (user_code and python_class.is_named(given.get(parameter.name)))
        for name in given
        if name.startswith(parameter.options)
    }


def is_option(parameters: Iterable[Parameter], name: str) -> bool:
    """Return whether this is the name of an option of a class that one of the parameters may name."""
    return any(parameter.options and name.startswith(parameter.options) for parameter in parameters)


def _options(parameter: Parameter, name: str) -> list[Parameter]:
    try:
        defaults = python_class.option_defaults(name)
    except ParameterError as error:
        raise ParameterError(f"parameter '{parameter.name}': {error}") from None
    return [_option(parameter, name, argument, default) for argument, default in defaults.items()]


def _option(parameter: Parameter, name: str, argument: str, default: Any) -> Parameter:
    if isinstance(default, np.ndarray):
        default = default.tolist()
    listed = isinstance(default, (list, tuple)) and len(default) > 0
    entries = list(default) if listed else [default]
    if listed and all(isinstance(each, (int, float)) and not isinstance(each, bool) for each in entries):
        entries = [float(each) for each in entries]
    if not all(isinstance(each, (bool, int, float, str)) for each in entries):
        raise ParameterError(
            f"parameter '{parameter.name}': argument '{argument}' of {name} has the default {default!r}; expected "
            "a number, a string, true or false, or a list of numbers or strings"
        )
    value = tuple(entries) if listed else entries[0]
    title = name.partition(python_class.SEPARATOR)[2]
    return Parameter(
        parameter.options + argument, value, f"Option {argument} of {title}", shape=LIST if listed else SCALAR
    )
