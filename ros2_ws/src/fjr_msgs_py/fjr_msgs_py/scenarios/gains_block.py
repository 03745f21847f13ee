# SPDX-License-Identifier: Apache-2.0
"""The block `gains` of a scenario file: its lines, and a file with other gains that keeps everything else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from fjr_core.config import ros_yaml
from fjr_core.config.nodes import CONTROLLER
from fjr_core.errors import ParameterError

DIGITS = 4
STEP = 2  # characters by which a block is indented below its key

GainValues = Mapping[str, Sequence[float]]
"""Entries by name (Lambda_l, ...): n of a diagonal matrix, else n*n by rows."""


def gain_lines(gains: GainValues, n: int, indent: int) -> list[str]:
    """Return a line `name: [...]` for each gain; a matrix has one row a line."""
    return [f"{' ' * indent}{name}: {_entries(gains[name], n, indent + len(name) + 2)}" for name in gains]


def _entries(entries: Sequence[float], n: int, column: int) -> str:
    """Return a list that starts in this column."""
    numbers = [repr(float(f"{entry:.{DIGITS}g}")) for entry in entries]
    rows = [", ".join(numbers[i : i + n]) for i in range(0, len(numbers), n)]
    return "[" + f",\n{' ' * (column + 1)}".join(rows) + "]"


def with_gains(text: str, gains: GainValues, n: int) -> str:
    """Return the text of a scenario file with these gains for the controller in place of those that it has.

    Every other character stays, comments included. Gains that the file has and `gains` lacks are removed.
    Raises ParameterError if the file has no place for a block `gains`.
    """
    parameters = _parameters(yaml.compose(text, Loader=yaml.SafeLoader))
    key, block = next(((key, value) for key, value in parameters.value if key.value == "gains"), (None, None))
    if key is None or block is None:
        first = parameters.value[0][0].start_mark
        lines = [f"{' ' * first.column}gains:", *gain_lines(gains, n, first.column + STEP)]
        start = first.index - first.column
        changed = _replaced(text, [(start, start, "\n".join(lines) + "\n")])
    elif isinstance(block, yaml.MappingNode) and not block.flow_style:
        changed = _with_new_entries(text, block, gains, n)
    else:
        lines = gain_lines(gains, n, key.start_mark.column + STEP)
        changed = _replaced(text, [(block.start_mark.index, block.end_mark.index, "\n" + "\n".join(lines))])
    _check(text, changed, gains)
    return changed


def _parameters(document: Any) -> yaml.MappingNode:
    """Return the last mapping ros__parameters of the controller that has gains, else the first one."""
    found: list[yaml.MappingNode] = []
    for section, content in document.value:
        if section.value in ros_yaml.sections(CONTROLLER):
            found += [value for key, value in content.value if key.value == "ros__parameters"]
    names = [[key.value for key, _ in each.value] for each in found]
    if any(name.startswith("gains.") for listed in names for name in listed):
        raise ParameterError("the file names gains as 'gains.NAME'; expected one block `gains:`")
    with_block = [each for each, listed in zip(found, names, strict=True) if "gains" in listed]
    if not found or found[0].flow_style:
        raise ParameterError("the file has no block `ros__parameters:` for the controller; expected one")
    return with_block[-1] if with_block else found[0]


def _with_new_entries(text: str, block: yaml.MappingNode, gains: GainValues, n: int) -> str:
    """Replace the values of entries that stay, remove the lines of others, and add lines for new ones."""
    there = {key.value: (key.start_mark, value) for key, value in block.value}
    column = block.value[0][0].start_mark.column
    edits = []
    for name, (mark, value) in there.items():
        start, end = value.start_mark, value.end_mark.index
        if name in gains:
            edits.append((start.index, end, _entries(gains[name], n, start.column)))
        else:
            edits.append((mark.index - mark.column, _end_of_line(text, end), ""))
    added = gain_lines({name: gains[name] for name in gains if name not in there}, n, column)
    last = _end_of_line(text, block.value[-1][1].end_mark.index)
    before = "" if text[:last].endswith("\n") else "\n"
    edits += [(last, last, before + "\n".join(added) + "\n")] if added else []
    return _replaced(text, edits)


def _end_of_line(text: str, index: int) -> int:
    """Return the index after the next line break."""
    found = text.find("\n", index)
    return len(text) if found < 0 else found + 1


def _replaced(text: str, edits: Sequence[tuple[int, int, str]]) -> str:
    for start, end, new in sorted(edits, reverse=True):
        text = text[:start] + new + text[end:]
    return text


def _check(text: str, changed: str, gains: GainValues) -> None:
    """Raise ParameterError unless the changed file differs from the file in the gains only."""
    old, new = (ros_yaml.values_for(CONTROLLER, ros_yaml.parse(each)) for each in (text, changed))
    kept = {name: value for name, value in old.items() if not name.startswith("gains.")}
    wanted = {f"gains.{name}": [float(f"{entry:.{DIGITS}g}") for entry in entries] for name, entries in gains.items()}
    if new != {**kept, **wanted}:
        raise ParameterError("the gains of the file cannot be replaced in place; expected one block `gains:`")
