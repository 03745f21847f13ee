# SPDX-License-Identifier: Apache-2.0
"""ROS 2 parameter files without ROS: read as rcl reads them, and written so that rcl reads the same."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from ..errors import ParameterError
from ..files.text_file import read_text

DEEPEST, MOST_NODES, LONGEST_NUMBER = 50, 100_000, 100
"""Levels, values and keys of a document, and characters of a number: what is larger is refused before it costs time."""
_TAG = "tag:yaml.org,2002:"
_NUMBERS = (f"{_TAG}int", f"{_TAG}float")
_UNFIT = re.compile("[\0\ud800-\udfff]")  # no path, no C string and no UTF-8 text can hold these

# What rcl reads and PyYAML takes for text: 1e-3 and 1.5e3 are numbers, y and n are true and false.
_FLOAT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
_BOOL = re.compile(r"[yYnN]$")


class _Loader(yaml.SafeLoader):
    """Read plain words and numbers as rcl does, dates as text; refuse what costs more than bounded time and memory."""

    bool_values = {**yaml.SafeLoader.bool_values, "y": True, "n": False}
    yaml_implicit_resolvers = {
        first: [(tag, form) for tag, form in resolvers if tag != f"{_TAG}timestamp"]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }
    depth = nodes = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise ParameterError(f"has a YAML alias (*{self.peek_event().anchor}), which ROS 2 does not read")
        self.depth, self.nodes = self.depth + 1, self.nodes + 1
        if self.depth > DEEPEST:
            raise ParameterError(f"is nested more than {DEEPEST} levels deep; expected a parameter file")
        if self.nodes > MOST_NODES:
            raise ParameterError(f"holds more than {MOST_NODES} values and keys; expected a parameter file")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        counts = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        twice = next((key for key, count in counts.items() if count > 1), None)
        if twice is not None:
            raise ParameterError(f"has '{_brief(twice)}' twice in one place; expected it once")
        return super().construct_mapping(node, deep)

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        if isinstance(node, yaml.ScalarNode):
            _refuse_unfit(node)
        try:
            return super().construct_object(node, deep)
        except _NO_VALUE:
            tag, line = node.tag.replace(_TAG, "!!"), node.start_mark.line + 1
            raise ParameterError(
                f"has '{_brief(str(node.value))}' in line {line}; expected what the tag {tag} says"
            ) from None


_NO_VALUE = (ValueError, ArithmeticError, LookupError, TypeError, AttributeError)


def _refuse_unfit(node: yaml.ScalarNode) -> None:
    line = node.start_mark.line + 1
    if node.tag in _NUMBERS and len(node.value) > LONGEST_NUMBER:
        seen = f"has a number of {len(node.value)} characters ({_brief(node.value)}) in line {line}"
        raise ParameterError(f"{seen}; expected at most {LONGEST_NUMBER}")
    unfit = _UNFIT.search(node.value)
    if unfit:
        raise ParameterError(f"has the character U+{ord(unfit[0]):04X} in line {line}; expected text without it")


def _brief(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."


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
        raise ParameterError(f"is not valid YAML: {_brief_reason(error)}") from None


def _brief_reason(error: yaml.YAMLError) -> str:
    words = " ".join(str(error).split())
    return words if len(words) <= 400 else f"{words[:400]}..."


def dump(document: Any) -> str:
    """The document as text, keys in their order."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def read(path: Path, what: str) -> Any:
    """The document in a file; raises ParameterError that calls the file `what`."""
    try:
        return parse(read_text(path))
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
