# SPDX-License-Identifier: Apache-2.0
"""`fjr report` of any bag: equal metrics from every storage, partial ones from partial bags, otherwise one sentence."""

from __future__ import annotations

import csv
import json
import re
import shutil
import sqlite3
import sys
from collections.abc import Callable, Collection
from dataclasses import replace
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote

import numpy as np
import pyarrow.parquet as pq
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer

from fjr_core.config.scenario import Scenario, load_scenario
from fjr_monitor.diagnosis.record import parts_of
from fjr_monitor.recording import columns as stored
from fjr_monitor.recording import run as recorded_run
from fjr_monitor.recording import signals
from fjr_monitor.recording.bag import Bag, header_stamp, read_bag
from fjr_monitor.recording.columns import Columns
from fjr_monitor.recording.files import Topic
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.recording.run import Recording, RunData
from fjr_monitor.report import shown as decimation
from fjr_monitor.report.comparison_page import differences
from fjr_monitor.report.metrics import Metrics
from fjr_monitor.report.shown import BUCKETS, Shown, arm_replay, kept_rows
from fjr_msgs_py.scenarios import library
from fjr_plant.lock_step import START
from nodes.harness import nanoseconds
from system.bags import JOINT_STATE, STORE, rewritten, text_message
from system.executables import fjr_here, scenario
from system.shared_runs import messages

pytestmark = pytest.mark.system
STATES, ANSWERS, EFFORTS = "/joint_states", "/joint_commands", "/effort_controller/commands"
REFERENCE, TORQUE = "/fjr_controller/reference", "/fjr_controller/external_torque"
OURS = (STATES, ANSWERS, EFFORTS, REFERENCE)
SIGNALS = ("t", "position", "velocity", "jets", "u", "torque")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a run of the two-link arm, one second in lock-step."""
    output = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as without_pictures:
        without_pictures.setitem(sys.modules, "matplotlib", None)
        fjr_here("run", "two_link", "--lockstep", "--duration", "1.0", "--output", str(output))
    return output / "two_link"


@pytest.fixture(scope="module")
def in_order(run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the bag of the run as if no message had been received late, as happens on a busy machine."""
    return received(run, tmp_path_factory.mktemp("received") / "bag")


@pytest.fixture(scope="module")
def model(run: Path) -> Scenario:
    return load_scenario(run / "scenario.yaml")


@pytest.fixture(scope="module")
def another(run: Path) -> Scenario:
    """Return the scenario of the run with other amplitudes."""
    return library.as_run(run / "scenario.yaml", {"reference.amplitude": [0.123, 0.321]})[1]


@pytest.fixture(scope="module")
def whole(run: Path, model: Scenario) -> RunData:
    return read(run, model)[1]


def read(bag: Path, model: Scenario) -> tuple[Recording, RunData]:
    """Return the first second of a run, and it as one part."""
    recording = Recording(read_bag(bag), model, 1.0)
    return recording, recording.part(0, len(recording))


def assert_same(found: RunData, wanted: RunData, *names: str) -> None:
    """Check that both have the same numbers of these names, bit by bit."""
    for name in names:
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


def report(bag: Path, run: Path, tmp_path: Path) -> dict[str, Any]:
    """Return the report that `fjr report` writes for a bag with the scenario of the run."""
    out = tmp_path / f"{bag.stem}_out"
    fjr_here("report", str(bag), "--scenario", str(run / "scenario.yaml"), "--output", str(out))
    (file,) = out.glob("*/report.json")
    assert file.with_suffix(".html").stat().st_size > 60_000
    return json.loads(file.read_text())


def without(keep: Callable[[str], bool], *fields: str) -> Callable[[str, Any], Any]:
    """Return a change that keeps some joints of the joint states and removes fields."""

    def change(topic: str, message: Any) -> Any:
        if topic != STATES:
            return message
        rows = [row for row, name in enumerate(message.name) if keep(name)]
        values = {name: np.array(getattr(message, name))[rows] for name in ("position", "velocity", "effort")}
        values |= {field: np.zeros(0) for field in fields}
        return replace(message, name=[message.name[row] for row in rows], **values)

    return change


def test_the_report_of_a_healthy_run_is_reproduced_from_its_folder_alone(run: Path) -> None:
    def page() -> str:
        """Return the page without the paragraph that names the command which wrote it."""
        return re.sub(r'<p class="origin">.*?</p>', "", (run / "report.html").read_text(), flags=re.DOTALL)

    made, before = json.loads((run / "report.json").read_text()), page()
    assert "package://" not in (run / "scenario.yaml").read_text()
    fjr_here("report", str(run))
    assert json.loads((run / "report.json").read_text()) == made
    assert page() == before
    assert (made["verdict"]["kind"], made["missing"]) == ("holding", [])
    energy = made["energy"]
    assert energy["rms_residual_of_supplied"] < 1e-3  # the power balance closes
    assert energy["stored_j"] == pytest.approx(energy["supplied_j"] - energy["dissipated_j"] + energy["residual_j"])


