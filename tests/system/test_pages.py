# SPDX-License-Identifier: Apache-2.0
"""Pages of `fjr report` for bags of every scenario open from disk in a real browser: plots, and the arm in 3D."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from fjr_monitor.scene import scene
from system.browser import Browser
from system.executables import fjr_here
from system.shared_runs import DURATION, shared_run

pytestmark = pytest.mark.system
SCENARIOS = ("paper_k31", "paper_k3p1", "two_link", "arm7")
TOGETHER = ("paper_k31", "two_link")
FIGURES = [
    *("tracking", "error", "effort", "storage", "rate", "power"),
    *("external_torque", "period", "latency", "timeline"),
]
COMPARED = ["error", "effort", "storage", "latency", "period"]
LARGEST = 3e6  # bytes of a page
PIXELS = """(() => {  // all pixels of the picture, and opaque ones: those of the arm, not of ground and ghosts
  const canvas = document.querySelector(".stage canvas");
  const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
  copy.drawImage(canvas, 0, 0);
  const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
  const alpha = data.filter((_, i) => i % 4 === 3);
  return { all: alpha.length, opaque: alpha.filter((each) => each === 255).length };
})()"""
PICTURE = "document.querySelector('.stage canvas').toDataURL()"
TIME = "Number(document.getElementById('arm').dataset.time)"
SMALL = {"width": 640, "height": 480}  # the processor draws the arm


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the page of a shared run of each scenario, and one of TOGETHER that `fjr report` makes."""
    output = tmp_path_factory.mktemp("reports")
    runs = {name: shared_run(tmp_path_factory, name) for name in SCENARIOS}
    said = fjr_here("report", *(str(runs[name]) for name in TOGETHER), "--output", str(output))
    assert "side by side" in said
    for name in set(SCENARIOS) - set(TOGETHER):
        (output / name).symlink_to(runs[name])
    return output


def is_quiet(browser: Browser) -> None:
    assert browser.said == []
    assert [url for url in browser.asked if not url.startswith(("file:", "data:"))] == []


@pytest.mark.parametrize(
    ("name", "dark"),
    [
        ("paper_k31", False),
        ("two_link", True),
        *(pytest.param(*each, marks=pytest.mark.full) for each in (("paper_k3p1", True), ("arm7", False))),
    ],
)
def test_the_small_page_of_every_scenario_draws_all_its_plots_and_the_arm(
    pages: Path, browser: Browser, name: str, dark: bool
) -> None:
    page = pages / name / "report.html"
    assert page.stat().st_size < LARGEST
    browser.open(page, **SMALL, dark=dark)
    browser.is_sound()
    count = browser.value(PIXELS)
    assert 0.01 < count["opaque"] / count["all"] < 0.5
    assert browser.figures() == FIGURES
    assert name in browser.value("document.querySelector('h1').textContent")
    ground = browser.value("getComputedStyle(document.body).backgroundColor.match(/\\d+/g).map(Number)")
    assert (max(ground) < 80) == dark


def test_page_agrees_with_the_report(pages: Path, browser: Browser) -> None:
    report = json.loads((pages / "two_link" / "report.json").read_text())
    browser.open(pages / "two_link" / "report.html", **SMALL)
    text = browser.value("document.body.innerText")
    rows = browser.value("[...document.querySelectorAll('table.figures tbody th')].map((cell) => cell.textContent)")
    assert rows == [joint["joint"] for joint in report["joints"]]
    assert report["verdict"]["sentence"] in text
    assert f"{report['tracking']['peak_effort_nm']:.4g} N m" in text
    assert json.loads(browser.value("document.querySelector('pre').textContent")) == report


def test_comparison_draws_all_runs_and_links_to_their_pages(pages: Path, browser: Browser) -> None:
    browser.open(pages / "comparison.html")
    browser.is_sound()
    assert browser.figures() == COMPARED
    links = browser.value("[...document.querySelectorAll('thead a')].map((link) => [link.textContent, link.href])")
    assert [(text, href) for text, href in links] == [
        (name, (pages / name / "report.html").absolute().as_uri()) for name in TOGETHER
    ]


def test_pointer_shows_values_and_zooms_all_time_plots(pages: Path, browser: Browser) -> None:
    browser.open(pages / "paper_k31" / "report.html")
    x, y, width = plot_of_error(browser)
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
        zip(browser.figures(), [old != new for old, new in zip(before, pictures(browser), strict=True)], strict=True)
    )
    assert moved == {name: name not in ("period", "latency") for name in FIGURES}
    assert browser.said == []


def test_button_switches_the_units(pages: Path, browser: Browser) -> None:
    browser.open(pages / "arm7" / "report.html", **SMALL)
    button, before = "document.querySelector('#effort .views button')", pictures(browser)
    for units in ("N m", "% of limit"):
        assert browser.value(f"{button}.textContent") == units
        browser.value(f"{button}.click()")
        browser.settle()
        browser.is_sound()
        assert (pictures(browser) == before) == (units == "% of limit")


@pytest.mark.parametrize("page", ["arm7/report.html", "comparison.html"])
def test_narrow_window_needs_no_horizontal_scrolling(pages: Path, browser: Browser, page: str) -> None:
    browser.open(pages / page, width=390, height=800)
    inside = "(each) => each.getBoundingClientRect().right <= document.getElementById('arm').clientWidth"
    assert browser.value(f"[...document.querySelectorAll('#arm .controls *')].every({inside})")
    browser.is_sound()


def plot_of_error(browser: Browser) -> tuple[float, float, float]:
    """Scroll to the plot of the tracking error; return its left and top edge and its width [px]."""
    browser.value("document.querySelector('#error').scrollIntoView()")
    over = "document.querySelector('#error .u-over').getBoundingClientRect()"
    left, top, width = (browser.value(f"{over}.{what}") for what in ("left", "top", "width"))
    return left, top, width


