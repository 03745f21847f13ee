# SPDX-License-Identifier: Apache-2.0
"""Python and a native loop share nothing without an order between them, which a processor such as ARM needs.

ThreadSanitizer finds that on every processor. Only our C is compiled for it, with its accesses; of Python and the
middleware it sees locks, and copies of memory. What they do among themselves is left out.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from program_cache import built
from time_limits import HANG

SHIM = Path(__file__).with_name("for_sanitizer.c")
ACCESS = re.compile(r" of size \d+ at .*\n((?: +#\d.*\n)+)")
"""Stack of an access in a report, the innermost function first."""
OURS = re.compile(r"code\.c:|(fjr_\w+|control_step)-\w+\.so")
"""C that is compiled on demand, with or without its lines."""


def sanitizer() -> str:
    """Return the path of ThreadSanitizer of the compiler, "" if it is not there."""
    found = subprocess.run(["gcc", "-print-file-name=libtsan.so"], capture_output=True, text=True) if GCC else None
    return found.stdout.strip() if found and "/" in found.stdout else ""


GCC, FIXED = shutil.which("gcc"), shutil.which("setarch")
TSAN = sanitizer()


def is_ours(stack: str) -> bool:
    """Return whether our C made an access, itself or by a function that the sanitizer replaces, such as memcpy."""
    innermost = next((line for line in stack.splitlines() if "libtsan" not in line), "")
    return bool(OURS.search(innermost))


@pytest.mark.full
@pytest.mark.skipif(not (TSAN and FIXED), reason="no libtsan of gcc, or no setarch")
def test_the_threads_of_native_loops_and_python_share_nothing_without_an_order(tmp_path: Path) -> None:
    shim = built(("gcc", "-shared", "-fPIC", "-O1"), [SHIM], tmp_path / "shim.so")
    environment = {
        **os.environ,
        "CC": "env -u LD_PRELOAD gcc -fsanitize=thread -g",
        "LD_PRELOAD": f"{shim}:{TSAN}",
        "TSAN_OPTIONS": f"log_path={tmp_path}/report exitcode=0 detect_deadlocks=0 report_mutex_bugs=0",
        "PYTHONPATH": f"{Path(__file__).parents[1]}:{os.environ.get('PYTHONPATH', '')}",
    }
    command = [str(FIXED), "-R", sys.executable, "-m", "nodes.racing"]  # -R: without random addresses, which it needs
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANG)
    assert done.stdout.endswith("done\n"), done.stderr
    reports = "".join(file.read_text() for file in tmp_path.glob("report.*")).split("=" * 18)
    assert not [report for report in reports if any(map(is_ours, ACCESS.findall(report)))]
