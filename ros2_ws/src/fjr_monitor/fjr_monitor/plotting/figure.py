# SPDX-License-Identifier: Apache-2.0
"""Plots of a page: lines as arrays, decimated to the resolution of a screen and packed for page.js."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_monitor.recording.reader import Array

DRAWN = 4000  # points of a line; longer lines are decimated to the minimum and maximum of each bucket
STORED = 40_000  # values of all lines of a plot, so that pages of many joints stay small
DRAWABLE = 1e12  # larger magnitudes are not drawn
COLOURS = 7  # --c1 .. --c7 of page.css


@dataclass(frozen=True)
class Line:
    """One line: values (k,) over the plot's x; NaN is a gap.

    colour: name of a colour of page.css (c1 .. c7, grey, bad). dash: pixels on and off. step: hold each value until
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
    highest, lowest = (np.where(finite, sign * parts, -np.inf).argmax(axis=2) + begin for sign in (1, -1))
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
    good = (np.abs(values) < DRAWABLE) & ((values > 1e-37) | (not log))
    return np.where(good, values, np.nan)
