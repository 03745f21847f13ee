# SPDX-License-Identifier: Apache-2.0
"""Records of motion from tables and bags have the numbers of the file; `--write-map` reads names of columns."""

from __future__ import annotations

import gzip
import json
import math
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from rosbags.rosbag2 import StoragePlugin

from docs.pages import ROOT
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.errors import FjrError, MissingPackageError, ParameterError, RecordError
from fjr_core.model.robot import PRISMATIC, Robot
from fjr_design.uncertainty.posterior import DEFLECTION, NAMES, UNKNOWN, WEAK, Identification
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import IdentifyOptions, prior_of
from fjr_identification.estimation.validation import hold_out
from fjr_identification.page import fit_plots
from fjr_identification.records.missing_sensors import lacking
from fjr_identification.records.reading import Reading, read_record, record_of_bag, record_of_table
from fjr_identification.records.record_map import (
    EFFORT,
    FILL_IN,
    LINK,
    MOTOR,
    TORQUE,
    BagMap,
    TableMap,
    read_map,
    written_map,
)
from fjr_identification.records.rigid_motion import KINDS
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.files import BagError
from fjr_monitor.recording.signals import RunSignals
from nodes.harness import nanoseconds
from system.bags import Change, rewritten
from system.executables import fjr_here
from system.shared_runs import shared_run

pytestmark = pytest.mark.system
EXAMPLE = ROOT / "examples/kr300"
AXES = ("a1", "a2", "a3", "a4", "a5", "a6")
TIMED = ("/joint_states", "/joint_commands")


@pytest.fixture(scope="module")
def kr300() -> Robot:
    return load_scenario(EXAMPLE / "kr300.yaml").robot


@pytest.fixture(scope="module")
def reading() -> Reading:
    return Reading(read_map(EXAMPLE / "record.yaml", AXES))


@pytest.fixture(scope="module")
def both(reading: Reading) -> list[MotionRecord]:
    """Return the two records of the real robot, unchecked."""
    files = (EXAMPLE / f"record_{name}.csv.gz" for name in "ab")
    return [record_of_table(file, reading.mapping, AXES)[0] for file in files]


@pytest.mark.parametrize("name", ["record_a", pytest.param("record_b", marks=pytest.mark.full)])
def test_records_of_a_real_robot_are_read_in_si_units_without_a_finding(
    kr300: Robot, reading: Reading, name: str
) -> None:
    record, notes = read_record(EXAMPLE / f"{name}.csv.gz", AXES, kr300, reading)
    raw = np.genfromtxt(EXAMPLE / f"{name}.csv.gz", delimiter=",", names=True)
    assert record.dt == pytest.approx(4e-3)
    assert np.array_equal(record.q_m[:, 3], raw["a4_motor_rad"])
    assert np.array_equal(record.q_l[:, 0], raw["a1_link_rad"])
    assert record.u[:, 1] == pytest.approx(267.43 * raw["a2_motor_torque_nm"])
    assert np.isnan(record.q_l[:, 3:]).all()
    assert np.isnan(record.torque).all()
    assert notes == ()
    assert [said.split(":")[:2] for said in lacking([record], kr300)] == [
        ["a4, a5, a6", " no link encoder and no torque sensor"],
        ["a4, a5, a6", " one side only is measured"],
    ]


def test_filtered_least_squares_of_a_real_record_predict_the_deflection_in_the_other_one(
    kr300: Robot, both: list[MotionRecord]
) -> None:
    prior, options, found = prior_of(kr300), IdentifyOptions(position_torque="a2"), []
    for record, held_out in (both, both[::-1]):
        found.append(identify([record], kr300, prior, options))
        (fit,) = found[-1].fits
        assert set(fit.measured) == {DEFLECTION}  # nothing is simulated
        assert np.all(fit.explained[1:3] > 0.98)
        titles = [plot.title[:2] for plot in fit_plots(fit, AXES, kr300.units, "record-0")[:4]]
        assert titles == ["a1", "a2", "a3", "Re"]
        assert "[mm]" in fit_plots(fit, AXES, (PRISMATIC,) * len(AXES), "record-0")[0].y_label
        compared = hold_out(found[-1], held_out, kr300, prior, options)
        model, rigid, _ = compared.shares.T
        assert np.all(model[:3] < 0.25)  # 1: joints without elasticity and without skew
        assert np.all(model[1:3] < 0.75 * rigid[1:3])
        assert np.all(np.isnan(model[3:]))
        verdicts = [each.verdict for each in found[-1].estimates if each.name == "joint_stiffness"]
        assert verdicts[1:] == [WEAK, WEAK, UNKNOWN, UNKNOWN, UNKNOWN]
    for one, other in zip(*(each.estimates for each in found), strict=True):
        if one.name in ("joint_stiffness", "position_torque_cos1") and one.joint in ("a2", "a3"):
            assert max(one.low, other.low) < min(one.high, other.high)
            assert one.value == pytest.approx(other.value, rel=0.15)


