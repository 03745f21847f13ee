# SPDX-License-Identifier: Apache-2.0
"""`fjr identify LOG --write-map` reads names of columns; what they do not say is to be filled in, and is said."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from docs.pages import ROOT
from fjr_core.errors import MissingPackageError, ParameterError, RecordError
from fjr_identification.record_map import EFFORT, LINK, MOTOR, TORQUE, TableMap, read_map
from fjr_identification.table_record import FILL_IN, written_map
from system.executables import fjr_here

ARM = ("shoulder", "elbow")
DEG = math.pi / 180
COMPLETE = {
    "time_s,shoulder_motor_rad,elbow_motor_rad,shoulder_link_rad,shoulder_torque_nm,elbow_torque_nm": {
        MOTOR: {"shoulder": ("shoulder_motor_rad", 1.0), "elbow": ("elbow_motor_rad", 1.0)},
        LINK: {"shoulder": ("shoulder_link_rad", 1.0)},
        EFFORT: {"shoulder": ("shoulder_torque_nm", 1.0), "elbow": ("elbow_torque_nm", 1.0)},
    },
    "t [ms];q_m1 [deg];q_m2 [deg];dq_m1 [deg];tau1 [Nm];tau2 [Nm]": {
        MOTOR: {"shoulder": ("q_m1 [deg]", DEG), "elbow": ("q_m2 [deg]", DEG)},
        EFFORT: {"shoulder": ("tau1 [Nm]", 1.0), "elbow": ("tau2 [Nm]", 1.0)},
    },
    "Timestamp (us),elbow/motor/position (turn),shoulder/motor/position (turn),elbow/effort (N m),"
    "shoulder/effort (N m),elbow/sensor/torque (N m)": {
        MOTOR: {
            "shoulder": ("shoulder/motor/position (turn)", 2 * math.pi),
            "elbow": ("elbow/motor/position (turn)", 2 * math.pi),
        },
        EFFORT: {"shoulder": ("shoulder/effort (N m)", 1.0), "elbow": ("elbow/effort (N m)", 1.0)},
        TORQUE: {"elbow": ("elbow/sensor/torque (N m)", 1.0)},
    },
    "time_s,linkAngle1Deg,linkAngle2Deg,motorTorque1Nm,motorTorque2Nm": {
        LINK: {"shoulder": ("linkAngle1Deg", DEG), "elbow": ("linkAngle2Deg", DEG)},
        EFFORT: {"shoulder": ("motorTorque1Nm", 1.0), "elbow": ("motorTorque2Nm", 1.0)},
    },
}


def made(folder: Path, header: str) -> tuple[str, list[str]]:
    """Return the map of a table with a header, and what is left to do."""
    (folder / "log.csv").write_text(header + "\n", encoding="utf-8")
    return written_map(folder / "log.csv", ARM)


def read(folder: Path, text: str) -> TableMap:
    (folder / "map.yaml").write_text(text, encoding="utf-8")
    found = read_map(folder / "map.yaml", ARM)
    assert isinstance(found, TableMap)
    return found


@pytest.mark.parametrize("header", COMPLETE)
def test_names_that_say_everything_give_a_complete_map(tmp_path: Path, header: str) -> None:
    text, todo = made(tmp_path, header)
    assert FILL_IN not in text
    assert not [line for line in todo if line.startswith("fill in")]
    found = read(tmp_path, text)
    signals = {
        signal: {joint: (column.name, pytest.approx(column.factor)) for joint, column in columns.items()}
        for signal, columns in found.signals.items()
    }
    assert signals == COMPLETE[header]


INCOMPLETE = {
    "t,shoulder_pos,elbow_pos,shoulder_tau,elbow_tau": {"time.unit", "FILL_IN.unit", "effort.unit", "whether"},
    "a,motor1_rad,motor2_rad,u1_nm,u2_nm": {"time.column", "time.unit"},
    "time_s,motor1_rad,motor2_rad,motor3_rad,u1_nm,u2_nm": {"motor_position.joints"},
    "time_s,shoulder_motor_rad,elbow_motor_deg": {"motor_position.unit", "effort: no column"},
}


@pytest.mark.parametrize("header", INCOMPLETE)
def test_what_names_do_not_say_is_marked_and_refused_until_it_is_filled_in(tmp_path: Path, header: str) -> None:
    text, todo = made(tmp_path, header)
    assert {line.split()[2].rstrip(":") for line in todo if line.startswith("fill in")} == {
        each.split(":")[0] for each in INCOMPLETE[header]
    }
    assert text.count(FILL_IN) > 0
    with pytest.raises(ParameterError, match=FILL_IN):
        read(tmp_path, text)


def test_the_command_says_what_is_left_to_do_and_replaces_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    record, robot = ROOT / "examples/kr300/record_a.csv.gz", ROOT / "examples/kr300/kr300.yaml"
    command = ("identify", str(record), "--robot", str(robot))
    assert "(--write-map makes one)" in fjr_here(*command, code=2)
    said = fjr_here(*command, "--write-map")
    assert "check    effort.gear_ratio is 1: a1_motor_torque_nm to a6_motor_torque_nm count at the joint's side" in said
    assert "the robot file has the gear ratios [256.86, " in said
    assert "fill in" not in said
    found = read_map(tmp_path / "record_a_map.yaml", ("a1", "a2", "a3", "a4", "a5", "a6"))
    assert isinstance(found, TableMap)
    assert list(found.signals[LINK]) == ["a1", "a2", "a3"]
    assert "effort of a1 is" in fjr_here(*command, "--map", "record_a_map.yaml", code=2)
    assert "record_a_map.yaml exists" in fjr_here(*command, "--write-map", code=2)


def test_parquet_has_a_header_too_and_other_files_are_refused(tmp_path: Path) -> None:
    names = ["time_s", "shoulder_motor_rad", "elbow_motor_rad", "shoulder_torque_nm", "elbow_torque_nm"]
    pq.write_table(pa.table({name: [0.0] for name in names}), tmp_path / "log.parquet")
    assert read(tmp_path, written_map(tmp_path / "log.parquet", ARM)[0]).columns[0] == "time_s"
    for content in (b"", b"\xff\xfe\x00", b"alpha,beta\n0,0\n"):
        (tmp_path / "bad.csv").write_bytes(content)
        with pytest.raises(RecordError) as found:
            written_map(tmp_path / "bad.csv", ARM)
        assert "; expected " in str(found.value)
        assert "\n" not in str(found.value)


def test_missing_pyarrow_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.csv", None)
    with pytest.raises(MissingPackageError, match=r"pyarrow is not installed; .*: pip install pyarrow$"):
        written_map(tmp_path / "log.csv", ARM)
