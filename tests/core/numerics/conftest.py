# SPDX-License-Identifier: Apache-2.0
"""An empty cache of compiled code."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from fjr_core.numerics import code_cache, jit


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return the folder of an empty cache, not made yet. CC is unset; temporary folder and warning are forgotten."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("CC", raising=False)
    jit._warn_once.cache_clear()
    code_cache._temporary_base.cache_clear()
    yield tmp_path / "cache" / "fjr"
    code_cache._temporary_base.cache_clear()