@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        (StoragePlugin.MCAP, CompressionMode.NONE),
        (StoragePlugin.SQLITE3, CompressionMode.FILE),
        (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    ],
)
def test_every_storage_of_rosbag2_holds_the_same_run(
    run: Path, tmp_path: Path, model: Scenario, whole: RunData, storage: StoragePlugin, compression: CompressionMode
) -> None:
    recording, data = read(rewritten(run / "bag", tmp_path / "copy", storage, compression=compression), model)
    assert recording.bag.complete
    assert_same(data, whole, *SIGNALS)


def test_commands_without_stamps_are_paired_with_the_states_before_them(
    run: Path, tmp_path: Path, model: Scenario, whole: RunData
) -> None:
    """The bag is like that of a robot: a state every millisecond, a command 0.3 ms later, one command missing."""
    states = {header_stamp(raw.data): raw.data for raw in read_bag(run).topic(STATES).messages}
    array, layout = STORE.types["std_msgs/msg/Float64MultiArray"], STORE.types["std_msgs/msg/MultiArrayLayout"]
    begin = min(stamp for stamp in states if stamp > 0)
    with Writer(tmp_path / "copy", version=9) as writer:
        sent = writer.add_connection(STATES, JOINT_STATE, typestore=STORE)
        answered = writer.add_connection(EFFORTS, "std_msgs/msg/Float64MultiArray", typestore=STORE)
        for k, u in enumerate(whole.u):
            writer.write(sent, k * 1_000_000, states[begin + k * 1_000_000])
            if k != 500:
                raw = STORE.serialize_cdr(array(layout([], 0), u), "std_msgs/msg/Float64MultiArray")
                writer.write(answered, k * 1_000_000 + 300_000, raw)
    recording, data = read(tmp_path / "copy", model)
    assert np.isnan(data.u[500]).all()
    data.u[500] = whole.u[500]
    assert_same(data, whole, "u", "V")
    np.testing.assert_allclose(np.nanmax(data.latency), 0.3e-3)
    assert f"no {ANSWERS}: " in recording.notes[0]


def test_parts_of_a_bag_give_parts_of_the_report(run: Path, tmp_path: Path) -> None:
    made = report(rewritten(run / "bag", tmp_path / "states", topics=(STATES,)), run, tmp_path)
    assert made["tracking"]["peak_effort_nm"] is made["counts"]["answered"] is None
    assert made["storage"]["initial"] > 0
    assert made["tracking"]["initial_error_rad"] > 0
    assert made["verdict"]["kind"] == "unknown"
    assert "neither" in made["missing"][0]
    assert REFERENCE in made["missing"][1]
    links = rewritten(run / "bag", tmp_path / "links", change=without(lambda name: not name.endswith("_motor")))
    made, known = report(links, run, tmp_path), json.loads((run / "report.json").read_text())
    assert made["joints"][0]["initial_error_rad"] == known["joints"][0]["initial_error_rad"]
    assert made["tracking"]["peak_effort_nm"] == known["tracking"]["peak_effort_nm"]
    assert made["storage"] is made["energy"] is None
    assert "no motor side" in made["missing"][0]


def test_velocities_and_external_torques_are_estimated_if_not_recorded(
    run: Path, tmp_path: Path, model: Scenario, whole: RunData
) -> None:
    first, _ = read(run, model)
    recording, data = read(rewritten(run / "bag", tmp_path / "copy", change=without(lambda _: True, "velocity")), model)
    assert "observer" in recording.notes[0]
    late = data.t > 0.3
    assert np.abs(data.velocity - whole.velocity)[late].max() < 0.02 * np.abs(whole.velocity).max()
    bag = read_bag(run)
    batch = next(bag.batches((TORQUE,), TORQUE, 10_000))
    published = bag.table(batch[TORQUE], model.joints)
    torque, estimated = (each.columns.at(np.arange(len(each)))["external_torque"] for each in (first, recording))
    np.testing.assert_allclose(torque, published.effort[: len(whole.t)], rtol=0, atol=1e-12)
    assert np.isnan(estimated[:5]).all()
    for found, largest in ((torque, 1e-3), (estimated[5:], 0.1)):
        assert np.abs(found[-100:]).max() < largest  # none acts in a free motion


def test_velocities_of_one_side_that_are_not_numbers_are_estimated(
    run: Path, tmp_path: Path, model: Scenario, whole: RunData
) -> None:
    """As the joint_state_broadcaster of ros2_control publishes them for an encoder without velocity."""

    def change(topic: str, message: Any) -> Any:
        links = [not name.endswith("_motor") for name in getattr(message, "name", ())]
        return replace(message, velocity=np.where(links, np.nan, message.velocity)) if topic == STATES else message

    recording, data = read(rewritten(run / "bag", tmp_path / "copy", change=change), model)
    assert "observer" in recording.notes[0]
    assert len(data.t) == len(whole.t)
    assert np.isfinite(data.velocity).all()