def test_parquet_other_units_signs_and_names_give_the_same_record(both: list[MotionRecord], tmp_path: Path) -> None:
    whole = both[0]
    with gzip.open(EXAMPLE / "record_a.csv.gz") as file:
        table = pa.csv.read_csv(file)
    columns = {"ms": 1e3 * table["time_s"].to_numpy()}
    columns |= {f"m{i}": -np.degrees(table[f"a{i}_motor_rad"].to_numpy()) for i in range(1, 7)}
    columns |= {f"l{i}": table[f"a{i}_link_rad"].to_numpy() / (2 * np.pi) * 50 for i in range(1, 4)}
    columns |= {f"u{i}": 1e3 * table[f"a{i}_motor_torque_nm"].to_numpy() for i in range(1, 7)}
    pq.write_table(pa.table(columns), tmp_path / "a.parquet", row_group_size=300)
    (tmp_path / "map.yaml").write_text(
        "time: {column: ms, unit: ms}\n"
        "motor_position: {column: [m1, m2, m3, m4, m5, m6], unit: deg, sign: -1}\n"
        "link_position: {column: [l1, l2, l3], unit: turn, gear_ratio: 50, joints: [a1, a2, a3]}\n"
        "effort: {column: [u1, u2, u3, u4, u5, u6], unit: mN m,\n"
        "  gear_ratio: [256.86, 267.43, 252.33, 221, 239.62, 154.32]}\n"
    )
    found, _ = record_of_table(tmp_path / "a.parquet", read_map(tmp_path / "map.yaml", AXES), AXES)
    for name in ("u", "q_l", "q_m"):
        assert getattr(found, name) == pytest.approx(getattr(whole, name), rel=1e-9, abs=1e-12, nan_ok=True)


def test_part_of_a_table_is_the_same_rows(reading: Reading, both: list[MotionRecord]) -> None:
    whole = both[0]
    part, _ = record_of_table(EXAMPLE / "record_a.csv.gz", reading.mapping, AXES, Reading(None, 1.998, 3.0))
    assert part.u.shape == (750, 6)
    assert np.array_equal(part.q_m, whole.q_m[500:1250])


Lines = list[str]


def cell(row: int, column: int, value: str) -> Callable[[Lines], Lines]:
    """Return a change of one cell."""

    def change(lines: Lines) -> Lines:
        cells = lines[row].split(",")
        cells[column] = value
        return [*lines[:row], ",".join(cells), *lines[row + 1 :]]

    return change


BAD_TABLES: dict[str, tuple[Callable[[Lines], Lines], str]] = {
    "missing": (cell(0, 2, "other"), "column a2_motor_rad is missing; expected it once (the header is time_s, "),
    "twice": (cell(0, 2, "a1_motor_rad"), "column a1_motor_rad is more than once"),
    "nan": (cell(12, 3, "nan"), "row 12, column a3_motor_rad: nan; expected a finite number (1 such rows"),
    "empty": (cell(12, 3, ""), "row 12, column a3_motor_rad: nan; expected a finite number"),
    "text": (cell(12, 3, "abc"), "is not a table of numbers (In CSV column #3"),
    "gap": (lambda lines: [*lines[:300], *lines[900:]], "time jumps by 2.404 s"),
    "back": (lambda lines: [lines[0], *lines[400:], *lines[1:300]], "time runs back by"),
    "decimal comma": (cell(12, 3, '"0,5"'), "value '0,5'); expected CSV with points"),
    "short": (lambda lines: lines[:100], "the record has 99 samples; expected at least 200"),
    "no rows": (lambda lines: lines[:1], "holds no samples"),
    "nothing": (lambda lines: [], "has no header"),
}


