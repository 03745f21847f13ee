# SPDX-License-Identifier: Apache-2.0
"""Fixtures of the tests with pages: one real browser for the tests of a file."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from system.browser import Browser


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    made = Browser()
    yield made
    made.close()