def test_a_missing_command_is_held_where_velocities_are_estimated(run: Path, tmp_path: Path, model: Scenario) -> None:
    """So does the robot; an estimate without effort for one sample would be slower by that much of the motor."""
    removed, answers = without(lambda _: True, "velocity"), count()

    def one_less(topic: str, message: Any) -> Any:
        return None if topic == ANSWERS and next(answers) == 500 else removed(topic, message)

    _, complete = read(rewritten(run / "bag", tmp_path / "complete", change=removed), model)
    _, data = read(rewritten(run / "bag", tmp_path / "copy", change=one_less), model)
    (k,) = np.flatnonzero(np.isnan(data.u).any(axis=1))
    per_effort = 1e-3 / np.diag(model.robot.M_m)  # rad/s in a sample, by the effort that differs
    allowed = 2 * np.max(np.abs(complete.u[k] - complete.u[k - 1]) * per_effort)
    assert np.abs(complete.u[k] * per_effort).max() > 10 * allowed
    assert np.abs(data.velocity - complete.velocity).max() <= allowed


def test_another_reference_than_the_scenarios_is_differentiated(run: Path, another: Scenario, whole: RunData) -> None:
    recording, data = read(run, another)
    assert "numerical" in recording.notes[-1]
    np.testing.assert_allclose(data.jets[:, 0], whole.jets[:, 0], atol=1e-12)
    inside = (data.t > 0.01) & (data.t < 0.99)
    np.testing.assert_allclose(data.V[inside], whole.V[inside], rtol=1e-3, atol=1e-6 * whole.V[0])


def test_a_bag_that_begins_and_ends_within_the_motion_has_the_reference_of_all_its_states(
    run: Path, tmp_path: Path, model: Scenario, whole: RunData
) -> None:
    """The reference is published more rarely than the states, and its topic may be found later."""

    def later(topic: str, message: Any) -> Any:
        if topic not in (STATES, ANSWERS, REFERENCE):
            return message
        k = round((nanoseconds(message) - START) * 1e-6)
        rare = topic != REFERENCE or (k % 10 == 0 and k >= 330)
        return message if 303 <= k <= 907 and rare else None

    recording, data = read(rewritten(run / "bag", tmp_path / "copy", change=later), model)
    assert (len(data.t), recording.signals.stamp[0]) == (907 - 330 + 1, START + 330 * 10**6)
    np.testing.assert_allclose(data.jets[:, :2], whole.jets[330:908, :2], atol=1e-6)
    np.testing.assert_allclose(data.V, whole.V[330:908], rtol=0.05, atol=1e-6 * whole.V[0])


def looped(topic: str, message: Any) -> Any:
    """Return the message with 0.3 s of its stamps repeated."""
    if topic not in (STATES, ANSWERS, REFERENCE):
        return message
    stamp = message.header.stamp
    late = stamp.nanosec > 700_000_000 or stamp.sec > 0
    again = replace(stamp, sec=0, nanosec=(stamp.nanosec - 700_000_000) % 10**9) if late else stamp
    return replace(message, header=replace(message.header, stamp=again))


def unanswered(topic: str, message: Any) -> Any:
    """Return the message, without the commands of 0.3 s: there are parts without any."""
    if topic == STATES or not hasattr(message, "header"):
        return message
    return None if 0.3 < message.header.stamp.nanosec * 1e-9 < 0.6 else message


def test_a_table_holds_the_numbers_of_the_messages(run: Path, tmp_path: Path) -> None:
    file, joints = tmp_path / "new" / "run.csv", ("shoulder", "elbow")
    assert f"time series: {file}" in fjr_here("report", str(run), "--table", str(file))
    with file.open(encoding="utf-8", newline="") as stream:
        header, *lines = csv.reader(stream)
    columns = dict(zip(header, np.array([[float(cell) for cell in line] for line in lines]).T, strict=True))
    heard: dict[str, dict[int, Any]] = {topic: {} for topic in (STATES, ANSWERS, REFERENCE)}
    for topic, message in messages(run, *heard):
        heard[topic].setdefault(nanoseconds(message), message)
    stamps = sorted(heard[STATES])[: len(lines)]  # the nodes run a moment longer than planned
    assert len(stamps) == len(lines) > 900
    np.testing.assert_array_equal(columns["t [s]"], (np.array(stamps) - stamps[0]) * 1e-9)
    states = [heard[STATES][stamp] for stamp in stamps]
    for side, suffix in (("l", ""), ("m", "_motor")):
        for joint in joints:
            place = list(states[0].name).index(joint + suffix)
            for symbol, unit, sent in (("q", "rad", "position"), ("dq", "rad/s", "velocity")):
                values = [getattr(message, sent)[place] for message in states]
                np.testing.assert_array_equal(columns[f"{symbol}_{side}.{joint} [{unit}]"], values)
    nothing = dict.fromkeys(joints, np.nan)
    for symbol, unit, topic, sent, error in (
        ("u", "N m", ANSWERS, "effort", 0.0),
        ("q_ld", "rad", REFERENCE, "position", 1e-12),  # computed from the scenario
        ("dq_ld", "rad/s", REFERENCE, "velocity", 1e-12),
    ):
        named = {stamp: dict(zip(each.name, getattr(each, sent), strict=True)) for stamp, each in heard[topic].items()}
        for joint in joints:
            values = np.array([named.get(stamp, nothing)[joint] for stamp in stamps])
            known = np.isfinite(values)
            assert known.sum() > 900
            np.testing.assert_allclose(columns[f"{symbol}.{joint} [{unit}]"][known], values[known], rtol=0, atol=error)
    assert {"V [J]", "H [J]", "latency [s]", *(f"external_torque.{joint} [N m]" for joint in joints)} <= {*header}

    fjr_here("report", str(run), "--table", str(file.with_suffix(".parquet")))
    table = pq.read_table(file.with_suffix(".parquet"))
    assert table.column_names == header
    for name, values in columns.items():
        np.testing.assert_array_equal(table.column(name).to_numpy(), values)


