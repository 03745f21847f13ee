# SPDX-License-Identifier: Apache-2.0
"""What a named parameter is: default, type, unit, range; and the one sentence when a value does not fit."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..errors import FjrError, ParameterError
from ..numerics.checks import Array

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]
Values = Mapping[str, Value]
Built = TypeVar("Built")


@dataclass(frozen=True)
class Parameter:
    """A parameter of a node: `default` has the type that values must have; bounds are inclusive."""

    name: str
    default: Value
    description: str
    unit: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: tuple[str, ...] = ()
    constraint: str = ""
    """What else must hold, in words; checked where the values meet."""
    required: bool = False
    """Whether it must be given; `default` tells the type only."""
    dynamic: bool = False
    """Whether it may change while the node runs."""
    infinite: bool = False
    """Whether entries may be infinite, which means "no limit given"."""

    def standard(self) -> Value:
        """The default, or ParameterError where there is none."""
        if self.required:
            unit = f" [{self.unit}]" if self.unit else ""
            raise ParameterError(f"parameter '{self.name}' is not given; expected: {self.description}{unit}")
        return self.default

    def check(self, value: object) -> Value:
        """Return `value` as this parameter's type (sequences as tuples), or raise ParameterError."""
        if isinstance(self.default, tuple):
            return self._check_list(value)
        return self._check_one(value, self.default)

    def _check_list(self, value: object) -> tuple[float, ...] | tuple[str, ...]:
        assert isinstance(self.default, tuple)
        kind = _kind(self.default[0])
        if value is None or isinstance(value, (str, bool, int, float)) or not isinstance(value, Iterable):
            raise ParameterError(f"parameter '{self.name}' is {value!r}; expected a list, each entry {kind}")
        entries = tuple(self._check_one(entry, self.default[0]) for entry in value)
        if not entries:
            raise ParameterError(f"parameter '{self.name}' is an empty list; expected at least one entry")
        return entries  # type: ignore[return-value]

    def _check_one(self, value: object, like: object) -> Value:
        if type(value) is not type(like):
            hint = f": write {value}.0" if type(value) is int and type(like) is float else ""
            raise ParameterError(
                f"parameter '{self.name}' holds {value!r} ({_kind(value)}); expected {_kind(like)}{hint}"
            )
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            self._check_range(value)
        if self.choices and value not in self.choices:
            raise ParameterError(f"parameter '{self.name}' is {value!r}; expected one of {', '.join(self.choices)}")
        return value  # type: ignore[return-value]

    def _check_range(self, value: float) -> None:
        if not math.isfinite(value) and not (self.infinite and math.isinf(value)):
            raise ParameterError(f"parameter '{self.name}' holds {value}; expected a finite number")
        if not self.minimum <= value <= self.maximum:
            unit = f" {self.unit}" if self.unit else ""
            raise ParameterError(
                f"parameter '{self.name}' holds {value}{unit}; expected {_range(self.minimum, self.maximum)}{unit}"
            )


def complete(parameters: Sequence[Parameter], given: Mapping[str, object]) -> dict[str, Value]:
    """Checked values of all `parameters`: the given ones, defaults for the rest; raises ParameterError."""
    return {p.name: p.check(given[p.name]) if p.name in given else p.standard() for p in parameters}


def unknown(parameters: Sequence[Parameter], given: Iterable[str]) -> list[str]:
    """One sentence for each given name that no parameter has."""
    names = [p.name for p in parameters]
    sentences = []
    for name in sorted(set(given) - set(names)):
        close = difflib.get_close_matches(name, names, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        sentences.append(f"unknown parameter '{name}' is ignored{hint}")
    return sentences


def names(values: Values, name: str) -> tuple[str, ...]:
    """A parameter that is a list of strings."""
    value = values[name]
    return tuple(str(entry) for entry in value) if isinstance(value, tuple) else (str(value),)


def vector(values: Values, name: str, n: int, each: str = "one per joint") -> Array:
    """A parameter as (n,); raises ParameterError for another length."""
    array = np.asarray(values[name], dtype=float)
    if array.shape != (n,):
        raise ParameterError(f"parameter '{name}' has {array.size} entries; expected {n}, {each}")
    return array


def matrix(values: Values, name: str, n: int) -> Array:
    """A parameter as (n, n), from n entries of the diagonal or n*n by rows; raises ParameterError otherwise."""
    array = np.asarray(values[name], dtype=float)
    if array.size == n:
        return np.diag(array)
    if array.size != n * n:
        entries = "1, for the one joint" if n == 1 else f"{n}, one per joint, or {n * n}, a matrix by rows"
        raise ParameterError(f"parameter '{name}' has {array.size} entries; expected {entries}")
    return array.reshape(n, n)


def named(name_of: Callable[[str], str], build: Callable[[], Built]) -> Built:
    """Run `build`; an error that begins with a symbol becomes one about the parameter `name_of(symbol)`."""
    try:
        return build()
    except ParameterError:
        raise
    except FjrError as error:
        symbol = str(error).split(" ", 1)[0]
        raise ParameterError(f"parameter '{name_of(symbol)}': {error}") from None


def _kind(value: object) -> str:
    kinds = {bool: "true or false", int: "an integer", float: "a floating-point number", str: "a string"}
    return kinds.get(type(value), f"a {type(value).__name__}")


def _range(minimum: float, maximum: float) -> str:
    if maximum == math.inf:
        return f"at least {minimum}"
    return f"at most {maximum}" if minimum == -math.inf else f"{minimum} to {maximum}"