@pytest.mark.parametrize(("change", "sentence"), BAD_TABLES.values(), ids=BAD_TABLES)
def test_bad_table_is_refused_in_one_sentence(
    kr300: Robot, reading: Reading, tmp_path: Path, change: Callable[[Lines], Lines], sentence: str
) -> None:
    lines = gzip.decompress((EXAMPLE / "record_a.csv.gz").read_bytes()).decode().splitlines()
    (tmp_path / "changed.csv").write_text("\n".join(change(lines)) + "\n")
    with pytest.raises(FjrError, match="changed.csv") as caught:
        read_record(tmp_path / "changed.csv", AXES, kr300, reading)
    assert sentence in str(caught.value)


SWAPPED = {"motor_position": ("link_position", "a3"), "link_position": ("motor_position", "a3")}


@pytest.mark.parametrize(
    ("factors", "swapped", "sentence"),
    [
        ({"motor_position": 1.01}, {}, "expected 1: wrong gear ratio (and 2 more)"),
        ({"effort": 1.0}, {}, "expected about 1: links in the robot file, gear ratio, unit of the effort?"),
        ({}, SWAPPED, "expected about 1: sides swapped"),
    ],
    ids=["gear ratio", "effort at the motor", "swapped sides"],
)
def test_wrong_mapping_of_a_real_record_is_named(
    kr300: Robot, reading: Reading, factors: dict[str, float], swapped: dict[str, tuple[str, str]], sentence: str
) -> None:
    mapping = reading.mapping
    assert isinstance(mapping, TableMap)
    signals = {name: dict(columns) for name, columns in mapping.signals.items()}
    for name, factor in factors.items():
        signals[name] = {joint: replace(column, factor=factor) for joint, column in signals[name].items()}
    for name, (other, joint) in swapped.items():
        signals[name][joint] = mapping.signals[other][joint]
    wrong = replace(reading, mapping=replace(mapping, signals=signals))
    with pytest.raises(FjrError, match="--accept") as caught:
        read_record(EXAMPLE / "record_a.csv.gz", AXES, kr300, wrong)
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("time: {column: t}\n", "has no 'effort'; expected its column and unit"),
        ("- a\n", "holds a list; expected a mapping"),
        ("# a\n", "is empty; expected a mapping"),
        ("velocity: {column: v}\n", "holds 'velocity'; expected time, link_position"),
        ("time: {column: t, unit: h}\neffort: {column: u}\n", "time.unit is 'h'; expected one of s, ms"),
        ("time: {column: t}\neffort: {column: u, unit: N m}\n", "names a column twice"),
        ("time: {column: t}\neffort: {column: 'u{joint}', unit: N m}\n", "joint a1 has neither link_position nor"),
        ("time: {column: t}\neffort: {column: 'u{joint}', unit: N m, sign: 2}\n", "effort.sign is 2; expected 1 or -1"),
        ("time: {column: t}\neffort: {column: 'u{joint}', unit: N m, gear_ratio: [1, 2]}\n", "or 6 of them"),
        ("time: {column: t}\neffort: {column: 'u{joint}', unit: N m, joints: [b1]}\n", "expected some of a1, a2"),
        (
            "time: {column: t}\neffort: {column: FILL_IN, unit: N m}\n",
            "effort.column is FILL_IN; expected the col",
        ),
        ("bag: {motor: sensor}\n", "bag.motor is 'sensor'; expected position or torque"),
        ("bag: {ratio: 2}\n", "'bag' has ratio: 2; expected namespace, motor"),
    ],
)
def test_bad_mapping_file_is_refused_in_one_sentence(tmp_path: Path, text: str, sentence: str) -> None:
    (tmp_path / "map.yaml").write_text(text)
    with pytest.raises(FjrError, match="map.yaml") as caught:
        read_map(tmp_path / "map.yaml", AXES)
    assert sentence in str(caught.value)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of the two-link arm."""
    return shared_run(tmp_path_factory, "two_link")


@pytest.fixture(scope="module")
def scenario(run: Path) -> Scenario:
    return load_scenario(run / "scenario.yaml")


@pytest.fixture(scope="module")
def whole(run: Path, scenario: Scenario) -> MotionRecord:
    """Return the run as a record."""
    record, notes = read_record(run, scenario.joints, scenario.robot, Reading())
    assert notes == ()
    return record


def test_bag_of_a_run_gives_the_states_and_the_efforts_that_answer_them(
    scenario: Scenario, whole: MotionRecord
) -> None:
    record, ideal = whole, scenario.simulate(0.1)
    assert record.dt == pytest.approx(scenario.sample_period)
    assert record.q_l[:90] == pytest.approx(np.asarray(ideal.x)[:90, :2], abs=1e-9)
    assert record.u[:90] == pytest.approx(np.asarray(ideal.u)[:90], abs=1e-6)
    assert np.isnan(record.torque).all()


@pytest.mark.parametrize(
    ("text", "held"),
    [
        ("time: {column: t}\neffort: {column: u}\nlink_position: {column: q}\ncontrol_period: 0.001\n", 1e-3),
        ("bag: {control_period: 0.001}\n", 1e-3),
        ("bag: {}\n", np.inf),
    ],
)
def test_a_mapping_file_tells_the_period_of_a_controller_faster_than_the_log(
    text: str, held: float, tmp_path: Path
) -> None:
    file = tmp_path / "map.yaml"
    file.write_text(text.replace("u}", "u, unit: N m}").replace("q}", "q, unit: rad}"))
    assert read_map(file, ("a1",)).held == held  # [s]


@pytest.mark.parametrize("value", ["-0.001", "0", "0.0", "true", "fast", "[0.001]", ".nan", ".inf", "1.0", "0.5"])
def test_a_period_of_the_controller_that_is_none_is_refused(value: str, tmp_path: Path) -> None:
    """A number of milliseconds, taken for seconds, would change nothing: the log is faster."""
    file = tmp_path / "map.yaml"
    file.write_text(f"bag: {{control_period: {value}}}\n")
    with pytest.raises(ParameterError, match=r"bag\.control_period is .*; expected seconds above 0 and below 0.1"):
        read_map(file, ("a1",))


def test_of_a_bag_of_each_fifth_state_the_efforts_are_those_of_the_middle_of_a_sample(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path
) -> None:
    """The controller changes them between the states of the bag, as the scenario of the run tells."""
    run = shared_run(tmp_path_factory, "two_link")
    scenario = load_scenario(run / "scenario.yaml")
    whole, _ = read_record(run, scenario.joints, scenario.robot, Reading())
    shutil.copy(run / "scenario.yaml", tmp_path)

    def each_fifth(topic: str, message: Any) -> Any:
        return None if topic in TIMED and nanoseconds(message) // 1_000_000 % 5 else message

    bag = rewritten(run / "bag", tmp_path / "bag", topics=TIMED, change=each_fifth)
    record, notes = read_record(bag, scenario.joints, scenario.robot, Reading())
    assert record.dt == pytest.approx(5e-3)
    assert [note.rpartition(": ")[0].rpartition(": ")[2] for note in notes] == ["efforts change each 1 ms"]
    first = int(np.argmin(np.sum(np.abs(whole.q_m - record.q_m[0]), axis=1)))
    middle = whole.u[first + 2 :: 5][: len(record.u)]
    settled = slice(100, len(middle) - 1)  # the first efforts change too quickly
    assert record.u[settled] == pytest.approx(middle[settled], abs=1e-3 * np.ptp(whole.u))


def test_other_storage_and_commands_without_stamps_give_the_same_positions(
    run: Path, scenario: Scenario, whole: MotionRecord, tmp_path: Path
) -> None:
    plain = rewritten(
        run / "bag", tmp_path / "plain", StoragePlugin.SQLITE3, ("/joint_states", "/effort_controller/commands")
    )
    late = Reading(accepted=("clipped",))  # a recorder that waits for a core notes one effort for many states
    record, notes = read_record(plain, scenario.joints, scenario.robot, late)
    first = int(np.argmin(np.sum(np.abs(whole.q_m - record.q_m[0]), axis=1)))  # states may be received before commands
    assert record.q_m[:500] == pytest.approx(whole.q_m[first : first + 500])
    assert any("is taken to answer the last state sent before it" in note for note in notes)


def test_table_of_a_run_is_the_same_record_as_its_bag(run: Path, scenario: Scenario, tmp_path: Path) -> None:
    output = ("--output", str(tmp_path / "reports"))  # the run is shared
    fjr_here("report", str(run), "--table", str(tmp_path / "log.csv"), *output)
    text, todo = written_map(tmp_path / "log.csv", scenario.joints)
    assert FILL_IN not in text
    assert all(line.startswith("check ") for line in todo)
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    mapping = read_map(tmp_path / "map.yaml", scenario.joints)
    reading = Reading(mapping, 0.0, 2.0)
    found, _ = read_record(tmp_path / "log.csv", scenario.joints, scenario.robot, reading)
    wanted, _ = read_record(run, scenario.joints, scenario.robot, Reading(None, 0.0, 2.0))
    for name in ("q_l", "q_m", "u"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


def test_a_part_of_a_bag_counts_from_the_first_command_however_late_it_is(
    run: Path, scenario: Scenario, whole: MotionRecord, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"{read_record.__module__}.PART", 100)
    monkeypatch.setattr(f"{RunSignals.__module__}.TOGETHER", 100)
    begin = 2.2  # s
    states = rewritten(run / "bag", tmp_path / "late", change=without_commands_before(begin))
    late, _ = read_record(states, scenario.joints, scenario.robot, Reading(None, 0.1, 0.3, KINDS))
    assert len(late.u) * late.dt == pytest.approx(0.3, abs=2 * late.dt)
    first = round((begin + 0.1) / whole.dt)
    assert late.q_m == pytest.approx(whole.q_m[first : first + len(late.u)])


def test_what_is_later_than_the_part_of_a_bag_is_not_read(
    run: Path, scenario: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is read ends a second after the part, where a late command may answer its last state."""
    monkeypatch.setattr(f"{RunSignals.__module__}.TOGETHER", 100)
    whole, part = (RunSignals(read_bag(run), scenario.joints, until=until) for until in (np.inf, 0.3))
    np.testing.assert_array_equal(part.stamp, whole.stamp[: len(part.stamp)])
    assert 1.3 <= (part.stamp[-1] - part.stamp[0]) * 1e-9 <= 1.3 + 2 * 100 * scenario.sample_period
    assert len(part.stamp) < len(whole.stamp)


