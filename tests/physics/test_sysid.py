# SPDX-License-Identifier: Apache-2.0
"""mujoco.sysid reads the records of the other simulator: without dry friction it finds the joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.identification_peers import NAMES, theirs
from physics.arm import Arm
from physics.draws import Case, drawn
from physics.sysid import case_of


def _smooth(arm: Arm) -> Arm:
    return replace(arm, link_friction=0 * arm.link_friction, motor_friction=0 * arm.motor_friction)


def test_mujoco_finds_a_joint_without_dry_friction_in_a_record_of_the_other_simulator() -> None:
    case = case_of(drawn(Case(varied=_smooth, duration=1.5), 1, 1, seed=2), 0)
    truth, start = ({name: known[name] for name in NAMES} for known in (case.truth, case.start))
    found = theirs(replace(case, truth=truth, start=start), pieces=3)
    np.testing.assert_allclose(found.values[:2], [truth[name] for name in NAMES[:2]], rtol=1e-3)
