# SPDX-License-Identifier: Apache-2.0
"""Bags, plans and kept results of any bytes: what is undamaged is read, each loss is said, all else is one sentence."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from contextlib import AbstractContextManager, closing
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rclpy.qos import QoSProfile
from rosbags.rosbag2 import CompressionMode

from fjr_design.studies import suite
from fjr_design.studies.study import Kept, Store, open_store
from fjr_design.studies.sweep import Sweep, planned, usual
from fjr_monitor.recording.bag import Bag, BagError, JointTable, read_bag
from fjr_monitor.recording.files import Topic
from fjr_monitor.recording.message_types import definition, type_hash
from fjr_monitor.recording.recorder import BagWriter
from fjr_monitor.report.write import known_of
from fjr_msgs_py.scenarios import library
from fuzzing import answer, bytes_of, documents, fuzzed
from system.bags import JOINT_STATE, joint_state, rewritten

TOPIC = "/states"
CHUNKS, IN_CHUNK = 6, 40
SENT = CHUNKS * IN_CHUNK


ALL = [joint_state(k * 10**9, "ab", position=(k, -k), velocity=(k, -k), effort=(k, -k)) for k in range(SENT)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a closed bag of CHUNKS chunks."""
    folder = tmp_path_factory.mktemp("whole") / "bag"
    writer = BagWriter(folder)
    channel = writer.add_topic(TOPIC, JOINT_STATE, [QoSProfile(depth=1)], type_hash(JOINT_STATE))
    for k, data in enumerate(ALL):
        writer.write(channel, 10**18 + k, 10**18 + k, k, data)
        if k % IN_CHUNK == IN_CHUNK - 1:
            writer.flush()
    writer.close()
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("damaged")


def written(folder: Path, data: bytes, name: str = "some.mcap") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


def messages(bag: Bag) -> list[bytes]:
    return [each.data for each in bag.topic(TOPIC).messages] if TOPIC in bag.topics else []


def table_of(path: Path) -> JointTable:
    """Return the states of a bag as arrays."""
    bag = read_bag(path)
    return bag.table(bag.topic(TOPIC), ("a", "b"))


def content(whole: Path, suffix: str = ".mcap") -> bytes:
    return next(whole.glob(f"*{suffix}")).read_bytes()


def chunks(data: bytes, folder: Path) -> list[tuple[int, int]]:
    """Return begin and end of each chunk, as found by the reader of mcap."""
    with open(written(folder, data, "index.mcap"), "rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    return sorted(
        (each.chunk_start_offset, each.chunk_start_offset + each.chunk_length) for each in summary.chunk_indexes
    )


def flipped(data: bytes, place: int, bit: int = 0) -> bytes:
    return data[:place] + bytes([data[place] ^ 1 << bit]) + data[place + 1 :]


def test_a_flipped_bit_in_a_chunk_costs_that_chunk(whole: Path, folder: Path) -> None:
    """In its length, of whose records those before it stay, and in its content, whose checksum then differs."""
    data = content(whole)
    assert (messages(read_bag(whole)), read_bag(whole).notes) == (ALL, ())
    for number, (begin, end) in enumerate(chunks(data, folder)):
        rest = ALL[: number * IN_CHUNK] + ALL[(number + 1) * IN_CHUNK :]
        for place in range(begin, begin + 60, 1 if number == 0 else 20):
            bag = read_bag(written(folder, flipped(data, place, place % 8)))
            assert set(rest) <= set(messages(bag))
            assert bag.notes or len(messages(bag)) == SENT
        for place in np.linspace(begin + 60, end - 1, 5, dtype=int):
            bag = read_bag(written(folder, flipped(data, int(place), int(place) % 8)))
            assert messages(bag) == rest
            assert bag.complete
            assert f"{IN_CHUNK} of {SENT} messages are lost" in " ".join(bag.notes)


@fuzzed(60)
@given(place=st.floats(0, 1, exclude_max=True), bit=st.integers(0, 7))
def test_any_flipped_bit_costs_at_most_one_chunk(whole: Path, folder: Path, place: float, bit: int) -> None:
    data = content(whole)
    bag = read_bag(written(folder, flipped(data, int(place * len(data)), bit)))
    found = messages(bag)
    assert set(found) <= set(ALL)
    assert len(found) >= SENT - IN_CHUNK
    assert bag.notes or len(found) == SENT


def made(
    path: Path, compression: CompressionType, chunked: bool, times: tuple[int, ...] = (), text: bytes = b""
) -> Path:
    """Write ALL by the library mcap, and a message at each of more times."""
    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=4000, compression=compression, use_chunking=chunked, enable_data_crcs=True)
        writer.start(profile="ros2")
        number = writer.register_schema(JOINT_STATE, "ros2msg", text or definition(JOINT_STATE).encode())
        channel = writer.register_channel(TOPIC, "cdr", number)
        for k, data in [*enumerate(ALL), *((time, ALL[0]) for time in times)]:
            writer.add_message(channel, k, data, k)
        writer.finish()
    return path


