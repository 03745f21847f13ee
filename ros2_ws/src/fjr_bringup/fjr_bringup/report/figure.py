# SPDX-License-Identifier: Apache-2.0
"""What a page draws: plots and their lines as numbers, thinned to what a screen can show, packed for the page."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.recording.reader import Array

DRAWN = 6000  # points of a line, from there on the smallest and the largest of neighbours stand for them
DRAWABLE = 1e12
COLOURS = 7  # --c1 .. --c7 of page.css


@dataclass(frozen=True)
class Line:
    """One line: values (k,) over the plot's x; NaN is a gap.

    colour: name of a colour of page.css (c1 .. c7, grey, bad). dash: pixels on and off. step: values are held.
    x: the line's own abscissa where it is not the plot's. hidden: its name is in the legend only.
    """

    label: str
    values: Array
    colour: str = "c1"
    width: float = 1.5
    dash: tuple[int, ...] = ()
    step: bool = False
    fill: bool = False


@dataclass(frozen=True)
class Plot:
    """A plot with its finding as the title. time: its abscissa is time, moved and enlarged with the others'.

    place: id of the element that it goes into. legend: whether names and values are shown below it.
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
    views: dict[str, Plot] = field(default_factory=dict)  # the same in other units, by the name of a button

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to draw."""
        return not any(np.isfinite(line.values).any() for line in self.lines)

    def packed(self, pool: Pool) -> dict[str, Any]:
        """For page.js; the numbers go into the pool."""
        rows = thinned([line.values for line in self.lines], DRAWN)
        return {
            "name": self.name,
            "title": self.title,
            "caption": self.caption,
            "xLabel": self.x_label,
            "yLabel": self.y_label,
            "xLog": self.x_log,
            "yLog": self.y_log,
            "time": self.time,
            "wide": self.wide,
            "place": self.place,
            "legend": self.legend,
            "yRange": self.y_range,
            "x": pool.add(self.x[rows], np.float64),
            "lines": [_packed(line, pool.add(drawable(line.values[rows], self.y_log))) for line in self.lines],
            "views": {name: view.packed(pool) for name, view in self.views.items()},
        }


def colour(number: int) -> str:
    """A joint's or a bag's colour."""
    return f"c{number % COLOURS + 1}"


def thinned(columns: Sequence[Array], limit: int) -> NDArray[np.intp]:
    """Rows to draw, in order: all, or of each bucket of neighbours where each column is smallest and largest."""
    k = len(columns[0]) if columns else 0
    if k <= limit:
        return np.arange(k)
    edges = np.linspace(0, k, max(2, limit // (2 * len(columns)))).astype(int)
    chosen = {0, k - 1}
    for begin, end in zip(edges[:-1], edges[1:], strict=True):
        for column in columns:
            part = column[begin:end]
            if np.isfinite(part).any():
                chosen |= {begin + int(np.nanargmin(part)), begin + int(np.nanargmax(part))}
    return np.array(sorted(chosen))


class Pool:
    """The arrays of a page in base64, each once; of equal numbers only the first and how many there are."""

    def __init__(self) -> None:
        self._places: dict[str, int] = {}

    @property
    def arrays(self) -> list[str]:
        """All of them: kind (d double, f single), count, little-endian numbers in base64."""
        return list(self._places)

    def add(self, values: Array, kind: type = np.float32) -> int:
        """The place of an array."""
        numbers = np.asarray(values).astype(np.dtype(kind).newbyteorder("<"))
        same = len(numbers) > 1 and np.array_equal(numbers, np.full_like(numbers, numbers[0]), equal_nan=True)
        text = base64.b64encode((numbers[:1] if same else numbers).tobytes()).decode()
        return self._places.setdefault(f"{numbers.dtype.char}:{len(numbers)}:{text}", len(self._places))


def drawable(values: Array, log: bool = False) -> Array:
    """The values that an axis can show: none of a loop that diverged beyond all bounds, on a log axis none below 0."""
    good = (np.abs(values) < DRAWABLE) & ((values > 1e-37) | (not log))
    return np.where(good, values, np.nan)


def _packed(line: Line, place: int) -> dict[str, Any]:
    return {
        "label": line.label,
        "values": place,
        "colour": line.colour,
        "width": line.width,
        "dash": line.dash,
        "step": line.step,
        "fill": line.fill,
    }
