# SPDX-License-Identifier: Apache-2.0
"""Generate hostile documents and bytes, and check how readers respond.

The default is 60 deterministic examples; FJR_FUZZ_EXAMPLES=5000 tries 5000 random ones.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from fjr_core.errors import FjrError

LONGEST_SENTENCE = 3000
_GIVEN = os.environ.get("FJR_FUZZ_EXAMPLES", "")


def fuzzed(examples: int) -> settings:
    """Return the settings of a test with this number of examples."""
    return settings(
        max_examples=int(_GIVEN or examples),
        derandomize=not _GIVEN,
        database=None,
        deadline=None,
        suppress_health_check=list(HealthCheck),
    )


def answer(read: Callable[[], object]) -> str:
    """Return the sentence of the FjrError, or an empty string if the input is read; other exceptions fail the test."""
    sentence = ""
    try:
        read()
    except FjrError as error:
        sentence = str(error) or "(nothing)"
    assert len(sentence) < LONGEST_SENTENCE, sentence[:500]
    return sentence


def refused(error: type[FjrError], call: Callable[[], object], *words: str) -> str:
    """Return the one line with which a call raises `error`; check that it has these words."""
    with pytest.raises(error) as caught:
        call()
    sentence = str(caught.value)
    assert all(word in sentence for word in words), sentence
    assert "\n" not in sentence
    return sentence


NUMBERS = (0, -1, 1, 64, 10**30, 0.0, -1.0, 1e-300, 1e300, -1e308, float("nan"), float("inf"))
WORDS = (
    "",
    " ",
    "x" * 2000,
    "a\nb",
    "ä€\U0001f916",
    "../..",
    "/dev/zero",
    "/",
    "package://",
    "package://x/y",
    "<robot>",
)
LISTS = (
    [],
    [[]],
    [None],
    [1.0, "a"],
    [0.0] * 3,
    [1.0] * 1000,
    ["j"] * 300,
    {},
    {"a": {}},
    {1: 2},
    {"ros__parameters": {}},
)
VALUES = st.sampled_from([None, True, *NUMBERS, *WORDS, *LISTS])


def places(document: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of keys to each value of a document."""
    found = [path] if path else []
    entries = dict(enumerate(document)) if isinstance(document, list) else document
    for key, value in entries.items() if isinstance(entries, dict) else ():
        found += places(value, (*path, key))
    return found


def changed(document: Any, path: Sequence[Any], value: Any) -> Any:
    """Return the document with another value at a path."""
    if not path:
        return value
    entries = dict(document) if isinstance(document, dict) else list(document)
    entries[path[0]] = changed(document[path[0]], path[1:], value)
    return entries


@st.composite
def documents(draw: st.DrawFn, document: Any) -> str:
    """Generate YAML of the document with up to three invalid values."""
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(places(document) or [()]))
        document = changed(document, path, draw(VALUES))
    return yaml.safe_dump(document, allow_unicode=True)


FRAGMENTS = (
    *("\t", "\n", ": ", "- ", "[", "]", "{", "}", "'", '"', "#", "&a ", "*a", "<<: ", "? ", "|", ">", "%"),
    *(
        "---\n",
        "...",
        "!!int ",
        "!!float ",
        "!!bool ",
        "!!timestamp ",
        "!!binary ",
        "!!set ",
        "!!omap ",
        "!x ",
        "!!str",
    ),
    *("2024-13-45", "0x_", "1:2", "1e999", "9" * 5000, "[" * 10_000, "{a: " * 200, "a: " * 50),
    *('"\\0"', '"\\ud800"', "\0", "\x85", "\ufeff"),
)


@st.composite
def texts(draw: st.DrawFn, text: str) -> bytes:
    """Generate the text with up to three fragments inserted, deleted or replaced, sometimes as invalid UTF-8."""
    for _ in range(draw(st.integers(1, 3))):
        begin = draw(st.integers(0, len(text)))
        end = min(len(text), begin + draw(st.sampled_from([0, 0, 1, 5, 200])))
        text = text[:begin] + draw(st.sampled_from(["", *FRAGMENTS])) + text[end:]
    data = text.encode("utf-8")
    return data if draw(st.booleans()) else damaged(draw, data)


def damaged(draw: st.DrawFn, data: bytes) -> bytes:
    """Return the bytes with a flipped bit, truncated, or with some bytes inserted."""
    place = draw(st.integers(0, max(0, len(data) - 1)))
    kind = draw(st.sampled_from(["flip", "cut", "insert"]))
    if kind == "flip" and data:
        return data[:place] + bytes([data[place] ^ 1 << draw(st.integers(0, 7))]) + data[place + 1 :]
    return data[:place] + (draw(st.binary(max_size=20)) + data[place:] if kind == "insert" else b"")


@st.composite
def bytes_of(draw: st.DrawFn, data: bytes) -> bytes:
    """Generate the bytes with damage in one to four places."""
    for _ in range(draw(st.integers(1, 4))):
        data = damaged(draw, data)
    return data
