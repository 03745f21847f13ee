# SPDX-License-Identifier: Apache-2.0
"""`fjr scenarios`: list what is installed. Imports nothing slow."""

from __future__ import annotations

from fjr_msgs_py.console.output import Result
from fjr_msgs_py.scenarios.installed import installed, summary


def list_scenarios() -> Result:
    """Return the installed scenarios with a summary of each."""
    found = {name: (path, summary(path)) for name, path in installed("scenarios").items()}
    text = "\n".join(f"{name:12}  {said}" for name, (_, said) in found.items())
    return Result(
        text, {"scenarios": [{"name": name, "summary": said, "file": path} for name, (path, said) in found.items()]}
    )
