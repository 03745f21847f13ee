# SPDX-License-Identifier: Apache-2.0
"""The page of `fjr sweep` in a real browser: plots of all runs, values under the pointer, any width, light and dark."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from system.browser import Browser
from system.executables import fjr_here

pytestmark = pytest.mark.system
SWEEP = """
scenario: paper_k31
runs: 160
duration: 0.5
vary:
  delay: {uniform: [0.0, 0.01]}
  link_damping: {log_uniform: [0.5, 2.0]}
success: {rms: 0.05}
settle_after: 0.2
"""
FIGURES = ["share-0", "runs-0", "share-1", "runs-1", "distribution"]
DRAWN = 100  # coloured pixels
LARGEST = 3e6  # bytes


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    (folder / "joint.yaml").write_text(SWEEP)
    fjr_here("sweep", str(folder / "joint.yaml"), "--output", str(folder))
    return folder / "joint"


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [400, 1280])
def test_page_draws_all_plots_at_any_width(study: Path, browser: Browser, width: int, dark: bool) -> None:
    page = study / "report.html"
    browser.open(page, width=width, dark=dark)
    assert browser.said == []
    assert [url for url in browser.asked if not url.startswith(("file:", "data:"))] == []
    assert browser.value("[...document.querySelectorAll('figure')].map((figure) => figure.id)") == FIGURES
    assert len(browser.coloured()) == len(FIGURES)
    assert min(browser.coloured()) > DRAWN
    assert browser.overflows() == []
    assert browser.value("document.documentElement.scrollWidth") <= width
    assert page.stat().st_size < LARGEST


def pointed(browser: Browser, height: float) -> dict[str, str]:
    """Return the values by name that a plot shows under the pointer at a relative height."""
    over = "document.querySelector('#runs-0 .u-over').getBoundingClientRect()"
    x, y, width, full = (browser.value(f"{over}.{what}") for what in ("left", "top", "width", "height"))
    browser.mouse("mouseMoved", x + 0.3 * width, y + (1.0 - height) * full)
    browser.settle()
    cells = "[...document.querySelectorAll('#runs-0 .u-legend {}')].map((cell) => cell.textContent)"
    return dict(zip(*(browser.value(cells.format(part)) for part in (".u-label", ".u-value")), strict=True))


def test_pointer_shows_the_run_of_the_dot_next_to_it(study: Path, browser: Browser) -> None:
    table = pq.read_table(study / "table.parquet").to_pydict()
    browser.open(study / "report.html")
    browser.value("document.getElementById('runs-0').scrollIntoView()")
    errors = []
    for height in (0.05, 0.7):
        seen = pointed(browser, height)
        run = int(seen["run"])
        errors.append(table["rms.joint1"][run])
        assert float(seen["delay [s]"]) == pytest.approx(table["delay"][run], rel=1e-3)
        assert float(seen["succeeds"]) == pytest.approx(errors[-1], rel=1e-3)
        assert table["success"][run]
    assert errors[0] < errors[1]


def test_bars_have_the_width_of_the_influence(study: Path, browser: Browser) -> None:
    effects = json.loads((study / "summary.json").read_text())["effects"]
    browser.open(study / "report.html")
    shares = "[...document.querySelectorAll('.bar i')].map((bar) => bar.offsetWidth / bar.parentNode.offsetWidth)"
    expected = [share for effect in effects for share in (effect["success"], effect["error"])]
    assert browser.value(shares) == pytest.approx(expected, abs=0.02)
