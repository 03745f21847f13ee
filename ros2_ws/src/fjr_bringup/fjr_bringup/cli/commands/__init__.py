# SPDX-License-Identifier: Apache-2.0
"""Declare the commands of `fjr`: names, arguments, options and help. The code behind each is imported when it runs.

A command returns a Result, which is printed as text or, with --json, as JSON.
"""

from fjr_bringup.cli.commands import scenarios  # isort: skip  # the order of the help
from fjr_bringup.cli.commands import studies  # isort: skip
from fjr_bringup.cli.commands import identification, running_loop
from fjr_bringup.cli.commands.declaration import COMMANDS

__all__ = ["COMMANDS", "identification", "running_loop", "scenarios", "studies"]
