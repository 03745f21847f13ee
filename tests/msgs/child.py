# SPDX-License-Identifier: Apache-2.0
"""Run code, or a node with code of its own, in a separate process."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import Any

from time_limits import HANG

NODE = """
import gc, os, signal, sys, weakref
from fjr_core import FjrError
from fjr_core.config.process import process_parameters
from fjr_msgs_py.node import process
from fjr_msgs_py.node.parameters import ParameterNode
from rclpy.parameter import Parameter
from std_msgs.msg import Empty
from std_srvs.srv import Trigger
class Child(ParameterNode):
    def __init__(self):
        given = [Parameter(name, value=value) for name, value in eval(sys.argv[1]).items()]
        super().__init__("child", lambda n: process_parameters(), parameter_overrides=given)
    def build(self):
        self.create_timer(0.001, self.tick)
"""


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


def run_node(code: str, *arguments: str, **parameters: Any) -> subprocess.CompletedProcess[str]:
    """Run a node with these parameters by process.run; code: what follows in the class Child, and may end it."""
    return run(f"{NODE}{code}\nsys.exit(process.run(Child))", repr(parameters), *arguments)
