# SPDX-License-Identifier: Apache-2.0
"""Plots show all data: decimated lines keep minima and maxima, histograms count every value."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from fjr_monitor.analysis.timing import Distribution
from fjr_monitor.plotting.figure import STORED, Line, Plot, Pool, decimated, drawable
from fjr_monitor.report.run_figures import HALF, bins
from fjr_msgs_py.console.output import milliseconds, number, percent

VALUES = st.floats(-1e6, 1e6, width=32)


@given(st.lists(arrays(float, 500, elements=VALUES), min_size=1, max_size=4), st.integers(20, 600))
def test_decimated_lines_keep_minima_maxima_and_ends(columns: list[np.ndarray], limit: int) -> None:
    rows = decimated(columns, limit)
    assert (np.diff(rows) > 0).all()
    assert rows[0] == 0
    assert rows[-1] == 499
    for column in columns:
        assert column[rows].max() == column.max()
        assert column[rows].min() == column.min()


def test_a_plot_of_many_lines_stores_no_more_values_and_keeps_the_peaks() -> None:
    values = np.random.default_rng(1).normal(size=(24, 20_000))
    values[5, 7_777] = 9.0
    plot = Plot("many", "", "", np.arange(20_000.0), [Line("", row) for row in values])
    pool = Pool()
    packed = plot.packed(pool)
    columns = [unpacked(pool.arrays[line["values"]]) for line in packed["lines"]]
    assert 0.5 * STORED < sum(map(len, columns)) <= STORED
    assert columns[5].max() == 9.0


def test_short_lines_are_not_decimated() -> None:
    np.testing.assert_array_equal(decimated([np.arange(50.0)], 50), np.arange(50))


def unpacked(text: str) -> np.ndarray:
    kind, count, numbers = text.split(":")
    found = np.frombuffer(base64.b64decode(numbers), dtype=f"<{kind}")
    return np.full(int(count), found[0]) if len(found) < int(count) else found


@given(arrays(float, st.integers(1, 30), elements=VALUES))
def test_packed_arrays_round_trip(values: np.ndarray) -> None:
    pool = Pool()
    assert pool.add(values, np.float64) == pool.add(values.copy(), np.float64) == 0
    assert pool.add(values) == 1
    np.testing.assert_array_equal(unpacked(pool.arrays[0]), values)
    np.testing.assert_array_equal(unpacked(pool.arrays[1]), values.astype(np.float32))


def test_values_outside_any_axis_are_gaps() -> None:
    values = np.array([1.0, 0.0, -2.0, np.inf, np.nan, 1e300])
    np.testing.assert_array_equal(drawable(values), [1.0, 0.0, -2.0, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(drawable(values, log=True), [1.0] + 5 * [np.nan])


@given(st.lists(st.integers(0, 10**11), max_size=200))
def test_histograms_count_every_value(times: list[int]) -> None:
    found = Distribution()
    found.add(np.array(times, dtype=np.int64))
    edges, heights = bins(found)
    assert (np.diff(edges) > 0).all()
    assert heights[heights > HALF].sum() == len(times)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "–"),
        (np.nan, "–"),
        (0.0, "0"),
        (26.2034, "26.2"),
        (255.76, "256"),
        (1234.5, "1234"),
        (0.0123, "0.0123"),
        (1.234e-5, "1.23·10⁻⁵"),
        (-2e7, "-2.00·10⁷"),
    ],
)
def test_numbers_are_formatted_readably(value: float | None, text: str) -> None:
    assert number(value) == text


def test_units_follow_numbers() -> None:
    assert number(0.5, "s") == "0.5 s"
    assert percent(0.99861) == "99.86 %"
    assert milliseconds(310.0) == "0.31 ms"
