# SPDX-License-Identifier: Apache-2.0
"""Templates of the pages: every value is escaped, pages are self-contained, a missing uPlot is one sentence."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from jinja2 import UndefinedError

from fjr_monitor.plotting.figure import Line, Plot
from fjr_monitor.report import html

HOSTILE = "</script><b onload='x' title=\"y\">&amp;"
VALUES: dict[str, Any] = {
    "kicker": HOSTILE,
    "notes": [HOSTILE],
    "tiles": [(HOSTILE, HOSTILE)],
    "tables": [(HOSTILE, ["", HOSTILE], [[HOSTILE, HOSTILE]])],
    "effects": [(HOSTILE, HOSTILE, HOSTILE, 0.5, 0.5)],
    "influence_text": HOSTILE,
    "json": html.as_json({HOSTILE: HOSTILE}),
    "footer": HOSTILE,
}


def page(path: Path, **values: Any) -> str:
    plot = Plot(HOSTILE, HOSTILE, HOSTILE, np.arange(2.0), [Line(HOSTILE, np.ones(2))])
    html.write_page(path, "monte_carlo.html", HOSTILE, [plot], **values)
    return path.read_text(encoding="utf-8")


def test_every_value_of_a_page_is_escaped(tmp_path: Path) -> None:
    text = page(tmp_path / "page.html", **VALUES)
    assert "<b onload" not in text
    assert text.count("&lt;/script&gt;&lt;b onload=") >= len(VALUES)
    assert text.count("</script>") == 3


def test_a_page_fetches_nothing_and_contains_the_plotting_library(tmp_path: Path) -> None:
    text = page(tmp_path / "page.html", **VALUES)
    assert html.asset(html.SCRIPT) in text
    assert html.asset(html.STYLE) in text
    assert not re.search(r"<(?:script|link|img)[^>]*(?:src|href)=[\"'](?!data:)", text)


def test_a_value_that_a_template_lacks_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(UndefinedError):
        page(tmp_path / "page.html")


@pytest.mark.parametrize("name", [html.SCRIPT, html.THREE])
def test_a_missing_library_is_one_sentence(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(html.ASSETS, name, ("no-such-distribution", ""))
    html.asset.cache_clear()
    try:
        with pytest.raises(
            html.AssetError, match=f"^{name} .* is not installed; expected it from: pip install"
        ) as error:
            html.asset(name)
    finally:
        html.asset.cache_clear()
    assert "\n" not in str(error.value)


def test_without_a_library_no_page_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(html.ASSETS, html.SCRIPT, ("no-such-distribution", ""))
    html.asset.cache_clear()
    try:
        with pytest.raises(html.AssetError):
            page(tmp_path / "page.html", **VALUES)
    finally:
        html.asset.cache_clear()
    assert list(tmp_path.iterdir()) == []
