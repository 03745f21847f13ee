# SPDX-License-Identifier: Apache-2.0
"""Every code name on a page exists, in the tables of equations and subjects each file and symbol, too."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

import fjr_core
from docs.pages import PAGES, ROOT, anchors, inline, links, tokens

SOURCES = ROOT / "ros2_ws" / "src"
CORE = SOURCES / "fjr_core" / "fjr_core"
HOMES = [folder for package in sorted(SOURCES.iterdir()) for folder in (package / package.name, package)]
FOLDERS = (CORE, *HOMES, ROOT / "tests" / "core", ROOT / "tests", ROOT)
"""Folders to which the paths on a page are relative, in search order."""
MAPS = tuple(ROOT / "docs" / name for name in ("paper_map.md", "tables/beyond_the_paper.md"))
PATH = re.compile(r"([\w*/]+(?:\.(?:py|c|md)|/))(?:::([\w.]+))?")
NAME = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")


def cells(page: Path) -> Iterator[list[str]]:
    """Return the inline code of each cell of a table."""
    found = tokens(page)
    for before, token in zip(found, found[1:], strict=False):
        if before.type == "td_open":
            yield [child.content for child in token.children or () if child.type == "code_inline"]


def files(path: str, last: list[Path]) -> list[Path]:
    """Return the files or folder of a path, which may contain `*`, relative to the last file or to one of FOLDERS."""
    folders = [file.parent for file in last[:1]]
    return next((found for folder in (*FOLDERS, *folders) if (found := sorted(folder.glob(path.rstrip("/"))))), [])


def definitions(body: list[ast.stmt], prefix: str = "") -> Iterator[str]:
    """Return the names of functions, classes and constants, and `Class.name` of class members."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield prefix + node.name
        if isinstance(node, ast.ClassDef):
            yield from definitions(node.body, f"{node.name}.")
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
        yield from (prefix + target.id for target in targets if isinstance(target, ast.Name))


@cache
def defined(file: Path) -> frozenset[str]:
    return frozenset(definitions(ast.parse(file.read_text(encoding="utf-8")).body) if file.suffix == ".py" else ())


@cache
def names_of_tests() -> frozenset[str]:
    return frozenset().union(*(defined(file) for file in (ROOT / "tests").rglob("test_*.py")))


def missing(cell: list[str]) -> list[str]:
    """Return missing files of a cell, and names that the last file before them does not define."""
    last: list[Path] = []
    absent = []
    for text in cell:
        path = PATH.fullmatch(text)
        if path:
            last = files(path[1], last)
            absent += [] if last else [text]
        name = path[2] if path else text if NAME.fullmatch(text) else None
        if name and name.startswith("test_") and not last:
            absent += [] if name in names_of_tests() else [name]
        elif name and last:
            known = frozenset(dir(fjr_core)).union(*(defined(file) for file in last))
            absent += [] if name in known else [text]
    return absent


@cache
def symbols() -> frozenset[str]:
    """Return all identifiers in the mathematics."""
    nodes = [
        node for file in SOURCES.glob("*/*/**/*.py") for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
    ]
    names = {getattr(node, key) for node in nodes for key in ("id", "attr", "arg", "name") if hasattr(node, key)}
    return frozenset(name for name in names if isinstance(name, str))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_and_tests_named_on_a_page_exist(page: Path) -> None:
    said = [token.content for token in inline(page, "code_inline")]
    named = [text for text in said if "::" in text or re.fullmatch(r"test_\w+", text)]
    assert [text for text in named if missing([text])] == []


@pytest.mark.parametrize("page", MAPS, ids=lambda page: page.stem)
def test_files_functions_and_tests_named_in_a_map_exist(page: Path) -> None:
    found = [name for cell in cells(page) for name in missing(cell)]
    assert found == []


def test_symbols_of_the_notation_are_in_the_code() -> None:
    rows = [text for texts in first_column(MAPS[0]) for text in texts]
    assert len(rows) > 15
    assert {name for text in rows for name in re.findall(r"[A-Za-z_]\w*", text)} - symbols() == set()


def first_column(page: Path) -> Iterator[list[str]]:
    found = tokens(page)
    for row, cell, token in zip(found, found[1:], found[2:], strict=False):
        if (row.type, cell.type) == ("tr_open", "td_open"):
            yield [child.content for child in token.children or () if child.type == "code_inline"]


by_page = pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)


@by_page
def test_link_targets_are_existing_files_and_headings(page: Path) -> None:
    for target in links(page):
        if "://" in target or target.startswith("mailto:"):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        assert file.is_file(), target
        assert file.is_relative_to(ROOT), target
        if anchor:
            assert anchor in anchors(file), f"{target}: {sorted(anchors(file))}"


def test_index_links_to_every_page() -> None:
    index = ROOT / "docs" / "README.md"
    found = {(index.parent / target.partition("#")[0]).resolve() for target in links(index)}
    assert {page for page in PAGES if page != index} <= found
