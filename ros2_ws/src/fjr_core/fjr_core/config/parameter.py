# SPDX-License-Identifier: Apache-2.0
"""Tables of parameters, checked values, and the arrays that builders read from them.

The options of a constructor of a class of the user are parameters, too: law.options.* and plant.options.*.
"""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from ..errors import FjrError, ParameterError, prefixed
from ..files import importing
from ..numerics.checks import Array
from ..numerics.parameter_field import LIST, MATRIX, POINT, ROWS, SCALAR, VECTOR, Parameter, Value

Values = Mapping[str, Value]
Declarations = Mapping[str, Parameter]
"""Parameters by the argument that takes their value: of a dataclass by `declared`, or written out for a function."""
Built = TypeVar("Built")


def table(declarations: Declarations, n: int) -> list[Parameter]:
    """Return the declared parameters of a robot with n joints."""
    return [parameter.for_joints(n) for parameter in declarations.values()]


def read(declarations: Declarations, values: Values, n: int) -> dict[str, Any]:
    """Return the arguments that the values give, by the shape of each parameter; raises ParameterError.

    Arrays are (n,) for VECTOR, (n, n) for MATRIX, (m, n) for ROWS and (3,) for POINT.
    """
    return {argument: _READERS[each.shape](values, each.name, n) for argument, each in declarations.items()}


def complete(parameters: Sequence[Parameter], given: Mapping[str, object]) -> dict[str, Value]:
    """Return checked values of all `parameters`: the given ones, else defaults; raises ParameterError."""
    return {p.name: p.check(given[p.name]) if p.name in given else p.standard() for p in parameters}


def refuse_unknown(known: Iterable[str], given: Iterable[str], others: Iterable[str] = ()) -> None:
    """Raise ParameterError for given names that are not known, with a suggestion for the first.

    others: names that only other nodes know, which are suggested, too.
    """
    known, others = set(known), set(others)
    unknown = sorted(set(given) - known)
    if not unknown:
        return
    first, everything = unknown[0], sorted(known | others)
    close = resembling(first, everything)
    groups = dict.fromkeys(each.partition(".")[0] for each in everything)
    hint = f"did you mean '{close}'?" if close else f"expected one of, or a name in, {', '.join(groups)}"
    if first in others:
        hint = "it is a parameter of another node"
    more = f" (and {', '.join(unknown[1:])})" if unknown[1:] else ""
    raise ParameterError(f"unknown parameter '{first}'{more}; {hint}")


def resembling(name: str, known: Iterable[str], least: float = 0.6) -> str:
    """Return the known name that resembles this one most, with at least this similarity of 1; "" if none does."""
    return next(iter(difflib.get_close_matches(name, known, n=1, cutoff=least)), "")


def names(values: Values, name: str) -> tuple[str, ...]:
    """Return a parameter that is a list of strings."""
    value = values[name]
    return tuple(str(entry) for entry in value) if isinstance(value, tuple) else (str(value),)


def number(values: Values, name: str) -> float:
    """Return a parameter that is a number."""
    value = values[name]
    assert isinstance(value, (int, float))
    return float(value)


def vector(values: Values, name: str, n: int, each: str = "one per joint") -> Array:
    """Return a parameter as (n,); raises ParameterError for another length."""
    array = np.asarray(values[name], dtype=float)
    if array.shape != (n,):
        raise ParameterError(f"parameter '{name}' has length {array.size}; expected {n}, {each}")
    return array


def matrix(values: Values, name: str, n: int) -> Array:
    """Return a parameter as (n, n), from n diagonal entries or n*n by rows; raises ParameterError otherwise."""
    array = np.asarray(values[name], dtype=float)
    if array.size == n:
        return np.diag(array)
    if array.size != n * n:
        entries = "1, for the one joint" if n == 1 else f"{n}, one per joint, or {n * n}, a matrix by rows"
        raise ParameterError(f"parameter '{name}' has length {array.size}; expected {entries}")
    return array.reshape(n, n)


def rows(values: Values, name: str, n: int) -> Array:
    """Return a parameter of m*n entries as (m, n); raises ParameterError otherwise."""
    array = np.asarray(values[name], dtype=float)
    if array.size % n:
        raise ParameterError(f"parameter '{name}' has length {array.size}; expected a multiple of {n}, by rows")
    return array.reshape(-1, n)


def named(name_of: Callable[[str], str], build: Callable[[], Built]) -> Built:
    """Run `build`; turn an error that begins with a symbol into one about the parameter `name_of(symbol)`."""
    try:
        return build()
    except ParameterError:
        raise
    except FjrError as error:
        symbol = str(error).split(" ", 1)[0]
        raise ParameterError(f"parameter '{name_of(symbol)}': {error}") from None


_READERS: dict[str, Callable[[Values, str, int], Any]] = {
    SCALAR: lambda values, name, _n: values[name],
    LIST: lambda values, name, _n: values[name],
    VECTOR: vector,
    MATRIX: matrix,
    ROWS: rows,
    POINT: lambda values, name, _n: vector(values, name, 3, "its x, y and z"),
}


def option_parameters(parameters: Sequence[Parameter], given: Mapping[str, object]) -> list[Parameter]:
    """Return the options of each class that the given values name, as parameters; raises ParameterError."""
    found = []
    for parameter in parameters:
        name = given.get(parameter.name)
        if parameter.options and importing.is_named(name):
            with prefixed(f"parameter '{parameter.name}': "):
                defaults = importing.option_defaults(str(name))
            found += [_option(parameter, str(name), *each) for each in defaults.items()]
    return found


def options(parameter: Parameter, values: Values) -> dict[str, Value]:
    """Return the values of the options of the class that this parameter names, by argument of its constructor."""
    names = importing.option_defaults(str(values[parameter.name]))
    return {name: values[parameter.options + name] for name in names}


def in_python(parameter: Parameter, values: Values) -> str:
    """Return the sentence that a class which this parameter names is not compiled; empty for anything else.

    A class made of expressions, which derives from StaticLaw, is compiled.
    """
    name = str(values[parameter.name])
    if not importing.is_named(name):
        return ""
    from ..law.interfaces import StaticLaw

    if issubclass(importing.load(name), StaticLaw):
        return ""
    return f"{parameter.name} {name} is evaluated in Python: sweeps and comparisons are not compiled and take longer"


def unread_options(parameters: Iterable[Parameter], given: Mapping[str, object], user_code: bool = True) -> set[str]:
    """Return the given options of parameters that name no class; with user_code false, of all parameters."""
    return {
        name
        for parameter in parameters
        if parameter.options and not (user_code and importing.is_named(given.get(parameter.name)))
        for name in given
        if name.startswith(parameter.options)
    }


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
    title = name.partition(importing.SEPARATOR)[2]
    return Parameter(
        parameter.options + argument, value, f"Option {argument} of {title}", shape=LIST if listed else SCALAR
    )
