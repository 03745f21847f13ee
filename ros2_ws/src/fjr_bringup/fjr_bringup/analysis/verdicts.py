# SPDX-License-Identifier: Apache-2.0
"""The verdict on a recorded run: fjr_core's, on what the bag holds."""

from __future__ import annotations

import numpy as np

from fjr_bringup.analysis.run_data import TrackingData
from fjr_core.config import builders
from fjr_core.config.diagnosis import axes
from fjr_core.config.scenario import Scenario
from fjr_core.control.vdpbc.law import TrackingLaw
from fjr_core.monitoring.diagnosis import Verdict, judge, unknown
from fjr_core.monitoring.record import Record

__all__ = ["Verdict", "record", "verdict"]


def verdict(data: TrackingData, scenario: Scenario) -> Verdict:
    """Whether V fell as proven, and why not."""
    if not isinstance(scenario.law, TrackingLaw):
        return unknown(f"the law {scenario.controller_values['law.type']} has no certificate")
    if not np.isfinite(data.V).any():
        return unknown("V is not known, for want of both sides of each joint")
    if not np.isfinite(data.u).any():
        return unknown("no effort of the controller was recorded")
    if not builders.robust(scenario.controller_values, scenario.robot.n).off:
        return unknown(
            "the law ran with robust action (robust.*), of which V here, the law's without it, knows nothing"
        )
    judged = axes(scenario.controller_values, scenario.robot)
    return judge(record(data, scenario), scenario.law, data.beta, judged, data.velocities_measured)


def record(data: TrackingData, scenario: Scenario) -> Record:
    """The recorded run as fjr_core judges it; in lock-step the clock says nothing of when efforts acted."""
    known = bool(np.isfinite(data.torque).any())
    return Record(
        t=data.t,
        position=data.position,
        velocity=data.velocity,
        jets=data.jets,
        u=data.u,
        u_applied=data.torque @ np.linalg.inv(scenario.robot.B_m).T if known else None,
        sent=None if data.lockstep else data.sent,
        answered=None if data.lockstep else data.answered,
        sample_period=data.sample_period,
        effort_limit=data.effort_limit,
    )
