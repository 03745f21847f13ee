# SPDX-License-Identifier: Apache-2.0
"""Page and picture of one run, report.html and overview.png, with their plots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fjr_core.config.controller import TORQUE_BANDWIDTH
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.files import Times
from fjr_monitor.report import html
from fjr_monitor.report.html import ArmReplay, Line, Plot, colour, drawable
from fjr_monitor.report.metrics import Report
from fjr_monitor.report.performance import FLOWS
from fjr_monitor.report.picture import SHADES, draw_plot
from fjr_monitor.report.shown import Shown
from fjr_msgs_py.console.output import milli, number, percent, plural

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FEW = 2  # joints; with more, efforts are shown in percent of their limits first
BINS = 60  # of a histogram
LITTLE = 1e-4  # of the power supplied
HALF = 0.5  # states; drawn for an empty bin on the log axis
SMALLEST = 1e-3  # ms
WIDTH = 68  # characters of a line over a plot of the picture


def write_run_page(path: Path, data: Shown, report: Report, arm: ArmReplay | None = None) -> None:
    """Write the page of a run, with the arm in 3D if it is given; raises AssetError."""
    title = f"{report.scenario}: {report.stop.heading if report.stop else html.HEADINGS[report.status]}"
    plots = [plot for plot in RunPlots(data, report).all() if not plot.is_empty]
    html.write_page(path, "run.html", title, plots, arm, report=report, json=report.as_json())


def draw_overview(name: str, data: Shown, report: Report, figure: Figure) -> None:
    """Draw six plots of the page."""
    from matplotlib.lines import Line2D

    plots = RunPlots(data, report)
    storage = plots.storage()
    if storage.is_empty:
        energy = [Line("H", data.states["H"])]
        title = "The robot's energy (this law has no certificate)"
        storage = Plot("energy", title, "", data.states["t"], energy, y_label="H [J]")
    shown = (plots.tracking(), plots.error(), storage, plots.effort(), plots.period(), plots.latency())
    figure.set_layout_engine("none")  # an automatic layout takes as long as the drawing
    margins = {"left": 0.05, "right": 0.99, "bottom": 0.1, "top": 0.86, "wspace": 0.2, "hspace": 0.48}
    for ax, plot in zip(figure.subplots(2, 3, gridspec_kw=margins).flat, shown, strict=True):
        draw_plot(ax, plot, WIDTH)
    joints = data.run.joints if len(data.run.joints) > 1 else []
    shown_by = [Line2D([], [], color=SHADES[colour(j)], label=joint) for j, joint in enumerate(joints)]
    figure.legend(handles=shown_by, loc="lower center", ncols=8, frameon=False)
    clock = "in lock-step" if report.lockstep else "in real time"
    title = f"{name}: plant and controller as two ROS 2 nodes, {1.0 / report.sample_period_s:g} Hz {clock}"
    figure.suptitle(title, fontsize=13, x=0.01, y=0.98, ha="left")


class RunPlots:
    """Plots of one run, each titled by its result."""

    def __init__(self, data: Shown, report: Report) -> None:
        self._data, self._report = data, report
        self._t, self._joints = data.states["t"], data.run.joints

    def all(self) -> list[Plot]:
        """Return the plots in the order of the page."""
        control = [self.tracking(), self.error(), self.effort(), self.storage(), self.rate(), self.balance()]
        return [*control, self.external_torque(), self.period(), self.latency(), self.timeline()]

    def tracking(self) -> Plot:
        """Plot q_l over q_ld."""
        states, size = self._data.states, self._data.states["largest_error"]
        well = size[-1] <= max(size[0], 1e-3)
        reference = [Line("" if j else "reference", column, "grey", 4.0) for j, column in enumerate(states["q_ld"].T)]
        return Plot(
            "tracking",
            "The motion follows the reference" if well else "The motion does not follow the reference",
            "Link positions over the reference (grey).",
            self._t,
            [*reference, *self._per_joint(states["q_l"])],
            y_label=f"q_l, q_ld [{self._report.position_unit}]",
        )

    def error(self) -> Plot:
        """Plot |q_l - q_ld| on a log axis."""
        report = self._report
        worst, settled = report.tracking.max_error_after_2s_rad, report.tracking.settling_time_2_percent_s
        title = f"The error begins at {report.initial_error()}"
        if np.isfinite(worst):
            goes = "falls" if worst < report.tracking.initial_error_rad else "goes"
            title = f"The error {goes} from {report.initial_error()} to {report.steady_error()}"
        caption = "Tracking error of each joint; log axis."
        caption += f" Within 2 % of the initial error from {number(settled, 's')} on." if settled else ""
        lines = self._per_joint(1e3 * np.abs(self._data.states["error"]), width=1.2)
        label = f"|q_l − q_ld| [{report.error_unit}]"
        return Plot("error", title, caption, self._t, lines, y_label=label, y_log=True)

    def effort(self) -> Plot:
        """Plot the commands and their limits; also in percent of the limits if every joint has one."""
        limit, saturated = self._data.run.effort_limit, self._report.tracking.saturated_fraction
        title, unit = f"The effort peaks at {self._report.peak_effort_and_share()}", self._report.effort_unit
        limits = "The scenario gives no limit."
        if saturated is not None:
            reach = f"{percent(saturated)} of the commands reach" if saturated else "no command reaches"
            limits = f"Limits dashed; {reach} one."
        caption = f"Commands, held from state to state. {limits}"
        torque = Plot("effort", title, caption, self._t, self._efforts(np.ones_like(limit)), y_label=f"u [{unit}]")
        if not np.isfinite(limit).all():
            return torque
        shares = replace(torque, lines=self._efforts(limit / 100.0), y_label="u [% of limit]")
        first, second = ((torque, unit), (shares, "% of limit"))[:: 1 if len(limit) <= FEW else -1]
        return replace(first[0], views={second[1]: second[0]})

    def _efforts(self, unit: Array) -> list[Line]:
        limit = self._data.run.effort_limit
        limits = np.where(np.isfinite(limit), limit, np.nan) / unit
        same = np.allclose(limits, limits[0])
        lines = self._per_joint(self._data.states["u"] / unit, width=1.3, step=True)
        for j in np.flatnonzero(np.isfinite(limits[:1] if same else limits)):
            shade, flat = "grey" if same else colour(int(j)), np.full(len(self._t), limits[j])
            lines.append(Line("limit" if same else "", flat, shade, 1.0, (6, 4)))
            lines.append(Line("", -flat, shade, 1.0, (6, 4)))
        return lines

    def external_torque(self) -> Plot:
        """Plot the estimated external torques on the links."""
        torque, unit = self._data.states["external_torque"], self._report.effort_unit
        bandwidth = self._data.run.scenario.controller_values[TORQUE_BANDWIDTH.name]
        caption = (
            f"Estimated from spring torque and motion, with a bandwidth of {bandwidth:g} 1/s. Contact, payload, "
            "friction of the links and model errors count."
        )
        label = f"external torque [{unit}]"
        lines = self._per_joint(torque, width=1.2)
        return Plot("external_torque", "External torque", caption, self._t, lines, y_label=label)

    def storage(self) -> Plot:
        """Plot V and its bound V(0) exp(-2 beta t) on a log axis; the caption explains why V leaves the bound."""
        found, initial = self._report.storage, self._data.states["V"][0]
        relative = drawable(self._data.relative_storage, log=True)
        bound = initial * np.exp(-2.0 * self._data.metrics.beta * self._t) / (initial or 1.0)
        floor = float(np.nanmin(relative, initial=1e-3)) / 30.0
        bound = np.where(bound > floor, bound, np.nan)
        lines = [Line("V / V(0)", relative, "c1", 1.5), Line("bound exp(−2βt)", bound, "grey", 1.5, (6, 4))]
        title, caption = "V and its bound", ""
        if found is not None:
            least, measured = f"{found.basis}: at least {found.least} 1/s", found.measured_decay_rate_per_s
            title = f"V falls at {number(measured, '1/s')}; {least}" if measured else f"V and its bound; {least}"
            caption = "V stays within its bound throughout."
        if found is not None and found.leaves_bound_at_s is not None:
            there = number(found.relative_where_it_leaves)
            caption = f"V leaves the bound at {number(found.leaves_bound_at_s, 's')}, at {there} V(0)."
            if self._report.verdict.kind == "holding":
                held = number(self._data.run.sample_period * 1e3, "ms")
                caption += f" The proof assumes continuous time; the controller holds u for {held}, so V levels off."
        ranges = {"y_label": "V(t) / V(0)", "y_log": True, "y_range": (floor, None)}
        return Plot("storage", title, caption, self._t, lines, **ranges)  # type: ignore[arg-type]

    def rate(self) -> Plot:
        """Plot -dV/dt [W]: predicted by the model for the effort sent, measured, and required by the bound."""
        data = self._data
        lines = [
            Line("predicted", data.steps["predicted"], "grey", 4.0),
            Line("measured", data.steps["measured"], "c1", 1.2),
            Line("2βV, required by the bound", data.steps["least"], "c2", 1.2, (6, 4)),
        ]
        caption = (
            "Rate of decay of V between states: predicted by the model for the effort sent, measured, and required by "
            "the bound. Gaps: V grows because u is held."
        )
        title = "The rate of V"
        if np.isfinite(data.rate_error):
            title = f"Prediction and measurement of the rate of V differ by {number(100 * data.rate_error, '%', 2)}"
        return Plot("rate", title, caption, data.steps["t"], lines, y_label="−dV/dt [W]", y_log=True)

    def balance(self) -> Plot:
        """Plot the energy supplied, dissipated and stored since the start; the other view shows the power."""
        steps, energy = self._data.steps, self._report.energy
        title = "Energy balance"
        if energy is not None and np.isfinite(energy.rms_residual_of_supplied):
            share = energy.rms_residual_of_supplied
            left = number(100 * share, "%", 2) if share > LITTLE else f"less than {100 * LITTLE:g} %"
            title = f"Unexplained: {left} of the power supplied"
        caption = (
            "In the model, the energy that the motors supply is stored or dissipated. The residual is due to friction, "
            "load, delay or wrong parameters."
        )
        known = [np.isfinite(column).any() for column in steps["watts"].T]
        watts, joules = (
            [
                Line(name, steps[unit][:, i], "bad" if name == "residual" else colour(i), 1.2 if i == 3 else 1.5)
                for i, name in enumerate(FLOWS)
                if known[i if unit == "watts" else -1]
            ]
            for unit in ("watts", "joules")
        )
        power = Plot("power", title, caption, steps["t"], watts, y_label="power [W]")
        return replace(power, lines=joules, y_label="energy since the start [J]", views={"W": power})

    def period(self) -> Plot:
        """Plot the distribution of the time between states."""
        counts = self._report.counts
        title = f"{counts.published} of {counts.nominal} states published"
        return self._histogram("period", title, self._data.run.signals.periods, "time between states [ms]", "c1")

    def latency(self) -> Plot:
        """Plot the distribution of the time from state to command."""
        title = f"{percent(self._report.counts.answered_in_time_fraction)} answered before the next state"
        return self._histogram("latency", title, self._data.run.signals.latencies, "state to command [ms]", "c3")

    def timeline(self) -> Plot:
        """Plot the time between states and from state to command over the run."""
        counts, states, period = self._report.counts, self._data.states, self._data.run.sample_period
        lines = [
            Line("since the last state", states["since"] * 1e3, "c1", 1.0),
            Line("to its command", states["latency"] * 1e3, "c3", 1.0),
            Line("sample period", np.full(len(self._t), period * 1e3), "grey", 1.0, (6, 4)),
        ]
        late = "" if counts.late is None else f", {plural(counts.late, 'late answer')}, {counts.unanswered} unanswered"
        caption = "Time from state to state and from state to command, by the middleware's stamps at sending."
        title = plural(counts.gaps, "gap") + late
        return Plot("timeline", title, caption, self._t, lines, y_label="[ms]", y_log=True, wide=True)

    def _per_joint(self, values: Array, width: float = 1.5, step: bool = False) -> list[Line]:
        return [Line(joint, values[:, j], colour(j), width, step=step) for j, joint in enumerate(self._joints)]

    def _histogram(self, name: str, title: str, times: Times, label: str, shade: str) -> Plot:
        """Plot a histogram with two log axes that cover all values."""
        found = [getattr(self._report.timing, f"{name}_{which}_us") for which in ("p50", "p99", "max")]
        caption = "50 %: {}, 99 %: {}, largest: {}.".format(*(milli(1e-6 * each, "s") for each in found))
        edges, heights = bins(times)
        line = Line("states", heights, shade, 1.2, step=True, fill=True)
        axes = {"x_label": label, "y_label": "states", "x_log": True, "y_log": True, "time": False}
        return Plot(name, title, caption, edges, [line], y_range=(HALF, None), **axes)  # type: ignore[arg-type]


def bins(times: Times) -> tuple[Array, Array]:
    """Return edges (BINS + 1,) [ms] and the counts of times [ns] from each to the next, HALF for an empty bin."""
    if not len(times):
        return np.array([SMALLEST, 1.0]), np.full(2, np.nan)
    low = max(times.min() * 1e-6, SMALLEST)
    high = max(times.max() * 1e-6 * 1.01, 1.2 * low)
    edges = np.asarray(np.geomspace(min(low, high / 2) / 1.01, high, BINS + 1), dtype=np.float64)
    counts, _ = np.histogram(np.maximum(times, edges[0] * 1e6), edges * 1e6)
    return edges, np.append(np.maximum(counts, HALF), HALF)