def test_a_table_is_of_one_run_and_replaces_a_file_only_by_force(run: Path, tmp_path: Path) -> None:
    file, other = tmp_path / "run.csv", tmp_path / "run.xlsx"
    file.write_text("mine")
    said = fjr_here("report", str(run), "--table", str(file), code=2)
    assert said == f"fjr: {file} exists; expected a new file, or --force\n"
    assert file.read_text() == "mine"
    said = fjr_here("report", str(run), "--table", str(other), code=2)
    assert said == f"fjr: {other} is no table; expected a name that ends with .csv or .parquet\n"
    assert "--table is of one bag; 2 are given; expected one" in fjr_here(
        "report", str(run), str(run), "--table", str(tmp_path / "two.csv"), code=2
    )
    fjr_here("report", str(run), "--table", str(file), "--force")
    assert file.read_text().startswith("t [s],")


def test_several_runs_show_the_parameters_that_differ(run: Path, tmp_path: Path) -> None:
    folders = [shutil.copytree(run, tmp_path / each / "two_link") for each in ("one", "#2: 50%")]
    changed, _ = library.as_run(run / "scenario.yaml", {"gains.Lambda_l": [5.0, 6.0]})
    stiffness = "\n/**/fjr_plant:\n  ros__parameters:\n    robot: {joint_stiffness: [900.0, 800.0]}\n"
    (folders[1] / "scenario.yaml").write_text(changed + stiffness)
    said = fjr_here("report", *map(str, folders))
    rows = [line.split("  ") for line in said.splitlines() if line.startswith(("parameter ", "gains.", "robot."))]
    rows = [[cell.strip() for cell in row if cell.strip()] for row in rows]
    given = load_scenario(run / "scenario.yaml").controller_values
    before, soft = (str(list(given[each])) for each in ("gains.Lambda_l", "robot.joint_stiffness"))
    assert rows == [
        ["parameter", *map(str, folders)],
        ["robot.joint_stiffness", soft, f"{soft}, plant: [900.0, 800.0]"],
        ["gains.Lambda_l", before, "[5.0, 6.0]"],
    ]
    page = (tmp_path / "comparison.html").read_text()
    links = [unquote(link) for link in re.findall('href="([^"]*report.html)"', page) if "#" not in link]
    assert [tmp_path / link for link in links] == [folder / "report.html" for folder in folders]
    assert f"<tr><th>gains.Lambda_l</th><td>{before}</td><td>[5.0, 6.0]</td></tr>" in page
    assert "Parameters that differ" not in fjr_here("report", str(folders[0]))

    other = tmp_path / "arm7.yaml"
    other.write_text(library.as_run(Path(scenario("arm7")), {})[0])
    shutil.copy(other, folders[1] / "scenario.yaml")
    said = fjr_here("report", *map(str, folders))
    begin = said.index("\nparameter ")
    listed = said[begin:].strip().partition("\n\n")[0].splitlines()
    assert len(listed) == 1 + 12 + 1
    assert re.fullmatch(r"and \d+ more", listed[-1])