def test_of_a_bag_with_other_names_the_names_that_are_expected_are_said(
    run: Path, scenario: Scenario, tmp_path: Path
) -> None:
    def prefixed(topic: str, message: Any) -> Any:
        return replace(message, name=[f"left/{each}" for each in message.name]) if topic == TIMED[0] else message

    bag = rewritten(run / "bag", tmp_path / "bag", topics=TIMED, change=prefixed)
    with pytest.raises(RecordError, match="shoulder has neither .*; expected shoulder or shoulder_motor"):
        record_of_bag(bag, BagMap(np.ones(2)), scenario.joints)


def test_states_that_all_have_one_stamp_are_refused(run: Path, scenario: Scenario, tmp_path: Path) -> None:
    """Some drivers leave the stamp at 0; of copies of a state the first one counts, so that one would be left."""

    def unstamped(topic: str, message: Any) -> Any:
        stamp = replace(message.header.stamp, sec=0, nanosec=0) if topic == TIMED[0] else message.header.stamp
        return replace(message, header=replace(message.header, stamp=stamp))

    bag = rewritten(run / "bag", tmp_path / "bag", topics=TIMED, change=unstamped)
    with pytest.raises(BagError, match=r"all \d{4} states of .* have the stamp 0 ns; expected their times"):
        record_of_bag(bag, BagMap(np.ones(2)), scenario.joints)


