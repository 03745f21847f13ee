# SPDX-License-Identifier: Apache-2.0
"""`fjr send`: smooth the motion of a file and send it to a running controller."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np

from fjr_bringup.clients import TrajectoryClient
from fjr_core.config.controller import effort_limits
from fjr_core.config.reference import motion_of_file, motion_warnings
from fjr_core.errors import ParameterError
from fjr_core.motions.spline import SampledMotion, waypoints
from fjr_design.cli.preflight import as_list
from fjr_monitor.recording.topics import absolute
from fjr_msgs_py.console.ending import stoppable
from fjr_msgs_py.console.output import Result, tell
from fjr_msgs_py.console.ros2 import discover_quickly
from fjr_msgs_py.messages.trajectories import trajectory_message
from fjr_msgs_py.node.participant import own_node
from fjr_msgs_py.scenarios import library

EXACT = 1e-6  # rad; largest difference between the smoothed motion and that of the transmitted points


def send_motion(
    motion: Path, scenario: str | None, lead: float, tolerance: tuple[float, ...], namespace: str, controller: str
) -> Result:
    """Send the motion; its first sample is reached `lead` [s] after the controller accepts it.

    tolerance [rad, m]: largest distance from the samples, for all joints or for each.
    Print the warnings of docs/references.md if a scenario is given. Raises ParameterError for a file that is not valid,
    ClientError if the controller does not respond or refuses.
    """
    discover_quickly()
    node = absolute(f"{namespace.strip('/')}/{controller}".lstrip("/"))
    with stoppable() as stop, own_node("fjr_send") as own, closing(TrajectoryClient(own, node, stop)) as client:
        smooth = motion_of_file(str(motion), tolerance, client.joints)
        warnings = _warnings(smooth, scenario, client.joints) if scenario else []
        for sentence in warnings:
            tell(sentence)
        times, rows = waypoints(smooth, EXACT)
        client.send(trajectory_message(client.joints, times + lead, *rows))
    described = f"interpolated, {np.size(smooth.times)} samples"
    if smooth.smoothed:
        described = f"smoothed within {np.max(smooth.deviation):.2g} of the samples"
    end, rest = lead + smooth.end, rows[0, -1]
    sent = f"{len(times)} points, first sample after {lead:g} s, at rest after {end:.6g} s at {as_list(rest)}"
    values = {"controller": node, "points": len(times), "lead_s": lead, "rest_s": end, "rest": rest}
    return Result(f"accepted: {described}; {sent} rad (m)", {**values, "warnings": warnings})


def _warnings(motion: SampledMotion, scenario: str, joints: tuple[str, ...]) -> list[str]:
    """Return the warnings of a motion for the robot of a scenario."""
    loaded = library.load(scenario, robot_only=True)
    if loaded.joints != joints:
        raise ParameterError(f"{loaded.name} has the joints {loaded.joints}; expected {joints}, as the controller")
    return motion_warnings(motion, loaded.robot, joints, effort_limits(loaded.controller_values, loaded.robot))
