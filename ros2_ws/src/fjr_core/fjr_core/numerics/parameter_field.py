# SPDX-License-Identifier: Apache-2.0
"""Declare a parameter once: name, default, description, unit, range and shape, at the field that holds its value."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

from ..errors import ParameterError
from ..files.importing import is_named

Value = bool | int | float | str | tuple[float, ...] | tuple[str, ...]

SCALAR, LIST, VECTOR, MATRIX, ROWS, POINT = "scalar", "list", "vector", "matrix", "rows", "point"
"""Shapes: one value; a list as given; n entries; n or n*n entries; m*n entries; three coordinates."""
_SHAPE_TEXT = {MATRIX: ", n entries or n*n by rows", ROWS: ", m*n entries: m rows of n"}
_METADATA = "parameter"


@dataclass(frozen=True)
class Parameter:
    """A parameter of a node; values must have the type of `default`. Bounds are inclusive and hold for each entry."""

    name: str
    default: Value
    description: str
    unit: str = ""
    minimum: float = -math.inf
    maximum: float = math.inf
    choices: Collection[str] = ()
    constraint: str = ""
    """Further condition, as text; the builder of the object checks it."""
    required: bool = False
    """True if a value must be given; `default` then defines the type only."""
    dynamic: bool = False
    """True if the value may change while the node runs."""
    infinite: bool = False
    """True if entries may be infinite, which disables the limit."""
    shape: str = SCALAR
    options: str = ""
    """If not empty, the name of a class of the user, module:Class, is accepted beside the choices; this is the prefix
    of the parameters that are its options."""

    def for_joints(self, n: int) -> Parameter:
        """Return the parameter of a robot with n joints: a scalar default fills the list, the shape is described."""
        if self.shape in (SCALAR, LIST):
            return self
        default = self.default
        if not isinstance(default, tuple):
            default = (float(default),) * (3 if self.shape == POINT else n)
        return replace(self, default=default, description=self.description + _SHAPE_TEXT.get(self.shape, ""))

    def standard(self) -> Value:
        """Return the default; raise ParameterError if the parameter is required."""
        if self.required:
            unit = f" [{self.unit}]" if self.unit else ""
            raise ParameterError(f"parameter '{self.name}' is not given; expected: {self.description}{unit}")
        return self.default

    def check(self, value: object) -> Value:
        """Return `value` as this parameter's type (sequences as tuples); raise ParameterError if it does not fit."""
        if isinstance(self.default, tuple):
            return self._check_list(value, self.default[0])
        return self._check_one(value, self.default)

    def _check_list(self, value: object, like: object) -> tuple[float, ...] | tuple[str, ...]:
        if value is None or isinstance(value, (str, bool, int, float)) or not isinstance(value, Iterable):
            raise ParameterError(f"parameter '{self.name}' is {value!r}; expected a list, each entry {_kind(like)}")
        entries = tuple(self._check_one(entry, like) for entry in value)
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
            if not math.isfinite(value) and not (self.infinite and math.isinf(value)):
                raise ParameterError(f"parameter '{self.name}' holds {value}; expected a finite number")
            if not self.minimum <= value <= self.maximum:
                unit = f" {self.unit}" if self.unit not in ("", "1") else ""
                raise ParameterError(f"parameter '{self.name}' holds {value}{unit}; expected {self.range}{unit}")
        if self.choices and value not in self.choices and not (self.options and is_named(value)):
            raise ParameterError(f"parameter '{self.name}' is {value!r}; expected one of {self.listed_choices}")
        return value  # type: ignore[return-value]

    @property
    def listed_choices(self) -> str:
        """The choices as text."""
        return ", ".join(self.choices) + (", or module:Class of your own" if self.options else "")

    @property
    def range(self) -> str:
        """The range of an entry as text."""
        if self.maximum == math.inf:
            return f"at least {self.minimum}"
        return f"at most {self.maximum}" if self.minimum == -math.inf else f"{self.minimum} to {self.maximum}"


def parameter_field(default: Any, description: str, unit: str = "", *, name: str = "", **properties: Any) -> Any:
    """Return a dataclass field that declares a parameter; default MISSING: the field has none.

    name: of the parameter; the field's own where empty, and added to it where it ends with a dot ("limits.").
    properties: as of Parameter.
    """
    return field(default=default, metadata={_METADATA: Parameter(name, default, description, unit, **properties)})


def declared(kind: type, prefix: str = "", defaults: Mapping[str, Any] | None = None) -> dict[str, Parameter]:
    """Return the parameters that a dataclass declares, by field, with their full names.

    prefix: of the group, as "robust.". defaults: by field, in place of those of the fields.
    """
    found = {}
    for each in fields(kind):
        parameter = each.metadata.get(_METADATA)
        if parameter is not None:
            own = parameter.name
            name = own + each.name if not own or own.endswith(".") else own
            default = (defaults or {}).get(each.name, parameter.default)
            found[each.name] = replace(parameter, name=prefix + name, default=default)
    return found


def _kind(value: object) -> str:
    kinds = {bool: "true or false", int: "an integer", float: "a floating-point number", str: "a string"}
    return kinds.get(type(value), f"a {type(value).__name__}")
