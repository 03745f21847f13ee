# SPDX-License-Identifier: Apache-2.0
"""The arm over ROS in real time, as run by `fjr run`: tracking error and share of commands in time."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from bench.figures import Figure
from bench.start_up import DOMAIN
from fjr_bringup.cli.exit_codes import Exit

REPEATS = 3
BOUND = 2e-4  # rad, after 2 s


def tracking() -> list[Figure]:
    """Return the medians of several runs of 5 s; the error is the largest of all joints."""
    reports = [_report() for _ in range(REPEATS)]
    errors = [report["tracking"]["max_error_after_2s_rad"] for report in reports]
    in_time = [100 * report["counts"]["answered_in_time_fraction"] for report in reports]
    parts = {"answered in time [%]": float(np.median(in_time)), "least [%]": min(in_time), "most [rad]": max(errors)}
    return [
        Figure("arm7 over ROS, 1 kHz in real time, error", float(np.median(errors)), "rad", bound=BOUND, parts=parts)
    ]


def _report() -> dict[str, Any]:
    environment = {"ROS_DOMAIN_ID": DOMAIN, **os.environ}
    with tempfile.TemporaryDirectory() as folder:
        command = ["fjr", "run", "arm7", "--output", folder]
        done = subprocess.run(command, env=environment, capture_output=True)
        if done.returncode not in (Exit.DONE, Exit.VIOLATED, Exit.LATE):  # the diagnosis is not measured here
            done.check_returncode()
        return dict(json.loads(Path(folder, "arm7", "report.json").read_text(encoding="utf-8")))
