# SPDX-License-Identifier: Apache-2.0
"""Plots show all data, templates escape every value, pages are self-contained, verdicts have a heading and a colour."""

from __future__ import annotations

import base64
import re
from collections import defaultdict
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from jinja2 import UndefinedError

from fjr_monitor.diagnosis.verdict import Diagnosis
from fjr_monitor.report import comparison_page, html
from fjr_monitor.report.html import STORED, Line, Plot, Pool, decimated, drawable
from fjr_monitor.report.picture import SHADES, draw_plot, write_picture
from fjr_monitor.report.run_page import HALF, bins
from fjr_msgs_py.console.output import Result, aligned, milli, number, percent, tell
from fjr_msgs_py.console.provenance import without_home
from fjr_msgs_py.node.reports import VERDICT_LEVELS

VALUES = st.floats(-1e6, 1e6, width=32)


@given(st.lists(arrays(float, 500, elements=VALUES), min_size=1, max_size=4), st.integers(20, 600))
def test_decimated_lines_keep_minima_maxima_and_ends(columns: list[np.ndarray], limit: int) -> None:
    rows = decimated(columns, limit)
    assert (np.diff(rows) > 0).all()
    assert rows[0] == 0
    assert rows[-1] == 499
    np.testing.assert_array_equal(decimated(columns, 500), np.arange(500))
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
    edges, heights = bins(np.array(times, dtype=np.int64))
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
        (999.7, "1000"),
        (-999999.9, "-1000000"),
        (0.0123, "0.0123"),
        (1.234e-5, "1.23·10⁻⁵"),
        (-2e7, "-2.00·10⁷"),
    ],
)
def test_numbers_are_formatted_readably(value: float | None, text: str) -> None:
    assert number(value) == text
    assert (number(0.5, "s"), percent(0.99861), milli(3.1e-4, "s")) == ("0.5 s", "99.86 %", "0.31 ms")
    assert number(99.6, "%", 2) == "100 %"


def test_only_none_and_all_read_0_and_100_percent() -> None:
    one_late = 1 - 1 / 50_000
    assert [percent(share) for share in (0.0, 1 / 50_000, one_late, 1.0)] == [
        "0.00 %",
        "< 0.01 %",
        "> 99.99 %",
        "100.00 %",
    ]
    assert [percent(share, 0) for share in (1e-9, 0.994, 0.996, 1.004)] == ["< 1 %", "99 %", "> 99 %", "100 %"]


def test_text_from_a_bag_does_not_steer_the_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    Result("column\tµ\nthe states name \x1b[2J", {"name": "\x1b[2J"}).show(as_json=False)
    tell("\x9b2J\r–")
    assert capsys.readouterr() == ("column\tµ\nthe states name ?[2J\n", "fjr: ?2J?–\n")


def test_eight_joints_have_eight_colours_on_pages_and_pictures() -> None:
    names, style = [html.colour(j) for j in range(8)], (files("fjr_monitor") / html.TEMPLATES / "page.css").read_text()
    for scheme in style.split("@media")[:2]:  # light and dark
        assert len({re.search(rf"--{name}: (#\w+);", scheme)[1] for name in names}) == 8
    assert len({SHADES[name] for name in names}) == 8


def test_names_with_dollars_are_no_formulas_in_a_picture(tmp_path: Path) -> None:
    name, x = r"joint $\fra{$ $_1", np.linspace(0.0, 1.0, 5)
    plot = Plot("p", name, name, x, [Line(name, x, dash=(6, 4)), Line(name, x + 1, dots=True)], y_label=name)
    assert write_picture(tmp_path / "p.png", (6.0, 4.0), lambda figure: draw_plot(figure.subplots(), plot, 60))


def test_a_page_shows_no_home_folder_but_other_folders_that_begin_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/al")
    assert without_home("fjr report /home/al/runs '--output=/home/al' /home/alice/x /home/al") == (
        "fjr report ~/runs '--output=~' /home/alice/x ~"
    )


