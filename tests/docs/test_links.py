# SPDX-License-Identifier: Apache-2.0
"""Every link has a target, every page is in the index, and every code name on a page exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.pages import PAGES, ROOT, anchors, inline, links

SOURCES = ROOT / "ros2_ws" / "src"
ROOMS = [ROOT, ROOT / "tests", ROOT / "tests" / "core", SOURCES]
ROOMS += [folder for package in sorted(SOURCES.iterdir()) for folder in (package, package / package.name)]
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


@by_page
def test_code_named_on_a_page_exists(page: Path) -> None:
    for token in inline(page, "code_inline"):
        found = re.fullmatch(r"([\w/]+\.py)::([\w.]+)", token.content)
        if found:
            texts = [(room / found[1]).read_text("utf-8") for room in ROOMS if (room / found[1]).is_file()]
            names = found[2].split(".")
            assert any(all(re.search(rf"\b{name}\b", text) for name in names) for text in texts), token.content


@by_page
def test_tests_named_on_a_page_exist(page: Path) -> None:
    tests = "\n".join(path.read_text("utf-8") for path in (ROOT / "tests").rglob("test_*.py"))
    for token in inline(page, "code_inline"):
        name = token.content.partition("::")[2] or token.content
        if re.fullmatch(r"test_\w+", name):
            assert f"def {name}(" in tests, token.content
