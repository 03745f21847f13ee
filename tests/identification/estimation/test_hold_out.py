# SPDX-License-Identifier: Apache-2.0
"""A record that was not used is predicted better by the identified model than without elasticity or without skew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fjr_design.uncertainty.posterior import IDENTIFIED, Estimate, Identification
from fjr_identification.estimation.hold_out import hold_out
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import Options, Prior
from identification.estimation import recorded_joint

LATE = 2  # samples by which the link encoder is read late


def late_link() -> MotionRecord:
    whole = recorded_joint.record()
    return replace(whole, q_l=np.vstack([whole.q_l[:LATE], whole.q_l[: len(whole.q_l) - LATE]]))


def estimate(name: str, value: float) -> Estimate:
    return Estimate(name, "joint1", "", value, value, value, value, IDENTIFIED)


def test_model_explains_more_of_the_deflection_than_rigid_joints_or_no_skew() -> None:
    robot, prior = recorded_joint.robot(), Prior.of(recorded_joint.robot())
    true = (
        estimate("link_skew", -LATE * recorded_joint.DT),
        estimate("link_coulomb_friction", recorded_joint.COULOMB),
    )
    found = Identification(("joint1",), true, (), (), np.zeros(0), np.zeros((0, 0)))
    compared = hold_out(found, late_link(), robot, prior, Options())
    assert compared.model[0] < 0.1
    assert compared.model[0] < compared.no_skew[0] / 2
    assert compared.model[0] < compared.rigid[0] / 2
    record = late_link()
    skewed = np.std(record.q_m - record.q_l)
    assert compared.rigid[0] == pytest.approx(np.std(record.q_m[:-LATE] - record.q_l[LATE:]) / skewed, rel=0.1)
