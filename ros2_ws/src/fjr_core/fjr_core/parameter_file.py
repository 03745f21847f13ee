# SPDX-License-Identifier: Apache-2.0
"""ROS 2 parameter files without ROS: read as rcl reads them, and written so that rcl reads the same."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from .errors import ParameterError

# What rcl reads and PyYAML takes for text: 1e-3 and 1.5e3 are numbers, y and n are true and false.
_FLOAT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
_BOOL = re.compile(r"[yYnN]$")


class _Loader(yaml.SafeLoader):
    """Reads plain words and numbers as rcl does."""

    bool_values = {**yaml.SafeLoader.bool_values, "y": True, "n": False}

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [key.value for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                raise ParameterError(f"has '{key}' twice in one place; expected it once")
        return super().construct_mapping(node, deep)

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ParameterError(f"has a YAML alias (*{self.peek_event().anchor}), which ROS 2 does not read")
        return super().compose_node(parent, index)


class _Dumper(yaml.SafeDumper):
    """Writes lists on one line, long texts as blocks, and no aliases, which rcl refuses."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _kind in (_Loader, _Dumper):
    _kind.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+0123456789."))
    _kind.add_implicit_resolver("tag:yaml.org,2002:bool", _BOOL, list("yYnN"))
for _sequence in (list, tuple):
    _Dumper.add_representer(_sequence, lambda d, v: d.represent_sequence("tag:yaml.org,2002:seq", v, flow_style=True))
_Dumper.add_representer(
    str, lambda d, v: d.represent_scalar("tag:yaml.org,2002:str", v, style="|" if "\n" in v else None)
)


def parse(text: str) -> Any:
    """The YAML document in `text`; raises ParameterError in one sentence."""
    try:
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise ParameterError(f"is not valid YAML: {' '.join(str(error).split())}") from None


def dump(document: Any) -> str:
    """The document as text, keys in their order."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def read(path: Path, what: str) -> Any:
    """The document in a file; raises ParameterError that calls the file `what`."""
    try:
        return parse(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"cannot read {what} {path}: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise ParameterError(f"{path} is not valid YAML: {error}") from None
    except ParameterError as error:
        raise ParameterError(f"{path} {error}") from None


SHARED = "/**"
"""The section for every node, and the only one that `-p name:=value` on a command line reaches."""


def sections(node: str) -> tuple[str, ...]:
    """Names of the sections that hold parameters of a node."""
    return (SHARED, node, f"/{node}", f"/**/{node}")


def values_for(node: str, document: Any) -> dict[str, object]:
    """The values a parameter file gives to a node, later sections over earlier ones, names joined by dots."""
    if not isinstance(document, dict):
        raise ParameterError(f"holds a {type(document).__name__}; expected a ROS 2 parameter file (a mapping)")
    given: dict[str, object] = {}
    for section, content in document.items():
        if section not in sections(node):
            continue
        if not isinstance(content, dict) or not isinstance(content.get("ros__parameters"), dict):
            raise ParameterError(f"section '{section}' has no 'ros__parameters' mapping")
        given.update(_flat(content["ros__parameters"]))
    return given


def _flat(tree: Mapping[Any, Any], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def tree_of(values: Mapping[str, object]) -> dict[str, Any]:
    """Named values as the tree of mappings that a parameter file holds; raises ParameterError where it is none."""
    tree: dict[str, Any] = {}
    for name, value in values.items():
        *parents, leaf = name.split(".")
        branch = tree
        for part in parents:
            branch = branch.setdefault(part, {})
            if not isinstance(branch, dict):
                raise ParameterError(f"parameter '{name}' is below '{part}', which has a value: {branch!r}")
        branch[leaf] = value
    return tree
