# SPDX-License-Identifier: Apache-2.0
"""Contradictions of a record are found and named: one labelled record each; healthy records pass.

Mistakes in one joint of two: `system/test_identify_contradictions.py`; of a real record: `system/test_records.py`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import fjr_core as fjr
from bench.identification import draw
from fjr_core.errors import RecordError
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.record_checks import findings
from fjr_identification.scale_checks import LONGEST, _most_moving, unseen
from identification import recorded_joint

Change = Callable[[MotionRecord], MotionRecord]
SIGNALS = ("u", "q_l", "q_m", "torque")


def clipped(record: MotionRecord) -> MotionRecord:
    return replace(record, u=np.clip(record.u, -20.0, 20.0))


def rows(record: MotionRecord, part: slice, **changes: float) -> MotionRecord:
    return replace(record, **{name: getattr(record, name)[part] for name in SIGNALS}, **changes)


LABELLED: dict[str, tuple[Change, str, str]] = {
    "sign of the effort": (lambda r: replace(r, u=-r.u), "sign", "times the torque that its motion needs"),
    "both sides in degrees": (
        lambda r: replace(r, q_l=np.degrees(r.q_l), q_m=np.degrees(r.q_m)),
        "degrees",
        "as degrees only; expected rad",
    ),
    "motors in turns": (lambda r: replace(r, q_m=r.q_m / (2 * np.pi)), "gear_ratio", "turns against rad"),
    "at rest": (
        lambda r: replace(r, q_l=0 * r.q_l + 1e-6 * np.sin(np.arange(len(r.u)))[:, None], q_m=0 * r.q_m),
        "at_rest",
        "expected a record of motion",
    ),
    "constant effort": (lambda r: replace(r, u=0 * r.u + 2.0), "constant", "u of joint1 is 2 at every sample"),
    "constant link": (lambda r: replace(r, q_l=0 * r.q_l), "constant", "q_l of joint1 is 0 at every sample"),
    "too short": (lambda r: rows(r, slice(99)), "too_short", "has 99 samples; expected at least 200"),
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
    assert {finding.kind for finding in found} == {kind}
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
    assert "clipped" not in [finding.kind for finding in found]


def test_accepted_kinds_do_not_hide_others() -> None:
    record = clipped(replace(recorded_joint.record(), u=-recorded_joint.record().u))
    kinds = [finding.kind for finding in findings(record, recorded_joint.robot(), accepted=("sign",))]
    assert list(dict.fromkeys(kinds)) == ["sign", "clipped"]


def test_joint_at_rest_next_to_a_moving_one_is_listed() -> None:
    one = recorded_joint.record()
    still = np.zeros_like(one.u)
    columns = {name: np.hstack([getattr(one, name), still]) for name in ("u", "q_l", "q_m")}
    both = replace(one, joints=("joint1", "joint2"), torque=np.full_like(columns["u"], np.nan), **columns)
    assert both.still == ("joint2",)
    with pytest.raises(RecordError, match="has 2 joints; expected 1, as the robot"):
        findings(both, recorded_joint.robot())


def motor_side() -> MotionRecord:
    record = recorded_joint.record()
    return replace(record, q_l=np.nan * record.q_l)


@pytest.mark.parametrize("factor", [0.01, 0.5, 2.0, 100.0])
@pytest.mark.parametrize("with_effort", [False, True])
def test_wrong_gear_ratio_of_the_only_side_is_found(factor: float, with_effort: bool) -> None:
    right = motor_side()
    record = replace(right, q_m=right.q_m * factor, u=right.u / factor if with_effort else right.u)
    found = findings(record, recorded_joint.robot())
    assert {finding.kind for finding in found} <= {"gear_ratio", "effort_scale"}
    assert [finding.joint for finding in found] == ["joint1"]


def test_the_minute_of_a_long_record_is_compared_in_which_the_joint_moves() -> None:
    """Rows of ten minutes would be too far apart for accelerations."""
    right = motor_side()
    rest = [np.repeat(getattr(right, name)[[0]], round(300.0 / right.dt), 0) for name in SIGNALS]
    long = {name: np.vstack([still, getattr(right, name), still]) for name, still in zip(SIGNALS, rest, strict=True)}
    compared = _most_moving(replace(right, **long))
    assert len(compared.u) * right.dt == pytest.approx(LONGEST, abs=right.dt)
    assert np.ptp(compared.q_m) == np.ptp(right.q_m)
    assert _most_moving(right) is right


def test_what_one_side_cannot_reveal_is_stated() -> None:
    robot, record = recorded_joint.robot(), motor_side()
    (said,) = unseen(record, robot)
    assert "joint1 has no link encoder: a wrong gear ratio (up to " in said
    assert "would bias motor inertia, stiffness and friction" in said
    assert unseen(recorded_joint.record(), robot) == ()
    slightly_wrong = replace(record, q_m=1.01 * record.q_m)
    assert findings(slightly_wrong, robot) == ()
    assert unseen(slightly_wrong, robot) != ()
    assert unseen(rows(record, slice(210)), robot) == ()  # too short
    assert unseen(rows(record, slice(0, 25 * 18, 25), dt=25 * record.dt), robot) == ()  # too few samples


@pytest.mark.parametrize(("n", "measured"), [(1, "motor"), (1, "link-torque"), (2, "motor-torque")])
def test_healthy_record_of_the_coverage_study_has_no_finding(n: int, measured: str) -> None:
    case = draw(n, 2, duration=8.0, measured=measured)
    guessed = {name: np.diag(case.prior.values[name]) for name in ("joint_stiffness", "motor_inertia")}
    robot = replace(case.robot, K=guessed["joint_stiffness"], M_m=guessed["motor_inertia"])
    assert findings(case.record, robot) == ()
