# SPDX-License-Identifier: Apache-2.0
"""Read code blocks, links and inline code from the documents; that links lead somewhere, test_build.py shows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *sorted((ROOT / "docs").glob("**/*.md")),
    *sorted((ROOT / "examples").glob("**/README.md")),
)
LANGUAGES = ("python", "sh", "yaml", "xml", "c", "cpp", "cmake", "text")
"""`text` is for diagrams and formulas or, if marked `shown`, for the output of the previous block."""
MARKS = ("file", "exit", "shown", "for")
"""file: name of the file; exit: expected exit code; shown: lines of output; for: the program that reads the block."""

_MARK = re.compile(r"<!-- block: (.*) -->")


@dataclass(frozen=True)
class Block:
    """A code block; marks are the values of a preceding comment `<!-- block: name=value ... -->`."""

    page: Path
    line: int
    language: str
    text: str
    marks: dict[str, str]

    def __str__(self) -> str:
        return f"{self.page.relative_to(ROOT)}:{self.line}"


@cache
def tokens(page: Path) -> list[Token]:
    """Return the tokens of the page, CommonMark with GitHub tables."""
    return MarkdownIt("commonmark").enable("table").parse(page.read_text(encoding="utf-8"))


def blocks(page: Path) -> Iterator[Block]:
    """Yield all code blocks of a page, fenced and indented; indented blocks have no language."""
    marks: dict[str, str] = {}
    for token in tokens(page):
        if token.type in ("fence", "code_block"):
            line = token.map[0] + 1 if token.map else 0
            yield Block(page, line, token.info.strip(), token.content, marks)
        found = _MARK.match(token.content.strip()) if token.type == "html_block" else None
        marks = dict(word.split("=", 1) for word in found[1].split()) if found else {}


def languages(page: Path) -> list[str]:
    """Return the language of each fenced block of a page that names one, without parsing the page."""
    return re.findall(r"^ *```(\w+)$", page.read_text(encoding="utf-8"), re.MULTILINE)


def inline(page: Path, kind: str) -> Iterator[Token]:
    """Yield the inline tokens of one kind: code_inline, link_open or image."""
    for token in tokens(page):
        yield from (child for child in token.children or () if child.type == kind)


def links(page: Path) -> list[str]:
    """Return the targets of links and images."""
    targets = [link.attrGet("href") for link in inline(page, "link_open")]
    targets += [picture.attrGet("src") for picture in inline(page, "image")]
    return [str(target) for target in targets]
