# SPDX-License-Identifier: Apache-2.0
"""Missing sensors and unseen gear ratios are said in the words of docs/from_csv.md, equal reasons once, K first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from docs.pages import ROOT
from fjr_design.uncertainty.posterior import IDENTIFIED, UNKNOWN, WEAK, Estimate, Identification
from fjr_identification.cli.identify import table
from fjr_identification.page import groups, reasons
from fjr_identification.records.missing_sensors import LACKING, NOT_SEEN, lacking
from system.motion_tables import one_joint, two_joints

SENSORS = {"link": "link encoder", "motor": "motor encoder", "torque": "torque sensor"}
PAGE = " ".join((ROOT / "docs" / "from_csv.md").read_text(encoding="utf-8").split())


@pytest.mark.parametrize("measured", [("motor",), ("link",), ("motor", "torque"), ("link", "torque")], ids="-".join)
def test_missing_sensors_are_named_with_what_stays_unknown(measured: tuple[str, ...]) -> None:
    record = one_joint().of(*measured).record
    absent = tuple(sensor for name, sensor in SENSORS.items() if name not in measured)
    sensors, scales = lacking([record], one_joint().guess)
    assert sensors == f"joint1: no {' and no '.join(absent)}: {LACKING[absent]}"
    assert scales.startswith("joint1: one side only is measured: a wrong gear ratio (up to ")
    assert scales.endswith(NOT_SEEN)
    assert f"| no {' and no '.join(absent)} | {LACKING[absent]} |" in PAGE
    assert NOT_SEEN in PAGE


def test_joints_that_lack_the_same_share_a_sentence_and_nothing_is_missing_that_some_record_has() -> None:
    both, alone = one_joint().record, one_joint().guess
    assert lacking([both], alone) == []
    assert not [each for each in lacking([both, one_joint().of("motor").record], alone) if "no link" in each]
    record, robot = two_joints().of("motor").record, two_joints().guess
    first, scales = lacking([record], robot)
    assert first.startswith("shoulder, elbow: no link encoder and no torque sensor: ")
    assert scales.startswith("shoulder, elbow: one side only is measured: ")
    link = record.q_m.copy()
    link[:, 1] = np.nan
    assert lacking([replace(record, q_l=link)], robot)[0].startswith("elbow: no link encoder")


LITTLE = "it deflects too little"
ESTIMATES = (
    Estimate("joint_stiffness", "a1", "N m/rad", 41.0, 40.0, 42.0, 60.0, IDENTIFIED),
    Estimate("joint_stiffness", "a2", "N m/rad", 40.0, 4.0, 400.0, 40.0, UNKNOWN, LITTLE),
    Estimate("joint_stiffness", "a3", "N m/rad", 40.0, 4.0, 400.0, 40.0, UNKNOWN, LITTLE),
    Estimate("motor_inertia", "a3", "kg m^2", 0.02, 0.01, 0.06, 0.02, UNKNOWN, LITTLE),
    *(
        Estimate(
            "link_damping", of, "N m s/rad", 0.3, 0.1, 0.6, 0.2, WEAK, f"nearly the effect of link skew of {of}; faster"
        )
        for of in ("a1", "a2")
    ),
    Estimate("offset", "a3", "rad", 1e-3, 9e-4, 1.1e-3, 0.0, UNKNOWN, LITTLE),
)
MADE = Identification(("a1", "a2", "a3"), ESTIMATES, (), (), np.zeros(0), np.zeros((0, 0)))


def test_equal_reasons_are_said_once_with_their_parameters() -> None:
    assert reasons(MADE) == {
        LITTLE: "joint_stiffness of a2, a3; motor_inertia, offset of a3",
        "nearly the effect of link skew of the same joint; faster": "link_damping of a1, a2",
    }
    assert list(reasons(MADE, WEAK)) == list(reasons(MADE))[1:]
    numbers = [row.reason for _, rows in groups(MADE) for row in rows]
    assert numbers == [None, 1, 1, 1, 2, 2, 1]


def test_the_printed_report_begins_with_the_stiffness() -> None:
    lines = table(MADE)
    assert lines[0] == "joint stiffness K of 1 of 3 joints and 1 parameter identified, 2 weakly, 4 not identifiable"
    assert [line.split()[0] for line in lines[2:7]] == ["parameter", *["joint_stiffness"] * 3, "motor_inertia"]
    assert lines[lines.index("weakly identified:") + 1].startswith("link_damping of a1, a2: nearly the effect of ")
    assert sum(LITTLE in line for line in lines) == 1
