# SPDX-License-Identifier: Apache-2.0
"""ROS 2 parameter files without ROS: read them as rcl does, write them so that rcl reads the same values."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping
from copy import deepcopy
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from ..errors import ParameterError
from ..files.text_file import read_text

MAX_DEPTH, MAX_NODES, MAX_NUMBER_LENGTH = 50, 100_000, 100
"""Largest depth and number of values and keys of a document, and most characters of a number; more is rejected."""
_TAG = "tag:yaml.org,2002:"
_NUMBERS = (f"{_TAG}int", f"{_TAG}float")
_INVALID = re.compile("[\0\ud800-\udfff]")  # invalid in paths, C strings and UTF-8 text

# Scalars that rcl reads as values and PyYAML as text: 1e-3 and 1.5e3 are numbers, y and n are true and false.
_FLOAT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")
_BOOL = re.compile(r"[yYnN]$")


class _Loader(yaml.CSafeLoader if yaml.__with_libyaml__ else yaml.SafeLoader):  # type: ignore[misc]
    """Read plain scalars as rcl does and dates as text; reject what is written twice or does not fit its tag."""

    bool_values = {**yaml.SafeLoader.bool_values, "y": True, "n": False}
    yaml_implicit_resolvers = {
        first: [(tag, form) for tag, form in resolvers if tag != f"{_TAG}timestamp"]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        counts = Counter(key.value for key, _ in node.value if isinstance(key, yaml.ScalarNode))
        twice = next((key for key, count in counts.items() if count > 1), None)
        if twice is not None:
            raise ParameterError(f"has '{_brief(twice)}' twice in one place; expected it once")
        return super().construct_mapping(node, deep)

    def construct_object(self, node: Any, deep: bool = False) -> Any:
        line = node.start_mark.line + 1
        if isinstance(node, yaml.ScalarNode) and node.tag in _NUMBERS and len(node.value) > MAX_NUMBER_LENGTH:
            seen = f"has a number of {len(node.value)} characters ({_brief(node.value)}) in line {line}"
            raise ParameterError(f"{seen}; expected at most {MAX_NUMBER_LENGTH}")
        try:
            return super().construct_object(node, deep)
        except (ValueError, ArithmeticError, LookupError, TypeError, AttributeError):
            tag = node.tag.replace(_TAG, "!!")
            raise ParameterError(
                f"has '{_brief(str(node.value))}' in line {line}; expected what the tag {tag} says"
            ) from None


def _brief(text: str, most: int = 60) -> str:
    return text if len(text) <= most else f"{text[:most]}..."


class _Dumper(yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper):  # type: ignore[misc]
    """Write lists on one line, multi-line texts as blocks, and no aliases, which rcl rejects."""

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
    """Return the YAML document in `text`; raises ParameterError."""
    return deepcopy(_parsed(text))


def _check_events(text: str) -> None:
    """Raise ParameterError for an alias, an invalid character, and a document that is too deep or too large."""
    depth = nodes = 0
    for event in yaml.parse(text, _Loader):
        if isinstance(event, yaml.AliasEvent):
            raise ParameterError(f"has a YAML alias (*{event.anchor}), which ROS 2 does not read")
        nodes += isinstance(event, yaml.NodeEvent)
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth + isinstance(event, yaml.ScalarEvent) > MAX_DEPTH:
            raise ParameterError(f"is nested more than {MAX_DEPTH} levels deep; expected a parameter file")
        if nodes > MAX_NODES:
            raise ParameterError(f"holds more than {MAX_NODES} values and keys; expected a parameter file")
        if isinstance(event, yaml.ScalarEvent) and (found := _INVALID.search(event.value)):
            line = getattr(event.start_mark, "line", 0) + 1
            raise ParameterError(f"has the character U+{ord(found[0]):04X} in line {line}; expected text without it")


@lru_cache(maxsize=16)  # a scenario and its robot file are read for each node and each check of the values
def _parsed(text: str) -> Any:
    try:
        _check_events(text)
        return yaml.load(text, _Loader)
    except (yaml.YAMLError, UnicodeEncodeError) as error:
        raise ParameterError(f"is not valid YAML: {_brief(' '.join(str(error).split()), 400)}") from None


def dump(document: Any) -> str:
    """Return the document as text; keys keep their order."""
    return yaml.dump(document, Dumper=_Dumper, sort_keys=False, width=120, allow_unicode=True)


def read(path: Path, what: str) -> Any:
    """Return the document in a file; raises ParameterError, in which `what` describes the file."""
    try:
        return parse(read_text(path))
    except OSError as error:
        raise ParameterError(f"cannot read {what} {path} ({error.strerror}); expected a text file") from None
    except UnicodeDecodeError as error:
        raise ParameterError(f"{path} is not valid YAML: {error}") from None
    except ParameterError as error:
        raise ParameterError(f"{path} {error}") from None


def mapping(document: Any, expected: str = "a mapping") -> dict[Any, Any]:
    """Return a document that is a mapping; raises ParameterError, in which `expected` describes it."""
    if not isinstance(document, dict):
        seen = "is empty" if document is None else f"holds a {type(document).__name__}"
        raise ParameterError(f"{seen}; expected {expected}")
    return document


_KEY = "ros__parameters"
SHARED = "/**"
"""The section of all nodes, which is also the section of `-p name:=value` on a command line."""


def sections(node: str) -> tuple[str, ...]:
    """Return the names of the sections that hold parameters of a node."""
    return (SHARED, node, f"/{node}", f"/**/{node}")


def values_for(node: str, document: Any) -> dict[str, object]:
    """Return the values that a parameter file gives to a node, with dotted names.

    Later sections override earlier ones. Raises ParameterError for a document or a key at its top that is no section.
    """
    given: dict[str, object] = {}
    for section, content in mapping(document, "a ROS 2 parameter file (a mapping)").items():
        if section not in sections(node):
            if not _is_section(content):
                raise ParameterError(
                    f"has '{section}' at the top, where only sections of nodes are read; expected it below "
                    f"'{SHARED}:' and '{_KEY}:'"
                )
            continue
        if not isinstance(content, dict) or not isinstance(content.get(_KEY), dict):
            raise ParameterError(f"section '{section}' has no '{_KEY}' mapping")
        given.update(_flat(content[_KEY]))
    return given


def _is_section(content: Any) -> bool:
    """Return whether this is the section of a node, or of a namespace that has sections."""
    return isinstance(content, dict) and (_KEY in content or any(map(_is_section, content.values())))


def _flat(tree: Mapping[Any, Any], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def tree_of(values: Mapping[str, object]) -> dict[str, Any]:
    """Return named values as the nested mappings of a parameter file.

    Raises ParameterError if one name is a prefix of another.
    """
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