@pytest.mark.parametrize("chunked", [True, False], ids=["chunks", "no chunks"])
@pytest.mark.parametrize("compression", list(CompressionType), ids=lambda each: each.name)
def test_bags_of_other_writers_are_read_damaged_or_not(
    compression: CompressionType, chunked: bool, folder: Path
) -> None:
    path = made(folder / "other.mcap", compression, chunked)
    assert messages(read_bag(path)) == ALL
    assert read_bag(path).notes == ()
    data = path.read_bytes()
    for place in range(600, len(data) // 2, len(data) // 25):
        bag = read_bag(written(folder, flipped(data, place, 5)))
        assert len(messages(bag)) > SENT / 2
        assert bag.notes or messages(bag) == ALL  # damage to an index that is not needed


def test_times_beyond_63_bits_and_a_definition_that_is_not_utf8_cost_nothing_else(folder: Path) -> None:
    late, latin = (2**63, 2**64 - 1), b"# caf\xe9\nint32 x"
    bag = read_bag(made(folder / "late.mcap", CompressionType.NONE, True, late, latin))
    assert bag.topic(TOPIC).publish_time.tolist() == list(range(SENT))
    assert "2 messages" in " ".join(bag.notes)
    assert len(bag.topic(TOPIC).decoded) == SENT  # a definition is needed for unknown types only


@pytest.mark.parametrize("name", ["a/msg/B\nint32 x", "a/msg/B", "../../x", "", "import os"])
@pytest.mark.parametrize("text", ["import os", "int32 x\nstring s='", "\xff", "=" * 70, "a/b/C[] c", "x" * 2**21])
def test_invalid_definitions_are_reported_in_one_sentence(name: str, text: str) -> None:
    from mcap.records import Message

    topic = Topic("/t", name, text, [Message(0, 0, ALL[0], 0, 0)])
    with pytest.raises(BagError, match="/t "):
        _ = topic.decoded


def test_lengths_beyond_the_file_cost_their_chunk_at_most(whole: Path, folder: Path) -> None:
    """Of the chunk, whose memory is not taken, and of its index; a checksum of the summary of 0 stands for none."""
    data = content(whole)
    begin, end = chunks(data, folder)[0]
    bag = read_bag(written(folder, data[: begin + 25] + struct.pack("<Q", 2**40) + data[begin + 33 :]))
    assert len(messages(bag)) >= SENT - IN_CHUNK
    assert bag.notes
    for length in (2**62, 2**63, 2**64 - 1):  # of the data in the chunk
        bag = read_bag(written(folder, data[: begin + 41] + struct.pack("<Q", length) + data[begin + 49 :]))
        assert len(messages(bag)) >= SENT - IN_CHUNK
        assert bag.notes or messages(bag) == ALL
    index = struct.pack("<QQ", begin, end - begin)
    place = data.rindex(index)
    for wrong in ((2**63 + 5, end - begin), (begin, 2**62)):
        changed = data[:place] + struct.pack("<QQ", *wrong) + data[place + len(index) :]
        bag = read_bag(written(folder, changed[:-12] + bytes(4) + changed[-8:]))
        assert messages(bag)[-len(ALL) + IN_CHUNK :] == ALL[IN_CHUNK:]
        assert bag.notes or messages(bag) == ALL


@pytest.fixture(scope="module")
def tables(whole: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the bag in SQLite format."""
    return content(rewritten(whole, tmp_path_factory.mktemp("sqlite") / "bag"), ".db3")


@pytest.mark.parametrize("fill", [0, 0xA5])
def test_a_page_that_is_overwritten_costs_the_messages_behind_it(fill: int, tables: bytes, folder: Path) -> None:
    page = int.from_bytes(tables[16:18], "big")
    for begin in (begin for begin in range(page, len(tables), page) if tables[begin] == 13):  # rows of a table
        data = tables[:begin] + bytes([fill]) * page + tables[begin + page :]
        bag = read_bag(written(folder, data, "some.db3"))
        found = messages(bag)
        assert found == ALL[: len(found)]
        assert len(found) == SENT or f"is damaged; {len(found)} messages read" in " ".join(bag.notes)


@pytest.mark.parametrize("suffix", [".mcap", ".db3"])
@fuzzed(60)
@given(data=st.data())
def test_files_of_any_bytes(suffix: str, whole: Path, tables: bytes, folder: Path, data: st.DataObject) -> None:
    path = written(folder, data.draw(bytes_of(tables if suffix == ".db3" else content(whole))), f"fuzzed{suffix}")
    answer(lambda: table_of(path))


ODD = ("('a', 'b', 'c')", "(77, 1, x'00')", "(1, -5, x'00')", "(1, 2.5, 'text')")
"""Rows without a number, of no topic, before 1970 and without bytes."""


def test_invalid_rows_are_skipped(tables: bytes, folder: Path) -> None:
    path = written(folder, tables, "odd.db3")
    with closing(sqlite3.connect(path)) as database:
        for statement in ODD:
            database.execute(f"INSERT INTO messages(topic_id, timestamp, data) VALUES {statement}")
        database.commit()
    bag = read_bag(path)
    assert messages(bag) == ALL
    assert f"{len(ODD)} messages of" in " ".join(bag.notes)


def test_an_endless_view_is_refused(folder: Path) -> None:
    path = folder / "endless.db3"
    with closing(sqlite3.connect(path)) as database:
        database.execute("CREATE TABLE topics(id INTEGER, name TEXT, type TEXT)")
        endless = "WITH RECURSIVE r(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM r) SELECT id, 1 AS topic_id FROM r"
        database.execute(f"CREATE VIEW messages AS {endless}")
    assert "no such table: messages" in answer(lambda: read_bag(path))


@fuzzed(20)
@given(data=st.data())
def test_compressed_bags_of_any_bytes(whole: Path, folder: Path, data: st.DataObject) -> None:
    source = folder / "compressed"
    if not source.exists():
        rewritten(whole, source, compression=CompressionMode.FILE)
    target = folder / "hostile"
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(source, target)
    for path in sorted(target.iterdir()):
        path.write_bytes(data.draw(bytes_of(path.read_bytes())))
    answer(lambda: table_of(target))


SUITE = """
laws: [v_dpbc, {label: own, law: pd_gravity, robust: {integral_gain: 1.0}}]
robots: {paper_k31: {scenario: paper_k31, references: {slow: {reference.frequency: [0.1]}}}}
imperfections: {late: {delay: 1.0}}
margins: [delay]
duration: 2.0
"""
SWEEP = """
scenario: paper_k31
vary: {stiffness: {uniform: [0.7, 1.3], each_joint: true}, delay: {uniform: [0.0, 0.001]}, payload_mass: 0.1}
success: {peak: 0.1}
set: {publish_rate: 500.0}
runs: 20
duration: 0.1
"""


def read_sweep(folder: Path, text: str) -> str:
    path = folder / "sweep.yaml"
    path.write_text(text)
    return answer(lambda: planned(str(path)))


@fuzzed(30)
@given(a_suite=documents(yaml.safe_load(SUITE)), a_sweep=documents(yaml.safe_load(SWEEP)))
def test_suites_and_sweeps_with_misplaced_values(folder: Path, a_suite: str, a_sweep: str) -> None:
    (folder / "suite.yaml").write_text(a_suite)
    answer(lambda: suite.load(folder / "suite.yaml"))
    read_sweep(folder, a_sweep)


@pytest.mark.parametrize("name", ["x" * 5000, "a/" * 3000, "..", "/dev/zero", ""])
def test_sweep_of_an_impossible_path_is_refused(name: str, folder: Path) -> None:
    assert read_sweep(folder, yaml.safe_dump({**yaml.safe_load(SWEEP), "scenario": name}))
    assert answer(lambda: library.find(name))
    assert answer(lambda: library.find(name, "suite"))


PLAN = Sweep("small", "/**: {ros__parameters: {compile: false}}", 20, usual(1e-3), duration=0.1)
COLUMNS = {"run": np.arange(10), "success": np.ones(10, bool)}


def opened(folder: Path) -> AbstractContextManager[Store]:
    return open_store(folder, PLAN.text, "program")


def filled(folder: Path) -> Path:
    with opened(folder) as store:
        store.keep("first", COLUMNS)
        assert store.holds("first")
    return next((folder / "parts").glob("*.parquet"))


def taken_up(folder: Path) -> None:
    with opened(folder):
        pass


@fuzzed(8)
@given(data=st.data())
def test_changed_part_is_computed_again(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    folder = tmp_path_factory.mktemp("store")
    part = filled(folder)
    content = data.draw(bytes_of(part.read_bytes()))
    same = content == part.read_bytes()
    part.write_bytes(content)
    with opened(folder) as store:
        assert store.holds("first") == same


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", "3", "{", '{"program": []}', "\0"])
def test_a_changed_table_and_an_invalid_study_file_are_refused(text: str, tmp_path: Path) -> None:
    filled(tmp_path)
    with opened(tmp_path) as store:
        store.keep("second", COLUMNS)
        table = store.write_table(["first", "second"])
        assert pq.read_table(table).num_rows == 20
    table.write_bytes(table.read_bytes()[:-1] + b"x")
    assert "SHA-256" in answer(lambda: taken_up(tmp_path))
    (tmp_path / "study.json").write_text(text)
    assert answer(lambda: taken_up(tmp_path))


def test_changed_kept_result_is_computed_again(tmp_path: Path) -> None:
    path, kept = tmp_path / "job.json", Kept(tmp_path)
    kept.keep("job", {"law": "v_dpbc"})
    assert kept.holds("job")
    assert kept.read("job") == {"law": "v_dpbc"}
    for text in ('{"law": "v_dpbd"}', "[]", "[" * 100_000):
        path.write_text(text)
        assert not kept.holds("job")
    path.write_text('{"law": "v_dpbc"}')
    (tmp_path / "job.json.sha256").unlink()
    assert not kept.holds("job")


@pytest.mark.parametrize("text", ["[" * 100_000, "[]", '{"planned_s": "5", "not_recorded": [], "failure": 3}'])
def test_invalid_entries_of_an_earlier_report_are_ignored(text: str, tmp_path: Path) -> None:
    (tmp_path / "report.json").write_text(text)
    assert known_of(tmp_path / "report.json") == {}
