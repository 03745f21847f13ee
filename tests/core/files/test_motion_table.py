# SPDX-License-Identifier: Apache-2.0
"""CSV files of motions: columns by name, errors in one sentence with line and column, no other exception."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_core.files.motion_table import MotionTable, motion_text, parse_motion, read_motion
from fuzzing import answer, fuzzed, refused

JOINTS = ("a", "b")


def test_columns_come_in_any_order_and_others_are_ignored() -> None:
    table = parse_motion("# a comment\nb, note, time, a\n\n1,x,0.5,2\n3,,0.75,4\n", JOINTS)
    np.testing.assert_array_equal(table.times, [0.0, 0.25])
    np.testing.assert_array_equal(table.positions, [[2.0, 1.0], [4.0, 3.0]])
    assert table.velocities is None


def test_velocities_are_read_if_every_joint_has_them_unless_a_joint_is_called_so() -> None:
    table = parse_motion("time,a,b,b_velocity,a_velocity\n0,1,2,3,4\n1,5,6,7,8\n", JOINTS)
    np.testing.assert_array_equal(table.velocities, [[4.0, 3.0], [8.0, 7.0]])
    table = parse_motion("time,a,a_velocity\n0,1,2\n1,3,4\n", ("a", "a_velocity"))
    np.testing.assert_array_equal(table.positions, [[1.0, 2.0], [3.0, 4.0]])
    assert table.velocities is None


def test_a_written_motion_is_read_back_to_the_last_bit() -> None:
    rows = np.random.default_rng(0).normal(size=(2, 9, 2))
    table = MotionTable(np.arange(9) / 7, rows[0], rows[1])
    found = parse_motion(motion_text(table, JOINTS), JOINTS)
    for name in ("times", "positions", "velocities"):
        np.testing.assert_array_equal(getattr(found, name), getattr(table, name))


BAD = {
    "empty": ("", "the header is '', without time; expected the columns time, a, b"),
    "no joint": ("time,a\n0,1\n", "the header is 'time, a', without b; expected the columns time, a, b"),
    "some velocities": ("time,a,b,a_velocity\n0,1,2,3\n", "without b_velocity"),
    "twice": ("time,a,b,a\n0,1,2,3\n", "the header has the column a more than once; expected it once"),
    "word": ("time,a,b\n0,1,2\n1,x,2\n", "line 3, column a: 'x'; expected a finite number"),
    "nan": ("time,a,b\n0,1,nan\n", "line 2, column b: 'nan'; expected a finite number"),
    "underscore": ("time,a,b\n0,1,1_0\n", "line 2, column b: '1_0'; expected a finite number"),
    "short": ("time,a,b\n# note\n0,1\n", "line 3 has 2 columns; expected 3, as in the header"),
    "one sample": ("time,a,b\n0,1,2\n", "1 samples are given; expected at least 2"),
    "back": ("time,a,b\n0,1,2\n\n0,1,2\n", "line 4, column time: 0 s follows 0 s; expected an increase of at least"),
    "quote": ('time,a,b\n0,1,"2\n', "line 2 is not CSV"),
}


@pytest.mark.parametrize(("text", "sentence"), BAD.values(), ids=BAD)
def test_errors_name_line_and_column(text: str, sentence: str) -> None:
    refused(fjr.TrajectoryError, lambda: parse_motion(text, JOINTS), sentence)


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    for path, words in ((tmp_path / "none.csv", "No such file"), (tmp_path, "cannot be read")):
        with pytest.raises(fjr.TrajectoryError, match=f"{path}.*{words}"):
            read_motion(path, JOINTS)
    binary = tmp_path / "binary.csv"
    binary.write_bytes(b"time\xff\xfe")
    with pytest.raises(fjr.TrajectoryError, match="is not UTF-8 text"):
        read_motion(binary, JOINTS)


def test_parquet_has_the_columns_of_csv_and_its_errors_name_file_row_and_column(tmp_path: Path) -> None:
    file = tmp_path / "motion.parquet"
    pq.write_table(pa.table({"b": [1.0, 3.0], "note": ["x", "y"], "time": [0.5, 0.75], "a": [2, 4]}), file)
    table = read_motion(file, JOINTS)
    np.testing.assert_array_equal(table.times, [0.0, 0.25])
    np.testing.assert_array_equal(table.positions, [[2.0, 1.0], [4.0, 3.0]])
    bad = {
        "without time": {"a": [0.0, 1.0], "b": [0.0, 1.0]},
        "row 1, column b: nan; expected a finite number": {"time": [0, 1], "a": [0, 1], "b": [0.0, None]},
        "row 1, column time: 0 s follows 0 s": {"time": [0, 0], "a": [0, 1], "b": [0, 1]},
        "is not a Parquet file of numbers": {"time": ["x", "y"], "a": [0, 1], "b": [0, 1]},
    }
    for sentence, columns in bad.items():
        pq.write_table(pa.table(columns), file)
        refused(fjr.TrajectoryError, lambda: read_motion(file, JOINTS), sentence, "motion.parquet")
    file.write_bytes(b"PAR1")
    with pytest.raises(fjr.TrajectoryError, match="is not a Parquet file"):
        read_motion(file, JOINTS)


cells = st.sampled_from(
    ["0", "1", "-1e3", "1e400", "nan", "", " 2 ", '"', '"a"', "a", "b", "time", "#", "\0", "ä", "1_0"]
)
tables = st.lists(st.lists(cells, max_size=5).map(",".join), max_size=6).map("\n".join)


@given(st.one_of(tables, st.text(max_size=80)))
@fuzzed(60)
def test_any_text_is_read_or_refused_in_a_sentence(text: str) -> None:
    answer(lambda: parse_motion(text, JOINTS))
    answer(lambda: parse_motion(f"time,a,b\n{text}", JOINTS))
