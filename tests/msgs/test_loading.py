# SPDX-License-Identifier: Apache-2.0
"""What happens before a process loads ROS 2: signals end it without output, and ament learns where wheels are."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from fjr_msgs_py.node.loading import ament_index_of_wheels
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


def test_what_is_loaded_meanwhile_is_exempt_from_garbage_collection() -> None:
    code = """
import gc
from fjr_msgs_py.node.loading import pause_garbage_collection, resume_garbage_collection
pause_garbage_collection()
paused = not gc.isenabled()
import json
resume_garbage_collection()
print(paused, gc.isenabled(), gc.is_tracked(json.__dict__), any(held is json for held in gc.get_objects()))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True True True False\n"


@pytest.mark.parametrize(("before", "after"), [("", "{here}"), ("/ros:/own", "/ros:/own:{here}")])
def test_packages_installed_as_wheels_come_last_in_the_ament_index(
    before: str, after: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    packages = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    packages.mkdir(parents=True)
    (packages / "fjr_msgs_py").touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", before)
    for _ in range(2):
        ament_index_of_wheels()
    assert os.environ["AMENT_PREFIX_PATH"] == after.format(here=tmp_path)


def test_ament_index_stays_without_wheels(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/ros")
    ament_index_of_wheels()
    assert os.environ["AMENT_PREFIX_PATH"] == "/ros"
