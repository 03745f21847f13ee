# SPDX-License-Identifier: Apache-2.0
"""Read uPlot's script and style from the installed distribution uplot-python without importing its package."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

from fjr_core.errors import FjrError

DISTRIBUTION = "uplot-python"
SCRIPT, STYLE = "uPlot.iife.js", "uPlot.min.css"


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
