# SPDX-License-Identifier: Apache-2.0
"""The files that start first are there."""

from __future__ import annotations

import pytest

from docs.pages import ROOT
from longest_first import LONGEST_FIRST


@pytest.mark.parametrize("name", LONGEST_FIRST)
def test_a_file_that_starts_first_is_there(name: str) -> None:
    assert (ROOT / "tests" / name).is_file()
