# SPDX-License-Identifier: Apache-2.0
"""Pages: plots as values, packed for page.js, and Jinja2 templates.

A page is one self-contained file: uPlot draws its plots in the browser, and three.js the arm.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.errors import PIP, FjrError
from fjr_core.files.text_file import write_text
from fjr_core.numerics.checks import Array
from fjr_msgs_py.console.output import milli, number, percent
from fjr_msgs_py.console.provenance import provenance, without_home

if TYPE_CHECKING:
    from jinja2 import Environment

DRAWN = 4000  # points of a line; longer lines are decimated to the minimum and maximum of each bucket
STORED = 40_000  # values of all lines of a plot, so that pages of many joints stay small
DRAWABLE = 1e12  # larger magnitudes are not drawn
COLOURS = 8  # --c1 .. --c8 of page.css
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
    "late": "No verdict: states or answers were late",
}


@dataclass(frozen=True)
class Line:
    """One line: values (k,) over the plot's x; NaN is a gap.

    colour: name of a colour of page.css (c1 .. c8, grey, bad). dash: pixels on and off. step: hold each value until
    the next x. fill: fill the area below the line. dots: one dot per value, no line. unseen: only in the legend.
    """

    label: str
    values: Array
    colour: str = "c1"
    width: float = 1.5
    dash: tuple[int, ...] = ()
    step: bool = False
    fill: bool = False
    dots: bool = False
    unseen: bool = False


@dataclass(frozen=True)
class Plot:
    """A plot, titled by its result.

    time: the abscissa is time; all such plots zoom together. place: id of the element that contains the plot.
    legend: show names and values below the plot. band: numbers of two lines to fill between, the upper one first.
    views: the plot in other units, by the label of a button.
    """

    name: str
    title: str
    caption: str
    x: Array
    lines: Sequence[Line]
    x_label: str = "t [s]"
    y_label: str = ""
    x_log: bool = False
    y_log: bool = False
    time: bool = True
    y_range: tuple[float | None, float | None] = (None, None)
    wide: bool = False
    place: str = "figures"
    legend: bool = True
    band: tuple[int, int] | None = None
    views: dict[str, Plot] = field(default_factory=dict)

    @property
    def is_empty(self) -> bool:
        """Return whether no line has a finite value."""
        return not any(np.isfinite(line.values).any() for line in self.lines)

    def packed(self, pool: Pool) -> dict[str, Any]:
        """Return the plot as a value for page.js; its arrays are added to the pool."""
        rows = decimated([line.values for line in self.lines], min(DRAWN, STORED // max(1, len(self.lines))))
        return {
            **vars(self),
            "x": pool.add(self.x[rows], np.float64),
            "lines": [
                {**vars(line), "values": pool.add(drawable(line.values[rows], self.y_log))} for line in self.lines
            ],
            "views": {name: view.packed(pool) for name, view in self.views.items()},
        }


@dataclass(frozen=True)
class ArmReplay:
    """What the page shows of the arm: a scene (scene.py) and positions [rad, m] at the times t (k,) [s].

    title: the result. link, motor, reference (k, n): q_l, q_m on the link side of the gears, q_ld; NaN: not known.
    magnification: of the deflections at first.
    """

    title: str
    scene: dict[str, Any]
    joints: Sequence[str]
    t: Array
    link: Array
    motor: Array
    reference: Array
    magnification: int

    def packed(self, pool: Pool) -> dict[str, Any]:
        """Return the replay as values for arm_replay.js; its arrays are added to the pool."""
        motion = {"link": self.link, "motor": self.motor, "reference": self.reference}
        known = {name: values for name, values in motion.items() if np.isfinite(values).any()}
        return {
            "scene": self.scene,
            "joints": list(self.joints),
            "t": pool.add(self.t, np.float64),
            "motion": {name: [pool.add(column) for column in values.T] for name, values in known.items()},
            "magnification": self.magnification,
        }


def colour(number: int) -> str:
    """Return the colour of joint or run `number`."""
    return f"c{number % COLOURS + 1}"


def decimated(columns: Sequence[Array], limit: int) -> NDArray[np.intp]:
    """Return the sorted indices to draw: all, or the minimum and maximum of each column in each bucket.

    columns: arrays (k,). limit: number of points above which they are decimated, to as many buckets as it permits.
    """
    k = len(columns[0]) if columns else 0
    if k <= limit:
        return np.arange(k)
    values, buckets = np.array(columns), max(1, limit // 2)
    rows = extremes(values, buckets)
    while len(rows) > limit and buckets > 1:
        buckets = 4 * buckets // 5
        rows = extremes(values, buckets)
    return rows


def extremes(values: Array, buckets: int) -> NDArray[np.intp]:
    """Return the first and the last index, and those of the least and the largest finite values in each bucket."""
    k, width = values.shape[1], -(-values.shape[1] // buckets)
    padded = np.full((len(values), buckets * width), np.nan)
    padded[:, :k] = values
    parts = padded.reshape(len(values), buckets, width)
    finite, begin = np.isfinite(parts), width * np.arange(buckets)
    parts[~finite] = -np.inf
    highest = parts.argmax(axis=2) + begin
    parts[~finite] = np.inf
    lowest = parts.argmin(axis=2) + begin
    known = finite.any(axis=2)
    return np.unique(np.concatenate([[0, k - 1], highest[known], lowest[known]]))


class Pool:
    """Arrays of a page in base64. Equal arrays are stored once; a constant array is stored as one value and a count."""

    def __init__(self) -> None:
        self._places: dict[str, int] = {}

    @property
    def arrays(self) -> list[str]:
        """Return the arrays as text: type (d double, f single), count, little-endian values in base64."""
        return list(self._places)

    def add(self, values: Array, kind: type = np.float32) -> int:
        """Store an array and return its index."""
        numbers = np.asarray(values).astype(np.dtype(kind).newbyteorder("<"))
        same = len(numbers) > 1 and np.array_equal(numbers, np.full_like(numbers, numbers[0]), equal_nan=True)
        text = base64.b64encode((numbers[:1] if same else numbers).tobytes()).decode()
        return self._places.setdefault(f"{numbers.dtype.char}:{len(numbers)}:{text}", len(self._places))


def drawable(values: Array, log: bool = False) -> Array:
    """Return the values with NaN for those that an axis cannot show: huge ones, and on a log axis those <= 1e-37."""
    return np.where((np.abs(values) < DRAWABLE) & ((values > 1e-37) | (not log)), values, np.nan)


class AssetError(FjrError):
    """uPlot or three.js is not installed."""


@cache
def asset(name: str) -> str:
    """Return the text of a file of ASSETS, which a wheel may hold beside the templates; raises AssetError."""
    package, folder = ASSETS[name]
    held = files("fjr_monitor") / TEMPLATES / name
    if held.is_file():
        return held.read_text(encoding="utf-8")
    try:
        return Path(str(distribution(package).locate_file(f"{folder}/{name}"))).read_text(encoding="utf-8")
    except (PackageNotFoundError, OSError):
        raise AssetError(
            f"{name} of the Python package {package}, which draws in a page, is not installed; "
            f"expected it from: {PIP} --no-deps {package}"
        ) from None


@cache
def environment() -> Environment:
    """Return the Jinja2 environment of the pages: every value is escaped, an undefined name is an error."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # a tenth of a second, only where pages are written
    from markupsafe import Markup

    made = Environment(
        loader=PackageLoader("fjr_monitor", TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    made.filters |= {"number": number, "percent": percent, "without_home": without_home}
    made.filters["sentence"] = lambda clause: f"{clause[:1].upper()}{clause[1:]}."
    made.filters["as_json"] = lambda value: json.dumps(value, indent=2, ensure_ascii=False)
    made.filters["milliseconds"] = lambda microseconds: milli(1e-6 * microseconds, "s")
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
    data: dict[str, Any] = {"plots": [plot.packed(pool) for plot in plots], "arm": arm.packed(pool) if arm else None}
    data["arrays"] = pool.arrays  # now that all are in it
    write_text(path, environment().get_template(template).render(values, title=title, plots=data, arm=arm))