def without_commands_before(begin: float) -> Change:
    """Return a change of a bag that drops the commands of the first seconds."""
    first: list[int] = []

    def changed(topic: str, message: Any) -> Any:
        if topic == "/joint_states":
            first.append(nanoseconds(message))
        stamped = topic == "/joint_commands" and bool(first) and nanoseconds(message) >= first[0] + 1e9 * begin
        return message if stamped or not topic.endswith("commands") else None

    return changed


def test_of_a_bag_whose_time_jumps_back_the_longest_part_is_read(
    run: Path, scenario: Scenario, whole: MotionRecord, tmp_path: Path
) -> None:
    first: list[int] = []

    def set_back(topic: str, message: Any) -> Any:
        if topic not in TIMED:
            return message
        first.append(nanoseconds(message))
        late = first[-1] - first[0] >= 2 * 10**9
        stamp = replace(message.header.stamp, sec=message.header.stamp.sec - late)
        return replace(message, header=replace(message.header, stamp=stamp))

    record, notes = read_record(
        rewritten(run / "bag", tmp_path / "bag", change=set_back), scenario.joints, scenario.robot, Reading()
    )
    assert "time jumps back 1 times: shown is the longest of 2 parts" in notes[0]
    assert len(record.u) == pytest.approx(2.0 / whole.dt, abs=5)
    np.testing.assert_array_equal(record.q_m, whole.q_m[: len(record.u)])
    np.testing.assert_array_equal(record.u, whole.u[: len(record.u)])


