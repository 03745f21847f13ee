# SPDX-License-Identifier: Apache-2.0
"""Read the parameters of a ROS 2 command line: which a parameter file overrides, which are for any node.

rcl puts `-p name:=value` into the section /** and merges it with the parameter files in the order of the command
line; a later section, such as /**/node of a file, overrides /**.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from fjr_core import ParameterError
from fjr_core.config import ros_yaml

from ..messages.plain import plain

_FLAGS = ("-p", "--param")


@dataclass(frozen=True)
class ParameterRule:
    """One `-p [node:]name:=value`; node is "" for all nodes, value is parsed as by rcl."""

    node: str
    name: str
    value: Any
    text: str


def parameter_rules(arguments: Sequence[str]) -> Iterator[ParameterRule]:
    """Yield the rules between `--ros-args` and `--` in their order; rules that rcl rejects are left out."""
    inside, flag = False, ""
    for argument in arguments:
        if flag in _FLAGS:
            rule = _rule(argument)
            flag = ""
            if rule is not None:
                yield rule
        elif argument in ("--ros-args", "--"):
            inside = argument == "--ros-args"
        elif inside:
            flag = argument


def read_files(arguments: Sequence[str], node: str) -> tuple[set[str], list[str]]:
    """Return the names that parameter files give to all nodes, and a sentence for each without a section of /node."""
    found, unused = set[str](), list[str]()
    for file in (file for flag, file in zip(arguments, arguments[1:], strict=False) if flag == "--params-file"):
        with suppress(ParameterError):  # rcl reports a file that it cannot read
            content = read if isinstance(read := ros_yaml.read(Path(file), "parameter file"), dict) else {}
            found |= ros_yaml.values_for(ros_yaml.SHARED, content).keys()
            own = [name if "ros__parameters" in (below or ()) else f"{name}/**" for name, below in content.items()]
            if not any(fnmatchcase(node, f"/{name}".replace("//", "/").replace("/**", "*")) for name in own):
                seen = ", ".join(own) or "it has no sections"
                unused.append(f"{file} has no section of {node} ({seen}); expected {ros_yaml.SHARED} or /**{node}")
    return found, unused


def overruled(arguments: Sequence[str], node: str, values: Mapping[str, Any]) -> str:
    """Return one sentence about the first rule for `node` that has no effect on its `values`, or "".

    The last of several rules for one name counts.
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
    """Return True if two parameter values are equal in type and value; nan equals nan."""
    return repr(plain(one)) == repr(plain(other))


def _rule(text: str) -> ParameterRule | None:
    name, separator, value = text.partition(":=")
    node, _, name = name.rpartition(":")
    try:
        return ParameterRule(node, name, ros_yaml.parse(value), text) if separator else None
    except ParameterError:
        return None
