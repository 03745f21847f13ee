# SPDX-License-Identifier: Apache-2.0
"""Convert docstrings (plain text with `code`, lists and indented displays) to reStructuredText."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from enum import Enum
from itertools import groupby

_CODE = re.compile(r"(``[^`]+``|`[^`]+`)")
_MARKUP = re.compile(r"([\\*|_`])")
_ENUMERATOR = re.compile(r"^(\(?(?:\w|\d+|[ivxlcdm]+)[.)]\s)")


class Kind(Enum):
    """Kind of a line."""

    BLANK, TEXT, ITEM, DISPLAY = range(4)


def as_rst(lines: Sequence[str]) -> list[str]:
    """Return the lines of a docstring as reStructuredText."""
    made: list[str] = []
    for kind, pairs in groupby(zip(_kinds(lines), lines, strict=True), key=lambda pair: pair[0]):
        block = [line for _, line in pairs]
        if kind is Kind.DISPLAY:
            made += ["::", "", *(f"    {line}" for line in block), ""]
        elif kind is not Kind.BLANK:
            made += [*_escaped(block), ""]
    return made


def _kinds(lines: Sequence[str]) -> Iterator[Kind]:
    """Yield the kind of each line: `- ` starts an item, indented lines continue it or are a display."""
    kind = Kind.BLANK
    for line in lines:
        if not line.strip():
            kind = Kind.BLANK
        elif line.startswith("- "):
            kind = Kind.ITEM
        elif not line.startswith(" "):
            kind = Kind.TEXT
        elif kind is not Kind.ITEM:
            kind = Kind.DISPLAY
        yield kind


def _escaped(block: Sequence[str]) -> list[str]:
    """Return a block with all markup but code escaped."""
    parts = _CODE.split("\n".join(block))
    text = "".join(f"``{p.strip('`')}``" if _CODE.fullmatch(p) else _MARKUP.sub(r"\\\1", p) for p in parts)
    return [_ENUMERATOR.sub(r"\\\1", line) for line in text.splitlines()]
