# SPDX-License-Identifier: Apache-2.0
"""Render pages from the Jinja2 templates.

A page is one self-contained file: uPlot draws its plots in the browser, and three.js the arm.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from fjr_core.errors import FjrError
from fjr_core.files.text_file import write_text
from fjr_monitor.plotting.figure import Plot, Pool, colour
from fjr_monitor.report.arm_replay import ArmReplay
from fjr_msgs_py.console.output import number, percent
from fjr_msgs_py.console.provenance import provenance

TEMPLATES = "report/templates"
SCRIPT, STYLE, THREE = "uPlot.iife.js", "uPlot.min.css", "three.min.js"
ASSETS = {  # file -> distribution, whose package is not imported, and folder
    SCRIPT: ("uplot-python", "uplot/static"),
    STYLE: ("uplot-python", "uplot/static"),
    THREE: ("jupyter-threejs-sage", "jupyter_threejs_sage/static/r130"),
}
HEADINGS = {
    "holding": "The certificate holds",
    "degraded": "Degraded",
    "violated": "Violated",
    "unknown": "No verdict",
    "late": "No verdict: the machine was late",
}


class AssetError(FjrError):
    """uPlot or three.js is not installed."""


@cache
def asset(name: str) -> str:
    """Return the text of a file of ASSETS; raises AssetError."""
    package, folder = ASSETS[name]
    try:
        return Path(str(distribution(package).locate_file(f"{folder}/{name}"))).read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError):
        raise AssetError(
            f"{name} of the Python package {package}, which draws in a page, is not installed; "
            f"expected it from: pip install --no-deps {package}"
        ) from None


@cache
def environment() -> Environment:
    """Return the Jinja2 environment of the pages: every value is escaped, an undefined name is an error."""
    made = Environment(
        loader=PackageLoader("fjr_monitor", TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {"number": number, "percent": percent}
    made.globals |= {"HEADINGS": HEADINGS, "SCRIPT": SCRIPT, "STYLE": STYLE, "THREE": THREE}
    static = files("fjr_monitor") / TEMPLATES  # files that go into a page as they are, like those of uPlot
    made.globals["static"] = lambda name: Markup((static / name).read_text(encoding="utf-8"))
    made.globals |= {"colour": colour, "provenance": provenance, "asset": lambda name: Markup(asset(name))}
    made.policies["json.dumps_kwargs"] = {}
    return made


def write_page(
    path: Path, template: str, title: str, plots: Sequence[Plot], arm: ArmReplay | None = None, **values: Any
) -> None:
    """Render a template with its values, the plots and the arm, if any; raises AssetError if a library is missing."""
    pool = Pool()
    packed = [plot.packed(pool) for plot in plots]
    moved = arm.packed(pool) if arm else None
    page = environment().get_template(template)
    data = {"arrays": pool.arrays, "plots": packed, "arm": moved}
    write_text(path, page.render(values, title=title, plots=data, arm=arm))


def as_json(value: object) -> str:
    """Return a value as indented JSON for the folded block at the end of a page."""
    return json.dumps(value, indent=2, ensure_ascii=False)
