# SPDX-License-Identifier: Apache-2.0
"""Find modules of packages above this one when they are needed: each of those may be left out."""

from __future__ import annotations

from importlib import import_module
from types import ModuleType

from ..errors import MissingPackageError


def module(name: str) -> ModuleType:
    """Import a module by its full name; raise MissingPackageError, which names its package, if that is not there."""
    package = name.partition(".")[0]
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != package:
            raise
        raise MissingPackageError(
            f"this needs the package {package}, which is not installed; expected it beside fjr_core"
        ) from None


def module_if_there(name: str) -> ModuleType | None:
    """Import a module by its full name; return None if its package is not installed."""
    try:
        return module(name)
    except MissingPackageError:
        return None
