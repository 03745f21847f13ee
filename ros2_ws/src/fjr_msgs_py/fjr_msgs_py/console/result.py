# SPDX-License-Identifier: Apache-2.0
"""The result of a command: text for a reader, values for a program."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Result:
    """text: printed by default; values: printed as JSON instead if asked for; code: exit code."""

    text: str
    values: Mapping[str, Any]
    code: int = 0

    def show(self, as_json: bool) -> int:
        """Print the text, or one JSON document; return the exit code."""
        print(json_text(self.values, indent=2) if as_json else self.text, flush=True)
        return self.code


def json_text(values: Any, indent: int | None = None) -> str:
    """Return values as JSON: paths as text, arrays as lists, numbers that are not finite as null."""
    return json.dumps(finite(values), indent=indent, default=str, allow_nan=False)


def finite(value: Any) -> Any:
    """Return the value with None for numbers that are not finite, and arrays and tuples as lists."""
    if hasattr(value, "tolist"):  # NumPy's arrays and numbers
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