@pytest.mark.parametrize(
    ("duration", "change", "topics", "other"),
    [
        (np.inf, None, None, False),
        (0.4, None, None, True),
        (0.4, None, (STATES, EFFORTS), False),
        (0.4, without(lambda _: True, "velocity"), None, False),
        (0.4, without(lambda name: not name.endswith("_motor")), None, False),
        (np.inf, looped, None, False),
        (np.inf, unanswered, None, False),
    ],
    ids=["whole", "other reference", "efforts without stamps", "no velocities", "links only", "looped", "unanswered"],
)
def test_a_run_in_many_parts_has_the_report_of_one_part(
    in_order: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    duration: float,
    change: Any,
    topics: Any,
    other: bool,
    model: Scenario,
    another: Scenario,
) -> None:
    """Up to its end, or up to a planned duration."""
    bag = rewritten(in_order, tmp_path / "copy", topics=topics, change=change) if change or topics else in_order
    model = another if other else model
    found = []
    for size, around in ((10_000, 10_000), (97, 60)):
        monkeypatch.setattr(recorded_run, "AROUND", around)
        monkeypatch.setattr(signals, "TOGETHER", size)
        monkeypatch.setattr(stored, "IN_MEMORY", size)
        monkeypatch.setattr(recorded_run, "PART", size)
        recording = Recording(read_bag(bag), model, duration)
        parts = list(parts_of(recording, size))
        metrics = Metrics(recording, size)
        shown = Shown(metrics)
        found.append((parts, metrics.report("run", 1.0).as_json(), shown))
    (one, whole, shown), (many, pieces, in_parts) = found
    assert len(one) == 1
    assert len(many) > 3
    for name in ("t", "position", "velocity", "jets", "u", "sent", "answered", "torque"):
        values = np.concatenate([getattr(part, name)[part.begin :] for part in many])
        rounding = 1e-5 if name == "jets" else 1e-9  # the fourth derivative of a spline
        np.testing.assert_allclose(values, getattr(one[0], name), rtol=rounding, atol=rounding)
    assert_close(pieces, whole)
    for values, others in ((shown.states, in_parts.states), (shown.steps, in_parts.steps)):
        for name in values:
            np.testing.assert_allclose(others[name], values[name], rtol=1e-6, atol=1e-9)


def test_the_replay_follows_the_length_of_a_run_and_tells_when_it_is_coarse(
    in_order: Path, model: Scenario, monkeypatch: pytest.MonkeyPatch
) -> None:
    metrics = Metrics(Recording(read_bag(in_order), model, np.inf))
    seconds = metrics.run.columns.column("t")[-1]
    for most, frames, said in ((10**6, seconds / 0.005, ""), (20, 20, f"; a position each {seconds / 20:.2g} s")):
        monkeypatch.setattr(decimation, "FRAMES", 10)
        monkeypatch.setattr(decimation, "MOST_FRAMES", most)
        monkeypatch.setattr(decimation, "FRAME", 0.005)
        found = Shown(metrics)
        assert len(found.frames["t"]) == pytest.approx(frames, abs=1)
        replay = arm_replay(found)
        assert replay is not None
        assert replay.title.partition(")")[2] == said


def test_messages_that_were_received_late_have_their_place_by_the_time_they_were_sent(
    run: Path, tmp_path: Path, model: Scenario
) -> None:
    """As beside busy programs: every seventh message of each topic is received 0.3 s later, hundreds of states."""
    found = []
    for folder, late in ((tmp_path / "in time", 0.0), (tmp_path / "late", 0.3)):
        received(run, folder, late)
        parts = list(parts_of(Recording(read_bag(folder), model, 1.0), 100))
        found.append([np.concatenate([getattr(part, name)[part.begin :] for part in parts]) for name in ("t", "u")])
    for values, wanted in zip(*found, strict=True):
        np.testing.assert_array_equal(values, wanted)
    assert not np.isnan(found[1][1]).any()


STEPPED = 600_000_000  # ns


def set_back(bag: Path, target: Path, step: int, stamps: bool = False, topics: Collection[str] = OURS) -> Path:
    """Copy a bag as if the clock had stepped back by `step` [ns] after STEPPED; stamps: those, too."""
    with AnyReader([bag], default_typestore=STORE) as reader, Writer(target, version=9) as writer:
        kept = [each for each in reader.connections if each.topic in topics]
        made = {each.id: writer.add_connection(each.topic, each.msgtype, typestore=STORE) for each in kept}
        late = False
        for each, time, raw in reader.messages(kept):
            late, data = late or (each.topic == STATES and header_stamp(raw) >= START + STEPPED), raw
            if late and stamps and each.topic != EFFORTS:
                message = STORE.deserialize_cdr(raw, each.msgtype)
                stamp = replace(message.header.stamp, **seconds(nanoseconds(message) - step))
                data = STORE.serialize_cdr(replace(message, header=replace(message.header, stamp=stamp)), each.msgtype)
            writer.write(made[each.id], time - step * late, data)
    return target


def seconds(stamp: int) -> dict[str, int]:
    """Return a stamp [ns] as the fields of a Time."""
    return dict(zip(("sec", "nanosec"), divmod(stamp, 10**9), strict=True))


