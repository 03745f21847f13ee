# SPDX-License-Identifier: Apache-2.0
"""Run code in a separate process."""

from __future__ import annotations

import os
import subprocess
import sys

from time_limits import HANG


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python code in an isolated ROS graph; return exit code and output."""
    quiet = {
        **os.environ,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONWARNINGS": "ignore",
    }
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], env=quiet, capture_output=True, text=True, timeout=HANG
    )
