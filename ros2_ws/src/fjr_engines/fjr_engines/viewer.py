# SPDX-License-Identifier: Apache-2.0
"""Show a running arm in MuJoCo's viewer: a process of its own, which takes the newest of /joint_states."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from tempfile import TemporaryDirectory, TemporaryFile

import numpy as np

from fjr_core.config.scenario import parse_scenario
from fjr_core.errors import FjrError

from .drawing import DrawnArm

PERIOD = 1.0 / 60.0  # s between two pictures
GRACE = 5.0  # s to close the window
NICE = 5  # below the nodes where those have no real-time priority


class ViewerError(FjrError):
    """A window cannot be shown here."""


def check() -> None:
    """Raise ViewerError unless a display is there."""
    if sys.platform == "linux" and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewerError("--viewer needs a display, and DISPLAY is not set; expected a desktop, or --film FILE")


@contextmanager
def shown(name: str, text: str) -> Iterator[None]:
    """Show the arm of a scenario, by name and text, until the block ends or the user closes the window.

    Raises RobotError for a robot that MuJoCo cannot express.
    """
    scenario = parse_scenario(name, text)
    with TemporaryFile() as arm, TemporaryDirectory(prefix="fjr-viewer-") as folder:  # where MuJoCo logs its errors
        pickle.dump((DrawnArm(scenario), scenario.joints), arm)
        arm.seek(0)
        process = subprocess.Popen([sys.executable, "-m", "fjr_engines.viewer"], stdin=arm, cwd=folder)
        try:
            yield
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(GRACE)
            process.kill()
            process.wait()


def main() -> None:
    """Read (arm, joints) and show the arm at the positions of both sides that /joint_states gives."""
    import mujoco.viewer
    import rclpy
    from rclpy.executors import ExternalShutdownException
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import JointState

    from fjr_msgs_py.names import JOINT_STATES, state_names

    (arm, joints), newest = pickle.load(sys.stdin.buffer), dict[str, float]()
    os.nice(NICE)
    rclpy.init()
    node = rclpy.create_node("fjr_viewer")
    qos = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)  # the plant waits for no answer
    node.create_subscription(JointState, JOINT_STATES, lambda m: newest.update(zip(m.name, m.position)), qos)  # noqa: B905
    with suppress(ExternalShutdownException):  # the run has ended
        while not newest:
            rclpy.spin_once(node)
        seen = arm.camera(np.array([[newest[joint] for joint in joints]]))
        with mujoco.viewer.launch_passive(arm.model, arm.data, show_left_ui=False, show_right_ui=False) as window:
            for name in ("lookat", "azimuth", "elevation", "distance"):
                setattr(window.cam, name, getattr(seen, name))
            while window.is_running():
                rclpy.spin_once(node, timeout_sec=PERIOD)
                with window.lock():
                    arm.pose(*np.split(np.array([newest.get(name, np.nan) for name in state_names(joints)]), 2))
                window.sync()
                time.sleep(PERIOD)
    node.destroy_node()
    os._exit(0)  # glfw would wait for ever for the thread of the window


if __name__ == "__main__":
    main()