@pytest.mark.parametrize("topics", [OURS, (STATES, EFFORTS)], ids=["stamped commands", "efforts without stamps"])
@pytest.mark.parametrize("step", [500_000_000, 3600 * 10**9], ids=["half a second", "an hour"])
def test_a_run_is_reported_whole_if_the_clock_stepped_back(
    in_order: Path, run: Path, tmp_path: Path, model: Scenario, topics: tuple[str, ...], step: int
) -> None:
    """As by NTP or `date -s`. The stamps of the plant follow the steady clock; send and receive times do not."""
    _, wanted = read(rewritten(in_order, tmp_path / "whole", topics=topics), model)
    bag = set_back(in_order, tmp_path / "bag", step, topics=topics)
    recording, found = read(bag, model)
    assert_same(found, wanted, *SIGNALS)
    period, (note,) = np.diff(wanted.sent), recording.bag.notes
    seen = re.fullmatch(r"the clock stepped back by (.*) s: send times go on from there", note)
    assert seen and float(seen[1]) == pytest.approx(step * 1e-9, abs=period.max() + 0.005)  # noqa: PT018
    lost = np.abs(np.diff(found.sent) - period)
    assert (lost > 1e-9).sum() <= 1  # the state behind the step
    assert lost.max() <= period.max()
    assert (np.abs(found.latency - wanted.latency) > 1e-9).sum() <= 1
    if topics == OURS:
        assert report(bag, run, tmp_path)["missing"] == list(recording.bag.notes)


def test_a_message_that_is_under_way_while_the_clock_steps_back_keeps_its_place(
    run: Path, tmp_path: Path, model: Scenario
) -> None:
    """It was sent before the step and received behind it, an hour earlier."""
    hour = 3600 * 10**9
    _, whole = read(received(run, tmp_path / "whole"), model)
    _, found = read(received(run, tmp_path / "bag", step=hour), model)
    assert_same(found, whole, "t", "position", "u")
    states = read_bag(tmp_path / "bag").topics[STATES]
    assert states.last - states.first < 60 * 10**9  # it is not played an hour early, either


def test_a_message_that_is_sent_again_is_no_step_of_the_clock(run: Path, tmp_path: Path, model: Scenario) -> None:
    """As if the network had lost it: those behind it were received before, and wait for it."""
    bag, writer = read_bag(run), BagWriter(tmp_path / "bag")
    states = bag.topic(STATES).messages
    channel = writer.add_topic(STATES, JOINT_STATE, [], "")
    for k, each in enumerate(states):
        writer.write(channel, each.publish_time + 10**9 * (k == 300), each.publish_time, each.sequence, each.data)
    writer.close()
    assert read_bag(tmp_path / "bag").notes == ()
    stamps, sent = (Recording(read_bag(path), model, 1.0).signals for path in (run, tmp_path / "bag"))
    np.testing.assert_array_equal(stamps.stamp[:600], sent.stamp[:600])


@pytest.mark.parametrize("step", [300_000_000, 3600 * 10**9], ids=["0.3 s", "an hour"])
def test_stamps_that_step_back_with_the_clock_begin_another_part(
    in_order: Path, tmp_path: Path, model: Scenario, step: int
) -> None:
    """Those of a driver: the controller does not answer older stamps, or its reference restarts."""
    _, wanted = read(in_order, model)
    recording, found = read(set_back(in_order, tmp_path / "bag", step, stamps=True), model)
    assert "time jumps back 1 times: shown is the longest of 2 parts" in recording.notes
    first = STEPPED // 1_000_000  # the plant goes on for some time after the second that was asked for
    part = slice(0, first) if len(found.t) == first else slice(first, None)
    np.testing.assert_array_equal(found.position[: 1000 - part.start], wanted.position[part])


@pytest.mark.parametrize(("count", "noted"), [(5, False), (100, True)])
def test_states_that_the_recorder_lost_are_noted(
    count: int, noted: bool, run: Path, tmp_path: Path, model: Scenario
) -> None:
    """As one that had no core or was suspended: what it lost may hold a fault, and the verdict does not say so."""
    bag, sent = received(run, tmp_path / "bag", lost=range(300, 300 + count)), read_bag(run).topics[STATES].count
    note = f"the recorder lost {count} of {sent} states: they are not judged"
    assert Recording(read_bag(bag), model, 1.0).notes == (note,) * noted


@pytest.mark.parametrize("ahead", [0, 2_000_000, -2_000_000, 5_000_000_000, -5_000_000_000])
def test_commands_of_another_machine_answer_their_states_whatever_its_clock_says(
    ahead: int, run: Path, tmp_path: Path, model: Scenario
) -> None:
    """The recorder's clock is that of neither; before, 5 s cost the answers of as many seconds."""
    _, wanted = read(received(run, tmp_path / "one machine"), model)
    recording, found = read(received(run, tmp_path / "two machines", ahead=ahead), model)
    np.testing.assert_array_equal(found.u, wanted.u)
    np.testing.assert_allclose(found.latency, wanted.latency, rtol=0, atol=1e-9)
    note = f"the commands' clock is {ahead * 1e-9:+g} s ahead (two machines, or a slow network): corrected"
    assert recording.notes == (note,) * bool(ahead)


