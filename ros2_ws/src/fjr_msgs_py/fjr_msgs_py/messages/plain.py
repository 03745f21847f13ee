# SPDX-License-Identifier: Apache-2.0
"""Convert any message to plain Python values."""

from __future__ import annotations

from typing import Any


def plain(value: Any) -> Any:
    """Return a message as a dict of its fields in their order; sequences as lists, a byte as an integer."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if isinstance(value, (str, bool, int, float)):
        return value
    if hasattr(value, "tolist"):  # array.array and NumPy's
        return value.tolist()
    return [plain(entry) for entry in value]
