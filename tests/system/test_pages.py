# SPDX-License-Identifier: Apache-2.0
"""Pages of `fjr report` for bags of every scenario open from disk in a real browser and draw all plots."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from system.browser import Browser
from system.executables import fjr_here
from system.shared_runs import DURATION, shared_run

pytestmark = pytest.mark.system
SCENARIOS = ("paper_k31", "paper_k3p1", "two_link", "arm7")
FIGURES = ["tracking", "error", "effort", "storage", "rate", "power", "period", "latency", "timeline"]
COMPARED = ["error", "effort", "storage", "latency", "period"]
DRAWN = 150  # coloured pixels; a line across a plot has more


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a page of each scenario and one of all, made by `fjr report` from bags of shared runs."""
    output = tmp_path_factory.mktemp("reports")
    said = fjr_here("report", *(str(shared_run(tmp_path_factory, name)) for name in SCENARIOS), "--output", str(output))
    assert "side by side" in said
    return output


def names(browser: Browser) -> list[str]:
    return list(browser.value("[...document.querySelectorAll('figure')].map((figure) => figure.id)"))


def is_sound(browser: Browser) -> None:
    """Check that the page has no errors, fetches nothing and draws every plot."""
    assert browser.said == []
    assert [url for url in browser.asked if not url.startswith(("file:", "data:"))] == []
    assert len(browser.coloured()) == len(names(browser))
    assert browser.overflows() == []
    assert min(browser.coloured()) > DRAWN, dict(zip(names(browser), browser.coloured(), strict=True))


@pytest.mark.parametrize(("name", "dark"), [*zip(SCENARIOS, (False, True, True, False), strict=True)])
def test_the_page_of_every_scenario_draws_all_its_plots(pages: Path, browser: Browser, name: str, dark: bool) -> None:
    browser.open(pages / name / "report.html", dark=dark)
    is_sound(browser)
    assert names(browser) == FIGURES
    assert name in browser.value("document.querySelector('h1').textContent")
    ground = browser.value("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert (max(ground) < 80) == dark


def test_page_agrees_with_the_report(pages: Path, browser: Browser) -> None:
    report = json.loads((pages / "arm7" / "report.json").read_text())
    browser.open(pages / "arm7" / "report.html")
    text = browser.value("document.body.innerText")
    rows = browser.value("[...document.querySelectorAll('table.figures tbody th')].map((cell) => cell.textContent)")
    assert rows == [joint["joint"] for joint in report["joints"]]
    assert report["verdict"]["sentence"] in text
    assert f"{report['tracking']['peak_effort_nm']:.4g} N m" in text
    assert json.loads(browser.value("document.querySelector('pre').textContent")) == report


def test_comparison_draws_all_runs_and_links_to_their_pages(pages: Path, browser: Browser) -> None:
    browser.open(pages / "comparison.html")
    is_sound(browser)
    assert names(browser) == COMPARED
    links = browser.value("[...document.querySelectorAll('thead a')].map((link) => [link.textContent, link.href])")
    assert [(text, href) for text, href in links] == [
        (name, (pages / name / "report.html").absolute().as_uri()) for name in SCENARIOS
    ]


def test_pointer_shows_values_and_zooms_all_time_plots(pages: Path, browser: Browser) -> None:
    browser.open(pages / "paper_k31" / "report.html")
    browser.value("document.querySelector('#error').scrollIntoView()")
    over = "document.querySelector('#error .u-over').getBoundingClientRect()"
    x, y, width = (browser.value(f"{over}.{what}") for what in ("left", "top", "width"))
    before = pictures(browser)
    browser.mouse("mouseMoved", x + 0.5 * width, y + 50)
    browser.settle()
    time = browser.value("document.querySelector('#storage .u-legend .u-value').textContent")
    assert 0.4 < float(time) / DURATION["paper_k31"] < 0.6  # the plot next to it follows
    browser.mouse("mouseMoved", x + 0.2 * width, y + 50)
    browser.mouse("mousePressed", x + 0.2 * width, y + 50, held=True)
    for part in (0.3, 0.4):
        browser.mouse("mouseMoved", x + part * width, y + 50, held=True)
    browser.mouse("mouseReleased", x + 0.4 * width, y + 50)
    browser.settle()
    moved = dict(
        zip(names(browser), [old != new for old, new in zip(before, pictures(browser), strict=True)], strict=True)
    )
    assert moved == {name: name not in ("period", "latency") for name in FIGURES}
    assert browser.said == []


def test_button_switches_the_units(pages: Path, browser: Browser) -> None:
    browser.open(pages / "arm7" / "report.html")
    label = "document.querySelector('#effort .views button').textContent"
    button = "document.querySelector('#effort .views button').click()"
    assert browser.value(label) == "N m"
    before = pictures(browser)
    browser.value(button)
    browser.settle()
    assert browser.value(label) == "% of limit"
    assert pictures(browser)[FIGURES.index("effort")] != before[FIGURES.index("effort")]
    is_sound(browser)
    browser.value(button)
    browser.settle()
    assert pictures(browser) == before


@pytest.mark.parametrize("page", ["arm7/report.html", "comparison.html"])
def test_narrow_window_needs_no_horizontal_scrolling(pages: Path, browser: Browser, page: str) -> None:
    browser.open(pages / page)
    browser.size(390, 800)
    browser.settle()
    assert browser.value("document.documentElement.scrollWidth") <= 390
    is_sound(browser)


def pictures(browser: Browser) -> list[str]:
    return list(browser.value("[...document.querySelectorAll('.uplot canvas')].map((canvas) => canvas.toDataURL())"))
