# SPDX-License-Identifier: Apache-2.0
"""Code that needs a process of its own."""

from __future__ import annotations

import os
import subprocess
import sys

from patience import HANG


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python code to its end, alone in its ROS graph; its exit code and what it said."""
    quiet = {
        **os.environ,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONWARNINGS": "ignore",
    }
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], env=quiet, capture_output=True, text=True, timeout=HANG
    )
