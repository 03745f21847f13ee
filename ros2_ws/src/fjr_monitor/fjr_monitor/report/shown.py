# SPDX-License-Identifier: Apache-2.0
"""What the page of a run shows of it: every state of a short run, the extremes of a longer one, the moving arm."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.robot import description, locked_positions
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.run import RunData
from fjr_monitor.report.html import ArmReplay, extremes
from fjr_monitor.report.metrics import Metrics, Report
from fjr_monitor.report.performance import Power
from fjr_monitor.scene import scene
from fjr_msgs_py.console.output import number

PAGE, METRICS = "report.html", "report.json"
EVERY = 40_000  # states of a run of which all are kept
BUCKETS = 1_000  # parts of a longer run; of each the least and the largest value of every signal are kept
VISIBLE = 0.3  # rad or m, of the largest deflection as magnified at first
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
FRAMES = 900  # of the motion of an arm; the page interpolates between them


class Columns:
    """Columns of numbers, decimated: no value of a column is above or below those that are kept of its bucket.

    kept: parts of each column, by its name.
    """

    def __init__(self, rows: int) -> None:
        """rows: how many will come."""
        self._width = 1 if rows <= EVERY else -(-rows // BUCKETS)
        self.kept: dict[str, list[Array]] = {}

    def add(self, **columns: Array) -> None:
        """Add rows of columns (k,) or of several columns (k, m)."""
        k = len(next(iter(columns.values())))
        rows: NDArray[np.intp] = np.arange(k)
        if self._width > 1 and k:
            each = [column for values in columns.values() for column in values.reshape(k, -1).T]
            rows = extremes(np.array(each), -(-k // self._width))
        for name, values in columns.items():
            self.kept.setdefault(name, []).append(values[rows])

    def __getitem__(self, name: str) -> Array:
        """Return the rows of a column that are kept."""
        self.kept[name] = [np.concatenate(self.kept[name])]
        return self.kept[name][0]


class Shown:
    """Signals of a run. states: t, q_l, q_ld, error, u, external_torque, V, H, since, latency; steps: rates of V,
    powers and energies.

    since: send time of a state since that of the one before. frames: t, q_l, q_m, q_ld at FRAMES instants. deflection
    (n,): largest |q_m - q_l|, NaN: unknown. apart, size: sums of the error of the predicted rate of V and of the rate.
    """

    def __init__(self, metrics: Metrics) -> None:
        self.metrics, self.run = metrics, metrics.run
        k, n = self.run.states, len(self.run.joints)
        self.states, self.steps, self.frames = Columns(k), Columns(k), Columns(0)
        self._frames: NDArray[np.int64] = np.unique(np.asarray(np.linspace(0, k - 1, FRAMES), dtype=np.int64))
        self.deflection = np.full(n, np.nan)
        self.apart = self.size = 0.0
        self._count, self._joules = 0, np.zeros(4)

    def add(self, part: RunData, flow: Power) -> None:
        """Add the new states of a part, and the powers of the steps that end there."""
        begin, n, certificate = part.begin, len(self.run.joints), part.certificate
        new, q_m = slice(begin, None), part.position[:, n:]
        since = np.diff(part.sent, prepend=np.nan)
        self.states.add(
            t=part.t[new],
            q_l=part.q_l[new],
            q_ld=part.q_ld[new],
            error=part.error[new],
            largest_error=np.abs(part.error[new]).max(axis=1),
            u=part.u[new],
            external_torque=part.external_torque[new],
            largest_effort=np.fmax.reduce(np.abs(part.u[new]), axis=1),
            V=part.V[new],
            H=certificate.H[new],
            since=since[new],
            latency=part.latency[new],
        )
        self._add_steps(part, flow)
        rows = self._frames[(self._frames >= self._count) & (self._frames < self._count + len(part.t) - begin)]
        rows = np.asarray(rows - self._count + begin)
        self.frames.add(t=part.t[rows], q_l=part.q_l[rows], q_m=q_m[rows], q_ld=part.q_ld[rows])
        self.deflection = np.fmax(self.deflection, np.fmax.reduce(np.abs(q_m - part.q_l), axis=0))
        self._count += len(part.t) - begin

    def _add_steps(self, part: RunData, flow: Power) -> None:
        """Add the steps that end in a part."""
        steps, V = slice(max(0, part.begin - 1), None), part.V
        measured = (-np.diff(V) / np.diff(part.t))[steps]
        predicted = -part.certificate.held_rate(part.u)[steps]
        known = np.isfinite(predicted) & np.isfinite(measured)
        self.size += float(np.abs(measured[known]).sum())
        self.apart += float(np.abs(predicted - measured)[known].sum())
        watts = np.column_stack([flow.supplied, flow.dissipated, flow.stored, flow.residual])
        joules = self._joules + np.nancumsum(watts * flow.dt[:, None], axis=0)
        self._joules = joules[-1] if len(joules) else self._joules
        least = (self.metrics.decay.beta * (V[:-1] + V[1:]))[steps]
        self.steps.add(t=flow.t, measured=measured, predicted=predicted, least=least, watts=watts, joules=joules)

    @property
    def relative_storage(self) -> Array:
        """V / V(0); V itself where the run starts without error."""
        return self.states["V"] / (self.metrics.decay.initial or 1.0)


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
        largest = number(float(sizes[joint]), data.run.units[joint].position)
        title = f"Largest deflection of a spring: {largest} ({joints[joint]})"
    factor = magnification(motor - link)
    arm = scene(description(values), locked_positions(values))
    return ArmReplay(title, arm, joints, frames["t"], link, motor, frames["q_ld"], factor)


def magnification(deflection: Array) -> int:
    """Return the largest of FACTORS with which the deflections (k, n) stay below VISIBLE; 1 if none is known."""
    largest = float(np.nanmax(np.abs(deflection), initial=0.0))
    return max((factor for factor in FACTORS if factor * largest <= VISIBLE), default=1) if largest else 1
