# SPDX-License-Identifier: Apache-2.0
"""A signal during the loading of a node's process ends it without output."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from time_limits import HANG

LOADING = """
import time
from fjr_msgs_py.node.loading import end_on_signals
end_on_signals()
print("loading", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_during_loading_exits_with_0(number: signal.Signals) -> None:
    command = [sys.executable, "-c", LOADING]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "loading\n"
        process.send_signal(number)
        _, output = process.communicate(timeout=HANG)
    assert (process.returncode, output) == (0, "")


def test_the_loading_module_imports_no_heavy_package() -> None:
    code = "import sys, fjr_msgs_py.node.loading, fjr_plant.executable, fjr_controller.executable; print(*sys.modules)"
    modules = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"rclpy", "numpy", "casadi", "fjr_core"} & set(modules)
