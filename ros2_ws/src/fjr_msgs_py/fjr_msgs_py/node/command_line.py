# SPDX-License-Identifier: Apache-2.0
"""Parameters on a ROS 2 command line: find those that a parameter file overrules.

rcl puts `-p name:=value` into the section /** and merges it with the parameter files in the order of the command
line; a section that comes later in that order, as /**/node of a file, then wins over /**.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fjr_core import ParameterError
from fjr_core.config import ros_yaml

_FLAGS = ("-p", "--param")


@dataclass(frozen=True)
class ParameterRule:
    """One `-p [node:]name:=value`; node "" for every node, value as rcl reads it."""

    node: str
    name: str
    value: Any
    text: str


def parameter_rules(arguments: Sequence[str]) -> Iterator[ParameterRule]:
    """Yield the rules between `--ros-args` and `--`, in their order; what rcl would refuse is left out."""
    ours, flag = False, ""
    for argument in arguments:
        if flag in _FLAGS:
            rule = _rule(argument)
            flag = ""
            if rule is not None:
                yield rule
        elif argument in ("--ros-args", "--"):
            ours = argument == "--ros-args"
        elif ours:
            flag = argument


def overruled(arguments: Sequence[str], node: str, values: Mapping[str, Any]) -> str:
    """Return one sentence about the first rule for `node` that has no effect on its `values`; "" for none.

    Of several rules for one name the last one counts.
    """
    rules = [rule for rule in parameter_rules(arguments) if rule.node in ("", node)]
    last = {rule.name: rule for rule in rules}
    for name, rule in last.items():
        if name in values and not same_value(rule.value, values[name]):
            return (
                f"argument '-p {rule.text}' has no effect: a parameter file sets {name} to {plain(values[name])!r}; "
                "expected -p after --params-file, and the file's value in the section /** (-p reaches no other)"
            )
    return ""


def same_value(one: Any, other: Any) -> bool:
    """Whether two values of parameters are equal in type and number; nan equals nan."""
    return repr(plain(one)) == repr(plain(other))


def plain(value: Any) -> Any:
    """A parameter's value with a list in place of an array or a tuple."""
    if value is None or isinstance(value, (str, bytes, bool, int, float)):
        return value
    return list(value)


def _rule(text: str) -> ParameterRule | None:
    name, separator, value = text.partition(":=")
    node, _, name = name.rpartition(":")
    try:
        return ParameterRule(node, name, ros_yaml.parse(value), text) if separator else None
    except ParameterError:
        return None
