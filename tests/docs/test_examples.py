# SPDX-License-Identifier: Apache-2.0
"""Every example runs unchanged."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from time_limits import HANG

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_example_runs(path: Path) -> None:
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    assert done.stdout
