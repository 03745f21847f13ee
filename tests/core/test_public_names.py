# SPDX-License-Identifier: Apache-2.0
"""Public names of before keep working for one version and name their successor."""

from __future__ import annotations

import pytest

import fjr_core as fjr


@pytest.mark.parametrize(("old", "new"), fjr._RENAMED.items())
def test_a_renamed_name_is_the_new_one_and_says_so(old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"fjr_core.{old} is now fjr_core.{new}"):
        assert getattr(fjr, old) is getattr(fjr, new)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        fjr.nonsense  # noqa: B018
