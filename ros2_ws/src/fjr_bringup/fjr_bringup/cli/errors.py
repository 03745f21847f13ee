# SPDX-License-Identifier: Apache-2.0
"""Convert exceptions to one sentence on stderr and an exit code."""

from __future__ import annotations

import sys

from rclpy.impl.implementation_singleton import rclpy_implementation

from fjr_core.errors import CompareError, FjrError, ParameterError, RecordError, RobotError
from fjr_monitor.recording.topic import BagError
from fjr_msgs_py.console.ending import Exit, Interrupted
from fjr_msgs_py.scenarios.library import ScenarioError

INVALID_INPUT = (ScenarioError, ParameterError, CompareError, RecordError, RobotError, BagError)


def exit_code(error: Exception) -> Exit:
    """Print a user error on stderr and return its exit code; re-raise any other error."""
    if isinstance(error, Interrupted):
        kept = f"what was recorded is in {error.kept}" if error.kept else "nothing was recorded"
        _print(f"stopped; {kept}")
        return Exit.INTERRUPTED
    if isinstance(error, FjrError):
        _print(str(error))
        return Exit.NOT_UNDERSTOOD if isinstance(error, INVALID_INPUT) else Exit.FAILED
    if isinstance(error, (OSError, rclpy_implementation.RCLError)):
        _print(" ".join(str(error).split()))
        return Exit.FAILED
    raise error


def _print(sentence: str) -> None:
    print(f"fjr: {sentence}", file=sys.stderr)
