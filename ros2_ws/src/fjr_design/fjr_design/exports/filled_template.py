# SPDX-License-Identifier: Apache-2.0
"""Fill the templates of an export: @{name} is replaced by a value."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from string import Template


class _CTemplate(Template):
    """Template with @{name} for values, since C, CMake and Markdown use `$` themselves."""

    delimiter = "@"


def filled(template: str, values: Mapping[str, str], folder: str = "templates") -> str:
    """Return the text of a template of a folder below codegen/ with its values."""
    text = (files("fjr_design.exports") / folder / f"{template}.in").read_text(encoding="utf-8")
    return _CTemplate(text).substitute(values)
