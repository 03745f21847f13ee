# SPDX-License-Identifier: Apache-2.0
"""Gear ratios and times of one-sided records: errors are found, healthy records pass, and the limits are stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.identification import draw
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.record_checks import findings
from fjr_identification.scale_checks import LONGEST, _most_moving, unseen
from identification.estimation import recorded_joint


def motor_side() -> MotionRecord:
    record = recorded_joint.record()
    return replace(record, q_l=np.nan * record.q_l)


@pytest.mark.parametrize("factor", [0.01, 0.5, 2.0, 100.0])
@pytest.mark.parametrize("with_effort", [False, True])
def test_wrong_gear_ratio_of_the_only_side_is_found(factor: float, with_effort: bool) -> None:
    right = motor_side()
    record = replace(right, q_m=right.q_m * factor, u=right.u / factor if with_effort else right.u)
    found = findings(record, recorded_joint.robot())
    assert {each.kind for each in found} <= {"gear_ratio", "effort_scale"}
    assert [each.joint for each in found] == ["joint1"]


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_wrong_time_of_the_only_side_is_found(factor: float) -> None:
    record = replace(motor_side(), dt=factor * motor_side().dt)
    (found,) = findings(record, recorded_joint.robot())
    assert found.kind == "time_scale"
    assert f"a time {1 / factor:g} times as long" in found.sentence


def test_the_minute_of_a_long_record_is_compared_in_which_the_joint_moves() -> None:
    """Rows of ten minutes would be too far apart for accelerations."""
    right, names = motor_side(), ("u", "q_l", "q_m", "torque")
    rest = [np.repeat(getattr(right, name)[[0]], round(300.0 / right.dt), 0) for name in names]
    long = {name: np.vstack([still, getattr(right, name), still]) for name, still in zip(names, rest, strict=True)}
    compared = _most_moving(replace(right, **long))
    assert len(compared.u) * right.dt == pytest.approx(LONGEST, abs=right.dt)
    assert np.ptp(compared.q_m) == np.ptp(right.q_m)
    assert _most_moving(right) is right


def test_what_one_side_cannot_reveal_is_stated() -> None:
    (said,) = unseen(motor_side(), recorded_joint.robot())
    assert "joint1 has no link encoder: a wrong gear ratio (up to " in said
    assert "would bias motor inertia, stiffness and friction" in said
    assert unseen(recorded_joint.record(), recorded_joint.robot()) == ()
    slightly_wrong = replace(motor_side(), q_m=1.01 * motor_side().q_m)
    assert findings(slightly_wrong, recorded_joint.robot()) == ()
    assert unseen(slightly_wrong, recorded_joint.robot()) != ()


def test_a_short_record_is_not_compared() -> None:
    record = motor_side()
    short = {name: getattr(record, name)[:210] for name in ("u", "q_l", "q_m", "torque")}
    assert unseen(replace(record, **short), recorded_joint.robot()) == ()
    slow = {name: getattr(record, name)[::25][:18] for name in ("u", "q_l", "q_m", "torque")}
    assert unseen(replace(record, dt=25 * record.dt, **slow), recorded_joint.robot()) == ()


@pytest.mark.parametrize(("n", "measured"), [(1, "motor"), (1, "link-torque"), (2, "motor-torque")])
def test_healthy_record_of_the_coverage_study_has_no_finding(n: int, measured: str) -> None:
    case = draw(n, 2, duration=8.0, measured=measured)
    guessed = {name: np.diag(case.prior.values[name]) for name in ("joint_stiffness", "motor_inertia")}
    robot = replace(case.robot, K=guessed["joint_stiffness"], M_m=guessed["motor_inertia"])
    assert findings(case.record, robot) == ()
