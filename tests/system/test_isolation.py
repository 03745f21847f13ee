# SPDX-License-Identifier: Apache-2.0
"""What hangs in a process of tests is ended, with the stacks of its threads; the files that start first are there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from longest_first import LONGEST_FIRST
from time_limits import HANG

TESTS = Path(__file__).parents[1]

TEARDOWN = """
import sys, threading, isolation
isolation.END_LIMIT = 0.2
with isolation.ends_in_time(sys.stderr.fileno()):
    threading.Event().wait()
"""
EXIT = """
import sys, threading, isolation
isolation.END_LIMIT = 0.2
isolation.end_soon(sys.stderr.fileno())
threading.Thread(target=threading.Event().wait).start()  # the interpreter waits for it
"""


@pytest.mark.parametrize("code", [TEARDOWN, EXIT], ids=["teardown", "exit"])
def test_what_hangs_is_ended_with_its_stacks(code: str) -> None:
    done = subprocess.run([sys.executable, "-c", code], cwd=TESTS, capture_output=True, text=True, timeout=HANG)
    assert done.returncode != 0
    assert "Timeout" in done.stderr
    assert "threading.py" in done.stderr


def test_the_files_that_start_first_are_there() -> None:
    assert [name for name in LONGEST_FIRST if not (TESTS / name).is_file()] == []
