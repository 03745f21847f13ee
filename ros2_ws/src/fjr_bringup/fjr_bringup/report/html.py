# SPDX-License-Identifier: Apache-2.0
"""Render pages from the Jinja2 templates. A page is one self-contained file: uPlot draws its plots in the browser."""

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

from fjr_bringup.atomic_file import write_text
from fjr_bringup.formatting import number, percent
from fjr_bringup.report.figure import Plot, Pool, colour
from fjr_core.errors import FjrError

TEMPLATES = "report/templates"
DISTRIBUTION = "uplot-python"  # its script and style are read; its package is not imported
SCRIPT, STYLE = "uPlot.iife.js", "uPlot.min.css"
HEADINGS = {
    "holding": "The certificate holds",
    "degraded": "Degraded",
    "violated": "Violated",
    "unknown": "No verdict",
    "late": "No verdict: the machine was late",
}


class UPlotError(FjrError):
    """uPlot is not installed."""


@cache
def asset(name: str) -> str:
    """Return the text of SCRIPT or STYLE; raises UPlotError."""
    try:
        path = Path(str(distribution(DISTRIBUTION).locate_file(f"uplot/static/{name}")))
        return path.read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError):
        raise UPlotError(
            f"{name} of the Python package {DISTRIBUTION}, which draws the plots of a page, is not installed; "
            f"expected it from: pip install --no-deps {DISTRIBUTION}"
        ) from None


@cache
def environment() -> Environment:
    """Return the Jinja2 environment of the pages: every value is escaped, an undefined name is an error."""
    made = Environment(
        loader=PackageLoader("fjr_bringup", TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {"number": number, "percent": percent}
    made.globals |= {"HEADINGS": HEADINGS, "SCRIPT": SCRIPT, "STYLE": STYLE}
    static = files("fjr_bringup") / TEMPLATES  # files that go into a page as they are, like those of uPlot
    made.globals["static"] = lambda name: Markup((static / name).read_text(encoding="utf-8"))
    made.globals |= {"colour": colour, "asset": lambda name: Markup(asset(name))}
    made.policies["json.dumps_kwargs"] = {}
    return made


def write_page(path: Path, template: str, title: str, plots: Sequence[Plot], **values: Any) -> None:
    """Render a template with its values and the plots, if any; raises UPlotError if uPlot is needed but missing."""
    pool = Pool()
    packed = [plot.packed(pool) for plot in plots]
    page = environment().get_template(template)
    write_text(path, page.render(values, title=title, plots={"arrays": pool.arrays, "plots": packed}))


def as_json(value: object) -> str:
    """Return a value as indented JSON for the folded block at the end of a page."""
    return json.dumps(value, indent=2, ensure_ascii=False)