def received(
    run: Path, folder: Path, late: float = 0.0, lost: Collection[int] = (), step: int = 0, ahead: int = 0
) -> Path:
    """Copy the bag of a run with messages received when they were sent, every seventh of a topic `late` [s].

    lost: messages of each topic that are left out. step [ns]: by which the clock steps back between sending the middle
    state and receiving it. ahead [ns]: of the clock of the controller's machine.
    """
    bag, writer = read_bag(run), BagWriter(folder)
    channels = {topic: writer.add_topic(topic, bag.topics[topic].type_name, [], "") for topic in OURS}
    messages = [
        (message.publish_time + round(1e9 * late) * (k % 7 == 0), topic, message)
        for topic in OURS
        for k, message in enumerate(bag.topic(topic).messages)
        if k not in lost
    ]
    states = bag.topic(STATES).publish_time
    middle = int(states[len(states) // 2])
    for k, (at, topic, message) in enumerate(sorted(messages, key=lambda each: each[0])):
        at, sent = at - step * (at >= middle), message.publish_time - step * (message.publish_time > middle)
        sent += ahead * (topic != STATES)
        writer.write(channels[topic], at, sent, message.sequence, message.data)
        if k % 500 == 0:
            writer.flush()  # a recorder ends its chunks by time, so a fast run has few
    writer.close()
    return folder


def assert_close(found: Any, wanted: Any, where: str = "") -> None:
    """Compare two values of JSON; numbers to rounding."""
    if isinstance(wanted, dict):
        assert list(found) == list(wanted), where
        for name, value in wanted.items():
            assert_close(found[name], value, f"{where}/{name}")
    elif isinstance(wanted, list):
        assert len(found) == len(wanted), where
        for each, value in zip(found, wanted, strict=True):
            assert_close(each, value, where)
    elif isinstance(wanted, float):
        assert found == pytest.approx(wanted, rel=1e-6, abs=1e-9), where
    else:
        assert found == wanted, where


def test_a_spike_of_one_state_is_seen_in_a_long_run() -> None:
    rows, values = 100_000, np.random.default_rng(0).normal(size=(100_000, 3))
    values[54_321, 1], values[12_345, 2] = 50.0, -50.0
    run = Columns()
    for part in np.array_split(np.arange(rows), 17):
        run.add(t=part.astype(float), values=values[part])
    t, kept = run.at(kept_rows(len(run), run.each(("t", "values")))).values()
    assert len(t) < 10 * BUCKETS
    assert t[0] == 0 and t[-1] == rows - 1 and (np.diff(t) > 0).all()  # noqa: PT018
    assert t[np.argmax(kept[:, 1])] == 54_321
    assert t[np.argmin(kept[:, 2])] == 12_345


def test_topics_in_a_namespace_are_found_and_two_are_ambiguous(run: Path, tmp_path: Path) -> None:
    bag = rewritten(run / "bag", tmp_path / "left", topics=OURS, prefix="/left")
    assert report(bag, run, tmp_path)["missing"] == []
    with Writer(tmp_path / "two", version=9) as writer:
        for side in ("left", "right"):
            added = writer.add_connection(f"/{side}{STATES}", JOINT_STATE, typestore=STORE)
            for raw in read_bag(bag).topic(STATES).messages[:100]:
                writer.write(added, raw.log_time, raw.data)
    arguments = ("report", str(tmp_path / "two"), "--scenario", str(run / "scenario.yaml"))
    assert "/left/joint_states and /right/joint_states; expected one, or its namespace" in fjr_here(*arguments, code=2)
    assert "two_report/report.html" in fjr_here(*arguments, "--namespace", "left")


def test_what_is_known_of_a_run_is_not_that_of_the_run_whose_scenario_is_taken(run: Path, tmp_path: Path) -> None:
    other, out = tmp_path / "other", tmp_path / "out"
    other.mkdir()
    shutil.copy(run / "scenario.yaml", other)
    made = json.loads((run / "report.json").read_text())
    (other / "report.json").write_text(json.dumps({**made, "planned_s": 0.5, "failure": "its disk was full"}))
    fjr_here("report", str(run / "bag"), "--scenario", str(other / "scenario.yaml"), "--output", str(out))
    (file,) = out.glob("*/report.json")
    found = json.loads(file.read_text())
    assert [found[key] for key in ("planned_s", "duration_s", "failure")] == [made["planned_s"], made["duration_s"], ""]


def test_topics_of_two_robots_are_not_mixed() -> None:
    """The robot without a namespace has states only; diagnostics are those of all robots."""
    held = (STATES, f"/left{STATES}", "/left/joint_commands", "/left/fjr_controller/reference", "/diagnostics")
    bag = Bag(Path(), {name: Topic(name, JOINT_STATE, "", count=1) for name in held}, True)
    wanted = (STATES, "/joint_commands", "/fjr_controller/reference", "/diagnostics")
    assert [bag.holds(name) for name in wanted] == [True, False, False, True]
    left = replace(bag, namespace="/left")
    assert [left.held(name).name for name in wanted] == [*held[1:]]
    driver_outside = replace(bag, topics={name: bag.topics[name] for name in (held[0], *held[2:])})
    assert [driver_outside.held(name).name for name in wanted] == [held[0], *held[2:]]


def test_another_robots_bag_is_named_and_its_timing_shown(run: Path, tmp_path: Path) -> None:
    said = fjr_here("report", str(run), "--scenario", scenario("paper_k31"), "--output", str(tmp_path))
    assert "the states name shoulder, elbow" in said
    assert "the scenario's robot has joint1" in said
    made = json.loads((tmp_path / "two_link" / "report.json").read_text())
    assert made["timing"]["period_p50_us"] > 0
    assert made["tracking"]["initial_error_rad"] is made["storage"] is None
    assert made["verdict"]["kind"] == "unknown"


def test_truncated_bag_is_reported_up_to_its_end(run: Path, in_order: Path, tmp_path: Path) -> None:
    torn, content = tmp_path / "torn.mcap", next(in_order.glob("*.mcap")).read_bytes()
    torn.write_bytes(content[: content.index(read_bag(run).topic(STATES).messages[600].data)])
    made = report(torn, run, tmp_path)
    assert not made["bag_complete"]
    assert "the bag was not closed" in made["missing"][0]
    assert 100 < made["counts"]["published"] <= 600


def test_two_bags_of_equal_name_have_separate_pages_beside_one_that_cannot_be_read(run: Path, tmp_path: Path) -> None:
    nothing, out = tmp_path / "nothing.mcap", tmp_path / "out"
    nothing.write_bytes(b"")
    given = ("--scenario", str(run / "scenario.yaml"), "--output", str(out))
    said = fjr_here("report", str(run), str(run), str(nothing), *given, code=1)
    assert f"{nothing} holds no message of {STATES}; it holds nothing, and was not closed" in said
    assert sorted(path.parent.name for path in out.glob("*/report.html")) == ["two_link", "two_link-2"]
    assert f"{out / 'two_link-2'} (lock-step)" in said
    assert (out / "comparison.html").read_text().count('href="two_link-2/report.html"') == 1


UNSUITABLE = {
    "closed": "holds no message of /joint_states; it holds nothing",
    "other topics": "holds no message of /joint_states; it holds /effort_controller/commands",
    "other types": "is a std_msgs/msg/String; expected sensor_msgs/msg/JointState",
    "words.mcap": "is not an MCAP file",
    "words.db3": "is not a readable SQLite bag: file is not a database",
    "tables.db3": "is not a readable SQLite bag: no such table",
    "folder": "is not a bag: expected a folder with .mcap or .db3 files",
    "absent": "does not exist; expected the folder of a bag",
}


def test_an_unsuitable_bag_is_refused_with_the_reason(run: Path, tmp_path: Path) -> None:
    with Writer(tmp_path / "closed", version=9, storage_plugin=StoragePlugin.MCAP):
        pass
    rewritten(run / "bag", tmp_path / "other topics", topics=("/rosout", EFFORTS))
    with Writer(tmp_path / "other types", version=9) as writer:
        writer.write(writer.add_connection(STATES, "std_msgs/msg/String", typestore=STORE), 1, text_message("x"))
    for name in ("words.mcap", "words.db3"):
        (tmp_path / name).write_text("just words, a good deal of them")
    sqlite3.connect(tmp_path / "tables.db3").execute("CREATE TABLE things (id)").connection.close()
    (tmp_path / "folder").mkdir()
    for name, words in UNSUITABLE.items():
        given = str(tmp_path / name), "--scenario", str(run / "scenario.yaml")
        said = fjr_here("report", *given, code=2).strip()
        assert f"{tmp_path / name}" in said
        assert words in said
        assert said.count("\n") == 0


def test_a_bag_without_a_scenario_asks_for_one(run: Path, tmp_path: Path) -> None:
    bag = rewritten(run / "bag", tmp_path / "copy", topics=OURS)
    assert "expected scenario.yaml next to the bag, or --scenario" in fjr_here("report", str(bag), code=2)


def test_long_values_are_shown_from_where_they_differ() -> None:
    rates = [f"gains.Lambda_l:=[{', '.join(['10.123456789012'] * 6 + [last])}]" for last in ("10.5", "11.5")]
    runs = [
        SimpleNamespace(data=SimpleNamespace(run=SimpleNamespace(scenario=library.load("arm7", [rate]))))
        for rate in rates
    ]
    ((name, first, second),) = differences(runs)  # type: ignore[arg-type]
    assert name == "gains.Lambda_l"
    assert (first[-6:], second[-6:]) == (" 10.5]", " 11.5]")
    assert len(first) < 80