def test_efforts_in_the_states_are_the_commands_that_acted_before_them(
    run: Path, scenario: Scenario, whole: MotionRecord
) -> None:
    record, notes = record_of_bag(run, BagMap(np.ones(2), by_states=True), scenario.joints)
    assert "the effort of shoulder_motor and so on in the states is the torque" in notes[0]
    first = int(np.argmin(np.sum(np.abs(record.q_m - whole.q_m[0]), axis=1)))
    np.testing.assert_allclose(record.u[first + 1 : first + 500], whole.u[:499], rtol=0, atol=1e-9)


def test_a_position_that_is_missing_in_one_state_of_a_bag_is_refused(
    run: Path, scenario: Scenario, tmp_path: Path
) -> None:
    sent = count()

    def one_less(topic: str, message: Any) -> Any:
        if topic != "/joint_states" or next(sent) != 700:
            return message
        elbow = np.array(message.name) == "elbow_motor"
        return replace(message, position=np.where(elbow, np.nan, message.position))

    bag = rewritten(run / "bag", tmp_path / "gap", change=one_less)
    with pytest.raises(RecordError, match=r"^gap: q_m of elbow is nan at sample \d+; expected a finite number"):
        read_record(bag, scenario.joints, scenario.robot, Reading())


def test_bag_of_another_robot_is_refused(run: Path, tmp_path: Path, kr300: Robot) -> None:
    with pytest.raises(FjrError, match="was recorded with the joints .* expected .*a1"):
        read_record(run, AXES, kr300, Reading())
    alone = rewritten(run / "bag", tmp_path / "alone")
    with pytest.raises(FjrError, match="no effort of all joints"):
        read_record(alone, AXES, kr300, Reading())


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
    "time_s,shoulder_motor_deg,elbow_motor_mm,shoulder_motor_effort_nm,elbow_motor_effort_kn": {  # a prismatic elbow
        MOTOR: {"shoulder": ("shoulder_motor_deg", DEG), "elbow": ("elbow_motor_mm", 1e-3)},
        EFFORT: {"shoulder": ("shoulder_motor_effort_nm", 1.0), "elbow": ("elbow_motor_effort_kn", 1e3)},
    },
    "time_s,linkAngle1Deg,linkAngle2Deg,motorTorque1Nm,motorTorque2Nm": {
        LINK: {"shoulder": ("linkAngle1Deg", DEG), "elbow": ("linkAngle2Deg", DEG)},
        EFFORT: {"shoulder": ("motorTorque1Nm", 1.0), "elbow": ("motorTorque2Nm", 1.0)},
    },
    "time_s,q_m1 [deg],q_m2 [deg],q_m1 [deg/s],q_m2 [rad/s],motor1_rpm,tau1 [Nm],tau2 [Nm]": {  # and velocities
        MOTOR: {"shoulder": ("q_m1 [deg]", DEG), "elbow": ("q_m2 [deg]", DEG)},
        EFFORT: {"shoulder": ("tau1 [Nm]", 1.0), "elbow": ("tau2 [Nm]", 1.0)},
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
    command = ("identify", str(EXAMPLE / "record_a.csv.gz"), "--robot", str(EXAMPLE / "kr300.yaml"))
    assert "(--write-map makes one)" in fjr_here(*command, code=2)
    said = fjr_here(*command, "--write-map")
    assert "check    effort.gear_ratio is 1: a1_motor_torque_nm to a6_motor_torque_nm count at the joint's side" in said
    assert "the robot file has the gear ratios [256.86, " in said
    assert "fill in" not in said
    found = read_map(tmp_path / "record_a_map.yaml", AXES)
    assert isinstance(found, TableMap)
    assert list(found.signals[LINK]) == ["a1", "a2", "a3"]
    assert "effort of a1 is" in fjr_here(*command, "--map", "record_a_map.yaml", code=2)
    assert "record_a_map.yaml exists" in fjr_here(*command, "--write-map", code=2)


def test_parquet_has_a_header_too_and_other_files_are_refused(tmp_path: Path) -> None:
    names = ["time_s", "shoulder_motor_rad", "elbow_motor_rad", "shoulder_torque_nm", "elbow_torque_nm"]
    pq.write_table(pa.table({name: [0.0] for name in names}), tmp_path / "log.parquet")
    assert read(tmp_path, written_map(tmp_path / "log.parquet", ARM)[0]).columns[0] == "time_s"
    for content in (b"", b"\xff\xfe\x00", b"alpha,beta\n0,0\n", b"t motor_rad\n0 0\n"):
        (tmp_path / "bad.csv").write_bytes(content)
        with pytest.raises(RecordError) as found:
            written_map(tmp_path / "bad.csv", ARM)
        assert "; expected " in str(found.value)
        assert "\n" not in str(found.value)


def test_missing_pyarrow_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow.csv", None)
    with pytest.raises(MissingPackageError, match=r"pyarrow is not installed; .* -m pip install pyarrow$"):
        written_map(tmp_path / "log.csv", ARM)


# The loop of the README of examples/kr300, in lock-step with a plant drawn from the posterior of the real record.


OF_ROBOT = ("joint_stiffness", "motor_inertia", "link_damping", "motor_damping")
FRICTION = ("link_coulomb_friction", "motor_coulomb_friction")
ROBUST = "    robust: {motor_residual_gain: [5.0, 5.0, 5.0, 5.0, 5.0, 5.0]}\n"


@pytest.mark.full  # 40 s
def test_a_real_record_becomes_a_loop_that_tracks_on_a_plant_of_its_posterior(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    record, mapping, robot = (str(EXAMPLE / name) for name in ("record_a.csv.gz", "record.yaml", "kr300.yaml"))
    fjr_here("identify", record, "--map", mapping, "--robot", robot, "--position-torque", "a2", "--output", ".")
    file = tmp_path / "robot.yaml"
    file.write_text(file.read_text() + ROBUST)  # fjr_controller is its last section
    shown = fjr_here("gains", str(file), "--beta", "2.5", "--from", "identification.json", "--write")
    assert "0 of 4,603 robots drawn afresh from the identification are unstable" in shown
    assert "at most 0.1 % with 99 %" in shown
    assert "as sampled          stable" in fjr_here("check", str(file))
    found = Identification.from_dict(json.loads(Path("identification.json").read_text()))
    row, rate = found.draws(1, seed=3), "    publish_rate: 1000.0"  # of the plant alone
    assert file.read_text().count(rate) == 1
    drawn = {name: found.values(row, NAMES[name], np.zeros(6))[0].tolist() for name in (*OF_ROBOT, *FRICTION)}
    plant = [f"    robot: {json.dumps({name: drawn[name] for name in OF_ROBOT})}"]
    plant += [f"    imperfections: {json.dumps({name: drawn[name] for name in FRICTION})}"]
    Path("drawn.yaml").write_text(file.read_text().replace(rate, "\n".join([*plant, rate])))
    scenario = load_scenario(tmp_path / "drawn.yaml")
    assert not np.allclose(scenario.plant_values["robot.joint_stiffness"], np.diag(scenario.robot.K), rtol=1e-3)
    fjr_here("run", "drawn.yaml", "--lockstep", "--duration", "2.2", "--no-report")
    report = json.loads((tmp_path / "runs/drawn/report.json").read_text())
    assert report["diagnostics"]["fjr_controller"]["state"] == "tracking"  # at the last second
    assert report["tracking"]["max_error_after_2s_rad"] < 0.2 * 0.4  # rad; the reference moves by 0.4 rad