@pytest.mark.parametrize("width", [40, 80, None])
def test_a_table_fits_the_terminal_and_loses_no_cell(width: int | None, monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [
        ("", "effort", "error"),
        ("first", "12 N m of a limit", "a cell of many words, " * 8),
        ("second", "", "0.1 mrad"),
    ]
    if width:
        monkeypatch.setenv("COLUMNS", str(width))
    lines = aligned(rows)
    assert set(" ".join(lines).split()) == {word for row in rows for cell in row for word in cell.split()}
    assert max(map(len, lines)) <= (width or 1000)
    assert len(lines) == 3 or width


HOSTILE = "</script><b onload='x' title=\"y\">&amp;"
OF_A_PAGE: dict[str, Any] = {
    "kicker": HOSTILE,
    "notes": [HOSTILE],
    "tiles": [(HOSTILE, HOSTILE)],
    "groups": [(HOSTILE, [defaultdict(lambda: HOSTILE)])],
    "reasons": [(HOSTILE, HOSTILE)],
    "hold_outs": [(HOSTILE, [[HOSTILE, HOSTILE]])],
    "hold_out_head": ["", HOSTILE],
    "sections": [(HOSTILE, HOSTILE, True)],
    "json": {HOSTILE: HOSTILE},
}


def page(path: Path, **values: Any) -> str:
    plot = Plot(HOSTILE, HOSTILE, HOSTILE, np.arange(2.0), [Line(HOSTILE, np.ones(2))])
    html.write_page(path, "identification.html", HOSTILE, [plot], **values)
    return path.read_text(encoding="utf-8")


def test_every_value_of_a_page_is_escaped_and_its_libraries_are_in_it(tmp_path: Path) -> None:
    text = page(tmp_path / "page.html", **OF_A_PAGE)
    assert "<b onload" not in text
    assert text.count("&lt;/script&gt;&lt;b onload=") >= len(OF_A_PAGE)
    assert text.count("</script>") == 3
    assert html.asset(html.SCRIPT) in text
    assert html.asset(html.STYLE) in text
    assert not re.search(r"<(?:script|link|img)[^>]*(?:src|href)=[\"'](?!data:)", text)


def test_a_value_that_a_template_lacks_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UndefinedError):
        page(tmp_path / "page.html")


@pytest.mark.parametrize("name", [html.SCRIPT, html.STYLE])
def test_without_a_library_no_page_is_written_and_one_sentence_says_why(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(html.ASSETS, name, ("no-such-distribution", ""))
    html.asset.cache_clear()
    try:
        with pytest.raises(html.AssetError, match=f"^{name} .* is not installed; expected it from: .* -m pip .*$"):
            page(tmp_path / "page.html", **OF_A_PAGE)
    finally:
        html.asset.cache_clear()
    assert list(tmp_path.iterdir()) == []


def test_the_page_shows_the_number_of_a_degraded_run_in_amber() -> None:
    degraded = Diagnosis("degraded", ("delay",), "the effort acted late", {}, detail="delay makes 0.14 mrad at joint2")
    line = html.environment().get_template("macros.html").module.verdict_line(degraded)
    assert 'class="verdict degraded"' in line
    assert "Degraded: delay makes 0.14 mrad at joint2" in line
    css = (files("fjr_monitor") / "report" / "templates" / "page.css").read_text(encoding="utf-8")
    rule = re.search(r"\.degraded[^{]*\{([^}]*)\}", css)
    assert rule is not None
    assert "--doubt" in rule[1]
    assert comparison_page.COLOURED["degraded"] == "maybe"


def test_every_verdict_has_a_level_a_heading_and_a_colour() -> None:
    kinds = {"holding", "degraded", "violated", "unknown"}
    assert set(html.HEADINGS) == set(comparison_page.COLOURED) == {*kinds, "late"}
    assert set(VERDICT_LEVELS) == kinds
