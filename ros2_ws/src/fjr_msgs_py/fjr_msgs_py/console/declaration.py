# SPDX-License-Identifier: Apache-2.0
"""Declare a command whose code is imported when it runs."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from importlib import import_module
from types import ModuleType
from typing import Any

import click


def implementation(name: str) -> ModuleType:
    """Import the module of a command by its full name, then call `loaded` (see app.main)."""
    module = import_module(name)
    click.get_current_context().obj()
    return module


COMMANDS = click.Group()
"""All commands that are declared so far; fjr_bringup.cli.app loads the declarations of every package."""


def command(name: str | None = None, **settings: Any) -> Callable[[Callable[..., Any]], click.Command]:
    """Return a decorator that declares a command with --json; settings: as of click. The function returns a Result."""

    def declare(function: Callable[..., Any]) -> click.Command:
        @wraps(function)
        def shown(as_json: bool, **given: Any) -> int:
            return int(function(**given).show(as_json))

        made = COMMANDS.command(name, **settings)(shown)
        made.params.append(click.Option(["--json", "as_json"], is_flag=True, help="Print the result as JSON."))
        return made

    return declare
