# SPDX-License-Identifier: Apache-2.0
"""The tracker needs neither ROS nor messages."""

from __future__ import annotations

import subprocess
import sys

IMPORT_ALL = """
import importlib, pkgutil, sys
import fjr_controller.tracking as tracking
for module in pkgutil.iter_modules(tracking.__path__):
    importlib.import_module(f"{tracking.__name__}.{module.name}")
print(*{name.partition(".")[0] for name in sys.modules})
"""


def test_the_tracker_imports_no_ros() -> None:
    loaded = subprocess.run([sys.executable, "-c", IMPORT_ALL], capture_output=True, text=True, check=True).stdout
    assert "fjr_core" in loaded.split()
    assert not {"rclpy", "sensor_msgs", "std_msgs", "fjr_msgs_py"} & set(loaded.split())
