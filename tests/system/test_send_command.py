# SPDX-License-Identifier: Apache-2.0
"""`fjr send`: a controller in a running loop tracks the motion of a file, or refuses it with its reason."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from fjr_bringup import clients
from fjr_controller.controller_node import ControllerNode
from nodes.harness import PATIENCE, Listener, Peer, Ros, stamped
from system.executables import SLOW, fjr, fjr_here, running

pytestmark = pytest.mark.system
T = np.arange(1001) / 1000  # s
MOTION = 0.5 * (1 - np.cos(3 * T)) ** 3
HOLDING = ("-p", "reference.type:=hold", "-p", "limits.acceleration:=[200.0]")


def holding(loop: Mapping[str, tuple[str, ...]]) -> dict[str, tuple[str, ...]]:
    """Return the ROS arguments of a loop whose controller holds the arm until a motion is sent."""
    return {**loop, "controller": (*loop["controller"], *HOLDING)}


def motion_file(folder: Path, q: np.ndarray, header: str = "time,joint1") -> str:
    np.savetxt(folder / "motion.csv", np.stack([T, q], axis=1), "%.6f", ",", header=header, comments="")
    return str(folder / "motion.csv")


@pytest.fixture
def listener(ros: Ros) -> Listener:
    return Listener(ros, only=["fjr_controller/reference", "fjr_controller/tracking_error"])


def test_a_controller_in_a_namespace_takes_the_motion(ros: Ros, tmp_path: Path) -> None:
    peer = Peer(ros, prefix="left/")
    options = {"compile": False, "state_timeout": PATIENCE, "limits__acceleration": [200.0]}
    ros.start(ControllerNode, ["--ros-args", "-r", "__ns:=/left"], **options)
    peer.meet_controller()
    peer.ask(stamped(0.0))
    file = motion_file(tmp_path, MOTION)
    with ThreadPoolExecutor(1) as worker:
        sent = worker.submit(fjr, "send", file, "--namespace", "left", "--tolerance", "0.002")
        ros.until(sent.done, "the end of fjr send")
        assert "accepted: smoothed within" in sent.result()


def test_without_a_controller_the_command_ends_with_one_sentence(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(clients, "RESPONSE_LIMIT", 0.5)
    said = fjr_here("send", motion_file(tmp_path, MOTION), "--namespace", "left", code=1)
    assert said == (
        "fjr: /left/fjr_controller is not running, or its parameters are not available; expected an active controller\n"
    )


def test_a_motion_is_refused_with_the_reason(ros: Ros, listener: Listener, tmp_path: Path) -> None:
    with running(holding(SLOW)):
        ros.until(lambda: listener.references, "the controller")
        said = fjr_here("send", motion_file(tmp_path, MOTION, "time,elbow"), "--lead", "0.05", code=2)
        assert "the header is 'time, elbow', without joint1; expected the columns time, joint1" in said
        said = fjr_here("send", motion_file(tmp_path, MOTION + 1.0), "--lead", "0.05", code=1)
        assert "trajectory refused: joint 'joint1' would reach" in said