def pictures(browser: Browser) -> list[str]:
    return list(browser.value("[...document.querySelectorAll('.uplot canvas')].map((canvas) => canvas.toDataURL())"))


def change(browser: Browser, part: str, value: object, attribute: str = "value") -> str:
    """Set an input of the arm as a user does; return the picture after it."""
    element = f"document.querySelector('#arm .{part}')"
    browser.value(f"{element}.{attribute} = {json.dumps(value)}; {element}.dispatchEvent(new Event('input'))")
    return picture(browser)


def picture(browser: Browser) -> str:
    browser.settle()
    return str(browser.value(PICTURE))


# Turned origins and axes, and every kind of joint; the last follows the first.
ALL_KINDS = """<robot name="all">
  <link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/><link name="f"/>
  <joint name="turn" type="continuous"><parent link="a"/><child link="b"/><axis xyz="1 2 -1"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.4 -0.5 2.6"/></joint>
  <joint name="slide" type="prismatic"><parent link="b"/><child link="c"/><axis xyz="0 3 1"/>
    <origin xyz="0 0.2 0.3" rpy="-1.2 0.3 0.2"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="stiff" type="fixed"><parent link="c"/><child link="d"/><origin xyz="0.3 0 0" rpy="0.7 0.8 0.9"/></joint>
  <joint name="locked" type="revolute"><parent link="d"/><child link="e"/><axis xyz="0 0 1"/>
    <origin xyz="0.1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="follower" type="revolute"><parent link="e"/><child link="f"/><axis xyz="1 0 0"/>
    <origin xyz="0 0 0.2"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
    <mimic joint="turn" multiplier="-2" offset="0.1"/></joint>
</robot>"""
REVOLUTE = ('type="continuous">', 'type="revolute"><limit lower="-1" upper="1" effort="1" velocity="1"/>')


def test_the_links_are_posed_as_by_forward_kinematics(pages: Path, browser: Browser) -> None:
    browser.open(pages / "paper_k31" / "report.html", **SMALL)  # any has the code
    found = browser.value(f"""(() => {{
      const chain = new Arm.Chain({json.dumps(scene(ALL_KINDS, {"locked": 0.5}))}, [], () => new THREE.Material());
      chain.pose({json.dumps({"turn": 0.6, "slide": -0.4})});
      chain.group.updateMatrixWorld(true);
      return Object.fromEntries(chain.joints.map(({{ name }}) => [name, chain.frames[name].matrixWorld.elements]));
    }})()""")
    model = pinocchio.buildModelFromXML(ALL_KINDS.replace(*REVOLUTE))
    at = model.createData()
    pinocchio.forwardKinematics(model, at, np.array([0.6, -0.4, 0.5, -1.1]))  # of all, in the order of the chain
    for joint in model.names[1:]:
        expected = at.oMi[model.getJointId(joint)].homogeneous
        np.testing.assert_allclose(np.reshape(found[joint], (4, 4)).T, expected, atol=1e-12, err_msg=joint)


def test_slider_pointer_and_play_move_the_arm(pages: Path, browser: Browser) -> None:
    browser.open(pages / "two_link" / "report.html", **SMALL)
    first = picture(browser)
    assert change(browser, "time", 1.5) != first
    assert float(browser.value("document.querySelector('#storage .u-legend .u-value').textContent")) == 1.5
    assert change(browser, "time", 0) == first
    x, y, width = plot_of_error(browser)
    browser.mouse("mouseMoved", x + 0.5 * width, y + 50)
    assert picture(browser) != first
    assert browser.value(TIME) == pytest.approx(0.5 * DURATION["two_link"], rel=0.02)
    change(browser, "speed", "2")
    stopped = "new Promise((done) => new MutationObserver(() => button.ariaLabel === 'play' && done()).observe("
    started = "const button = document.querySelector('#arm .play'); button.click();"
    browser.value(f"(() => {{ {started} return {stopped} button, {{ attributes: true }})); }})()")
    assert browser.value(TIME) == pytest.approx(DURATION["two_link"], abs=2e-3)
    is_quiet(browser)


def test_ghosts_show_reference_and_magnified_deflection(pages: Path, browser: Browser) -> None:
    browser.open(pages / "two_link" / "report.html", **SMALL)
    both = picture(browser)  # the run begins with an error
    without_reference = change(browser, "reference", False, "checked")
    assert without_reference != both
    change(browser, "time", 1.0)
    less, more = change(browser, "stretch", 0.1), change(browser, "stretch", 0.9)
    assert less != more
    assert change(browser, "motor", False, "checked") not in (less, more)
    assert change(browser, "stretch", 0.5) == change(browser, "stretch", 0.6)  # nothing to magnify is shown
    is_quiet(browser)


def test_without_webgl_a_sentence_replaces_the_arm(pages: Path, browser: Browser) -> None:
    script = """const get = HTMLCanvasElement.prototype.getContext;
      HTMLCanvasElement.prototype.getContext = function (kind, ...rest) {
        return kind.startsWith("webgl") ? null : get.call(this, kind, ...rest);
      };"""
    added = browser.call("Page.addScriptToEvaluateOnNewDocument", source=script)
    try:
        browser.open(pages / "two_link" / "report.html")
    finally:
        browser.call("Page.removeScriptToEvaluateOnNewDocument", **added)
    assert "no WebGL" in browser.value("document.querySelector('.stage').textContent")
    assert browser.value("document.querySelectorAll('#arm .controls').length") == 0
    assert min(browser.coloured()) > 0
    is_quiet(browser)
