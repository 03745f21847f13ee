# SPDX-License-Identifier: Apache-2.0
"""Contradictions of a record are found and named: one labelled record each, of one joint and of a real robot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.errors import RecordError
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.record_checks import findings
from identification.estimation import recorded_joint

Change = Callable[[MotionRecord], MotionRecord]


def clipped(record: MotionRecord) -> MotionRecord:
    return replace(record, u=np.clip(record.u, -20.0, 20.0))


LABELLED: dict[str, tuple[Change, str, str]] = {
    "sides swapped": (
        lambda r: replace(r, q_l=r.q_m, q_m=r.q_l),
        "swapped_sides",
        "sides swapped",
    ),
    "gear ratio of 101 in place of 100": (
        lambda r: replace(r, q_m=r.q_m * 1.01),
        "gear_ratio",
        "q_m of joint1 moves 1.01 times as far as q_l; expected 1",
    ),
    "gear ratio left out": (lambda r: replace(r, q_m=r.q_m * 100.0), "gear_ratio", "wrong gear ratio"),
    "sign of one side": (lambda r: replace(r, q_l=-r.q_l), "sign", "q_m of joint1 moves against q_l"),
    "sign of the effort": (lambda r: replace(r, u=-r.u), "sign", "times the torque that its motion needs"),
    "sign of the torque sensor": (
        lambda r: replace(r, torque=-recorded_joint.K * (r.q_m - r.q_l)),
        "sign",
        "torque of joint1 is -",
    ),
    "effort at the shaft of the motor": (lambda r: replace(r, u=r.u / 100.0), "effort_scale", "gear ratio, unit"),
    "both sides in degrees": (
        lambda r: replace(r, q_l=np.degrees(r.q_l), q_m=np.degrees(r.q_m)),
        "degrees",
        "as degrees only; expected rad",
    ),
    "motors in degrees": (lambda r: replace(r, q_m=np.degrees(r.q_m)), "degrees", "degrees against rad"),
    "motors in turns": (lambda r: replace(r, q_m=r.q_m / (2 * np.pi)), "gear_ratio", "turns against rad"),
    "at rest": (
        lambda r: replace(r, q_l=0 * r.q_l + 1e-6 * np.sin(np.arange(len(r.u)))[:, None], q_m=0 * r.q_m),
        "at_rest",
        "expected a record of motion",
    ),
    "clipped effort": (clipped, "clipped", "expected an effort that is not clipped"),
    "constant effort": (lambda r: replace(r, u=0 * r.u + 2.0), "constant", "u of joint1 is 2 at every sample"),
    "constant link": (lambda r: replace(r, q_l=0 * r.q_l), "constant", "q_l of joint1 is 0 at every sample"),
    "too short": (
        lambda r: replace(r, u=r.u[:99], q_l=r.q_l[:99], q_m=r.q_m[:99], torque=r.torque[:99]),
        "too_short",
        "has 99 samples; expected at least 200",
    ),
}


def test_good_record_has_no_contradiction() -> None:
    record = recorded_joint.record()
    assert findings(record, recorded_joint.robot()) == ()
    assert findings(replace(record, q_l=np.nan * record.q_l), recorded_joint.robot()) == ()
    assert findings(replace(record, torque=recorded_joint.K * (record.q_m - record.q_l)), recorded_joint.robot()) == ()


@pytest.mark.parametrize("label", LABELLED)
def test_labelled_contradiction_is_named(label: str) -> None:
    change, kind, sentence = LABELLED[label]
    found = findings(change(recorded_joint.record()), recorded_joint.robot())
    assert {each.kind for each in found} == {kind}
    assert sentence in found[0].sentence


@pytest.mark.parametrize("factor", [0.3, 3.0])
def test_robot_file_that_is_wrong_by_a_factor_causes_no_finding(factor: float) -> None:
    guessed = fjr.single_link(
        stiffness=factor * recorded_joint.K,
        link_inertia=recorded_joint.J / factor,
        motor_inertia=factor * recorded_joint.B,
        gravity_torque=recorded_joint.WEIGHT / factor,
    )
    assert findings(recorded_joint.record(), guessed) == ()


def test_smooth_peaks_of_a_coarse_effort_are_not_clipped() -> None:
    record = recorded_joint.record()
    t = record.dt * np.arange(len(record.u))
    smooth = record.u + 40.0 * np.sin(2 * np.pi * 0.1 * t)[:, None]  # largest at a slow peak
    found = findings(replace(record, u=np.round(smooth, 1)), recorded_joint.robot(), ("sign", "effort_scale"))
    assert "clipped" not in [each.kind for each in found]


def test_accepted_kinds_do_not_hide_others() -> None:
    record = clipped(replace(recorded_joint.record(), u=-recorded_joint.record().u))
    kinds = [each.kind for each in findings(record, recorded_joint.robot(), accepted=("sign",))]
    assert list(dict.fromkeys(kinds)) == ["sign", "clipped"]


def test_joint_at_rest_beside_a_moving_one_is_listed() -> None:
    one = recorded_joint.record()
    still = np.zeros_like(one.u)
    columns = {name: np.hstack([getattr(one, name), still]) for name in ("u", "q_l", "q_m")}
    both = replace(one, joints=("joint1", "joint2"), torque=np.full_like(columns["u"], np.nan), **columns)
    assert both.still == ("joint2",)


def test_record_of_another_robot_is_refused() -> None:
    record = replace(
        recorded_joint.record(),
        joints=("joint1", "joint2"),
        **dict.fromkeys(("u", "q_l", "q_m", "torque"), np.zeros((300, 2))),
    )
    with pytest.raises(RecordError, match="has 2 joints; expected 1, as the robot"):
        findings(record, recorded_joint.robot())
