# SPDX-License-Identifier: Apache-2.0
"""Python code in new processes, as it runs where another one has compiled before."""

from __future__ import annotations

import os
import subprocess
import sys

from time_limits import HANG

CUBES = """
import casadi as ca
from fjr_core.numerics.jit import compiled
x = ca.SX.sym("x", 3)
f = compiled(ca.Function("cubes", [x], [x**3]))
print(f.class_name(), f([1, 2, 3]).full().ravel().tolist())
"""
"""Code that compiles a function and prints its class and values: COMPILED where it is machine code."""
COMPILED = "External [1.0, 8.0, 27.0]"


def started(code: str, **variables: str) -> subprocess.Popen[str]:
    """Start code in a new Python process, with these variables beside those of this one."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **variables}
    command = [sys.executable, "-c", code]
    return subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def output(process: subprocess.Popen[str]) -> str:
    """Wait for a process that succeeds; return what it printed."""
    said, _ = process.communicate(timeout=HANG)
    assert process.returncode == 0, said
    return said
