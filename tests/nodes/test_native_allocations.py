# SPDX-License-Identifier: Apache-2.0
"""The threads of the native loops allocate no memory while they run, except in the middleware that they call."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from design.exports.c_program import built
from time_limits import HANG

COUNTER = Path(__file__).with_name("allocations.c")
MIDDLEWARE = re.compile(r"lib(stdc\+\+|fastcdr|fastrtps|fastdds|rmw|rcl|rcutils|tracetools)")
"""Libraries of ROS 2 and Fast DDS, and the one that has the operator new of C++."""
LOOPS = ("controller_loop", "fjr_plant")


@pytest.fixture(scope="module")
def allocations(tmp_path_factory: pytest.TempPathFactory) -> Counter[tuple[str, str]]:
    """Calls of allocators by thread, named by the library that began it, and calling library."""
    counter = built(("cc", "-shared", "-fPIC", "-O1"), [COUNTER], tmp_path_factory.mktemp("counter") / "counter.so")
    tests = str(Path(__file__).parents[1])
    outside = {**os.environ, "LD_PRELOAD": str(counter), "PYTHONPATH": f"{tests}:{os.environ.get('PYTHONPATH', '')}"}
    command = [sys.executable, "-m", "nodes.count_allocations"]
    done = subprocess.run(command, env=outside, capture_output=True, text=True, timeout=HANG)
    assert done.returncode == 0, done.stderr
    found: Counter[tuple[str, str]] = Counter()
    for thread, caller, count in (line.split() for line in done.stdout.splitlines()):
        found[Path(thread).name, Path(caller).name] += int(count)
    return found


@pytest.mark.parametrize("loop", LOOPS)
def test_the_thread_of_a_native_loop_allocates_only_in_the_middleware(
    allocations: Counter[tuple[str, str]], loop: str
) -> None:
    callers = {caller for thread, caller in allocations if thread.startswith(loop)}
    assert "libstdc++.so.6" in callers  # the counter sees this thread
    assert not [caller for caller in callers if not MIDDLEWARE.match(caller)]
