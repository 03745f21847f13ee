# SPDX-License-Identifier: Apache-2.0
"""Choose the host of the control step: a native thread, or rclpy where that cannot be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.lifecycle import LifecycleNode

from fjr_core import Measurement
from fjr_core.config.controller import auxiliary_period
from fjr_core.config.process import NATIVE
from fjr_msgs_py.messages.joint_states import StateReader
from fjr_msgs_py.native.program import NativeError

from ..ros.command_conflict import CommandConflictError
from ..ros.command_loop import CommandLoop
from ..ros.diagnostics import Reports
from ..tracking.tracker import Tracker
from .command_loop import NativeCommandLoop

IN_PYTHON = "the law or the observer is evaluated in Python (compile is false, or a law of one's own)"


def command_loop(
    node: LifecycleNode,
    values: dict[str, Any],
    tracker: Tracker,
    measurement: Measurement,
    reports: Reports,
    on_conflict: Callable[[CommandConflictError], None],
) -> CommandLoop | NativeCommandLoop:
    """Return the command loop of the parameter `executor`; log the reason if it is another one than wanted."""
    joints = values["joints"]
    period = auxiliary_period(values, bool(node.get_parameter("use_sim_time").value))
    if values["executor"] == NATIVE:
        try:
            if not tracker.step.in_c:
                raise NativeError(IN_PYTHON)
            return NativeCommandLoop(node, joints, tracker, measurement, reports, on_conflict, period)
        except NativeError as error:
            node.get_logger().info(f"the command loop runs in rclpy's executor instead of a native thread: {error}")
    return CommandLoop(node, joints, tracker, StateReader(joints, measurement), reports, on_conflict, period)
