# SPDX-License-Identifier: Apache-2.0
"""Renamed public names keep working for one version with a warning that names the successor."""

from __future__ import annotations

import pytest

import fjr_core as fjr


@pytest.mark.parametrize(("old", "new"), fjr._RENAMED.items())
def test_renamed_name_is_an_alias_with_a_warning(old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"fjr_core.{old} is now fjr_core.{new}"):
        assert getattr(fjr, old) is getattr(fjr, new)


def test_unknown_name_raises_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        fjr.nonsense  # noqa: B018
