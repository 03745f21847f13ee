# SPDX-License-Identifier: Apache-2.0
"""Read the sections of a study file: a table of readers, one for each key, says what a section may hold.

A reader takes a key and its value, and returns the value as the study has it. It raises ParameterError with a sentence
about both, which begins with "has"; `section` puts the name of the section before it.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fjr_core.config.parameter import resembling
from fjr_core.errors import ParameterError, prefixed

Reader = Callable[[str, Any], Any]


def section(
    given: object, readers: Mapping[str, Reader], where: str = "", required: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the values of a section by key, as their readers return them; raise ParameterError.

    where: start of each message, such as "sweep mine ". required: keys that must have a value. A key without a reader
    is refused with the one that it resembles.
    """
    if not isinstance(given, Mapping):
        raise ParameterError(f"{where}is {given!r}; expected a mapping")
    with prefixed(where):
        for key in given:
            if key not in readers:
                close = resembling(str(key), readers)
                hint = f"did you mean '{close}'?" if close else f"expected some of {', '.join(readers)}"
                raise ParameterError(f"has '{key}'; {hint}")
        for key in required:
            if not given.get(key):
                raise ParameterError(f"has no '{key}'; expected at least one")
        return {key: readers[key](key, value) for key, value in given.items()}


def subsection(readers: Mapping[str, Reader]) -> Reader:
    """Return a reader of a section under a key, which the messages name first."""
    return lambda key, given: section(mapping(key, given), readers, f"'{key}': ")


def by_name(reader: Reader) -> Reader:
    """Return a reader of values by names of the user's choice; null is an empty value."""
    return lambda key, given: {str(name): reader(str(name), one or {}) for name, one in mapping(key, given).items()}


def of_type(kind: type, expected: str) -> Reader:
    """Return a reader of values of a type."""

    def read(key: str, value: Any) -> Any:
        if not isinstance(value, kind):
            raise ParameterError(f"has {value!r} as '{key}'; expected {expected}")
        return value

    return read


mapping, listed, string = of_type(Mapping, "a mapping"), of_type(list, "a list"), of_type(str, "a text")


def number(key: str, value: Any) -> float:
    """Read a number that is finite as a double."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
        raise ParameterError(f"has {value!r} as '{key}'; expected a number")
    return float(value)


def whole(key: str, value: Any) -> int:
    """Read a whole number, to the last digit."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value % 1 != 0:
        raise ParameterError(f"has {value!r} as '{key}'; expected a whole number")
    return int(value)


def between(least: float, most: float, read: Callable[[str, Any], float] = number) -> Reader:
    """Return a reader of numbers in a range, both ends included."""

    def checked(key: str, value: Any) -> float:
        found = read(key, value)
        if not least <= found <= most:
            raise ParameterError(f"has {value!r} as '{key}'; expected {least:g} to {most:g}")
        return found

    return checked
