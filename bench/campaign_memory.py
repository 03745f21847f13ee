# SPDX-License-Identifier: Apache-2.0
"""Check that the memory of `fjr sweep` does not depend on the number of runs."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from bench.figures import Figure

MANY, FEW = 1_000_000, 10_000
SWEEP = """
scenario: paper_k31
runs: {runs}
duration: 0.02
settle_after: 0.01
vary:
  stiffness: {{uniform: [0.7, 1.3]}}
  link_inertia: {{uniform: [0.8, 1.2]}}
  delay: {{uniform: [0.0, 1.0e-3]}}
"""


def bounded(many: int = MANY) -> list[Figure]:
    """Compare the peak resident memory of a study of many short runs with that of few, table and figure included."""
    few, most = (peak(runs) for runs in (FEW, many))
    parts = {f"{FEW:,} runs [MB]": few, f"{many:,} runs [MB]": most}
    return [Figure("memory of fjr sweep, many runs over few", most / few, "", bound=2.0, aim=1.5, parts=parts)]


def peak(runs: int) -> float:
    """Return the peak resident memory [MB] of `fjr sweep` on one core."""
    command = shutil.which("fjr")
    if command is None:
        raise RuntimeError("fjr is not on the path; expected a sourced workspace")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "short.yaml")
        file.write_text(SWEEP.format(runs=runs), encoding="utf-8")
        process = subprocess.Popen([command, "sweep", str(file), "--output", folder], stdout=subprocess.DEVNULL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"fjr sweep ended with {process.returncode}; expected 0")
    return used.ru_maxrss / 1024
