# SPDX-License-Identifier: Apache-2.0
"""What the page of a run shows of it: every state of a short run, the extremes of a longer one, the moving arm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.robot import description, locked_positions
from fjr_core.numerics.checks import Array
from fjr_monitor.report.html import ArmReplay, extremes
from fjr_monitor.report.metrics import Metrics, Report
from fjr_monitor.scene import scene
from fjr_msgs_py.console.output import milli

PAGE, METRICS = "report.html", "report.json"
EVERY = 40_000  # states of a run of which all are kept
BUCKETS = 1_000  # parts of a longer run; of each the least and the largest value of every signal are kept
VISIBLE = 0.3  # rad or m, of the largest deflection as magnified at first
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
STATES = ("t", "q_l", "q_ld", "error", "u", "external_torque", "since", "latency")  # columns that are shown
STORED, RATES = ("V", "H"), ("measured", "predicted", "least")
FRAMES, MOST_FRAMES = 900, 9000  # of the motion of an arm, at least and at most; the page interpolates between them
FRAME = 0.04  # s between them, unless these numbers of frames make it shorter or longer


class Shown:
    """Signals of a run, decimated: no value of a column of its metrics is above or below those that are kept nearby.

    states: STATES, STORED, largest_error and largest_effort. steps: t, at which each step begins, rates of V, powers
    and energies. frames: the columns each FRAME. deflection (n,): largest |q_m - q_l|, NaN: unknown.
    rate_error: error of the predicted rate of V relative to the rate, NaN: unknown.
    """

    def __init__(self, metrics: Metrics) -> None:
        self.metrics, self.run = metrics, metrics.run
        columns, powers = self.run.columns, metrics.columns
        rows = kept_rows(len(columns), columns.each(STATES), powers.each((*STORED, *RATES, "watts")))
        self.states = columns.at(rows, STATES) | powers.at(rows, STORED)
        self.states["largest_error"] = np.abs(self.states["error"]).max(axis=1)
        self.states["largest_effort"] = np.fmax.reduce(np.abs(self.states["u"]), axis=1)
        count = np.clip(len(columns) * self.run.sample_period / FRAME, FRAMES, MOST_FRAMES).astype(int)
        self.frames = columns.at(np.unique(np.linspace(0, len(columns) - 1, count).astype(int)))
        bent = [np.fmax.reduce(np.abs(part["q_m"] - part["q_l"])) for part in columns.parts()]
        self.deflection = np.asarray(np.fmax.reduce(bent))
        ends = rows[rows > 0]
        self.steps = powers.at(ends, (*RATES, "watts", "joules"))
        self.steps["t"] = columns.at(ends - 1)["t"]
        rates = np.zeros(2)
        for part in powers.parts():
            error_and_rate = np.abs([part["predicted"] - part["measured"], part["measured"]])
            rates += error_and_rate[:, np.isfinite(error_and_rate[0])].sum(axis=1)
        self.rate_error = float(rates[0] / rates[1]) if rates[1] else math.nan

    @property
    def relative_storage(self) -> Array:
        """V / V(0); V itself where the run starts without error."""
        V = self.states["V"]
        return V / (V[0] or 1.0)


def kept_rows(states: int, *columns: Iterator[Array]) -> NDArray[np.intp]:
    """Return all rows of a run up to EVERY states, else those with the extremes of each column in each of BUCKETS."""
    if states <= EVERY:
        return np.arange(states)
    return np.unique(np.concatenate([extremes(column[None], BUCKETS) for column in chain(*columns)]))


@dataclass(frozen=True)
class RunSummary:
    """A reported run: folder of its report, report and what its page shows. label: unique among several runs.

    has_page: whether report.html was written. notes: how the run was made, for the page that compares it.
    """

    folder: Path
    report: Report
    data: Shown
    label: str = ""
    has_page: bool = True
    notes: tuple[str, ...] = ()

    @property
    def files(self) -> list[Path]:
        """Return the paths of page and metrics."""
        return [self.folder / name for name in ((PAGE, METRICS) if self.has_page else (METRICS,))]

    @property
    def values(self) -> dict[str, Any]:
        """Return the run as JSON values: its files and the content of report.json."""
        page = self.folder / PAGE if self.has_page else None
        return {"name": self.label, "folder": self.folder, "page": page, **self.report.as_json()}


def arm_replay(data: Shown) -> ArmReplay | None:
    """Return the replay of a run; None without positions of the links. Raises ParameterError, RobotError."""
    values, frames, joints = data.run.scenario.controller_values, data.frames, data.run.joints
    link, motor = frames["q_l"], frames["q_m"]
    if not np.isfinite(link).any():
        return None
    title, sizes = "The motion of the links", data.deflection
    if np.isfinite(sizes).any():
        joint = int(np.nanargmax(sizes))
        largest = milli(float(sizes[joint]), data.run.units[joint].position)
        title = f"Largest deflection of a spring: {largest} ({joints[joint]})"
    if (apart := (frames["t"][-1] - frames["t"][0]) / MOST_FRAMES) > FRAME:
        title = f"{title}; a position each {apart:.2g} s"
    factor = magnification(motor - link)
    arm = scene(description(values), locked_positions(values))
    return ArmReplay(title, arm, joints, frames["t"], link, motor, frames["q_ld"], factor)


def magnification(deflection: Array) -> int:
    """Return the largest of FACTORS with which the deflections (k, n) stay below VISIBLE; 1 if none is known."""
    largest = float(np.nanmax(np.abs(deflection), initial=0.0))
    return max((factor for factor in FACTORS if factor * largest <= VISIBLE), default=1) if largest else 1
