# SPDX-License-Identifier: Apache-2.0
"""Plots of one run: tracking, effort, storage function V, energy balance and timing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fjr_core.model.robot import joined
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_monitor.analysis import headlines
from fjr_monitor.analysis.metrics import Report
from fjr_monitor.analysis.timing import Distribution
from fjr_monitor.plotting.figure import Line, Plot, colour, drawable
from fjr_monitor.report.shown import Shown
from fjr_msgs_py.console.output import milliseconds, number, percent, plural

FEW = 2  # joints; with more, efforts are shown in percent of their limits first


def run_plots(data: Shown, report: Report) -> list[Plot]:
    """Return the plots that are not empty, in the order of the page."""
    drawn = [
        tracking(data),
        error(data, report),
        effort(data, report),
        storage(data, report),
        rate(data),
        balance(data, report),
        period(data, report),
        latency(data, report),
        timeline(data, report),
    ]
    return [plot for plot in drawn if not plot.is_empty]


def tracking(data: Shown) -> Plot:
    """Plot q_l over q_ld."""
    joints, states = data.run.joints, data.states
    many, size = len(joints) > 1, states["largest_error"]
    verb = "follow" if size[-1] <= max(size[0], 1e-3) else "do not follow"
    if not many:
        verb = {"follow": "follows", "do not follow": "does not follow"}[verb]
    reference = [Line("reference" if j == 0 else "", column, "grey", 4.0) for j, column in enumerate(states["q_ld"].T)]
    links = _per_joint(data, states["q_l"])
    return Plot(
        "tracking",
        f"The {'links' if many else 'link'} {verb} the reference",
        "Link positions over the reference (grey).",
        states["t"],
        [*reference, *links],
        y_label=f"q_l, q_ld [{joined(each.position for each in data.run.units)}]",
    )


def error(data: Shown, report: Report) -> Plot:
    """Plot |q_l - q_ld| on a log axis."""
    worst, first = report.tracking.max_error_after_2s_rad, report.tracking.initial_error_rad
    title = f"The error begins at {headlines.initial_error(report)}"
    if worst is not None and np.isfinite(worst):
        goes = "falls" if worst < first else "goes"
        title = f"The error {goes} from {headlines.initial_error(report)} to {headlines.steady_error(report)}"
    settled = report.tracking.settling_time_2_percent_s
    caption = "Tracking error of each joint; log axis." + (
        f" Within 2 % of the initial error from {number(settled, 's')} on." if settled else ""
    )
    lines = _per_joint(data, np.abs(data.states["error"]), width=1.2)
    return Plot(
        "error",
        title,
        caption,
        data.states["t"],
        lines,
        y_label=f"|q_l − q_ld| [{headlines.position_unit(report)}]",
        y_log=True,
    )


def effort(data: Shown, report: Report) -> Plot:
    """Plot the commands and their limits; also in percent of the limits if every joint has one."""
    title, unit = f"The effort peaks at {headlines.peak_effort_and_share(report)}", headlines.effort_unit(report)
    t, limit = data.states["t"], data.run.effort_limit
    limited = np.isfinite(limit)
    caption = "Commands, held from state to state. " + _limits_caption(report)
    torque = Plot("effort", title, caption, t, _efforts(data, np.ones(len(limited))), y_label=f"u [{unit}]")
    if not limited.all():
        return torque
    shares = Plot("effort", title, caption, t, _efforts(data, limit / 100.0), y_label="u [% of limit]")
    first, second = ((torque, unit), (shares, "% of limit"))[:: 1 if len(limited) <= FEW else -1]
    return replace(first[0], views={second[1]: second[0]})


def _limits_caption(report: Report) -> str:
    saturated = report.tracking.saturated_fraction
    if saturated is None:
        return "The scenario gives no limit."
    return f"Limits dashed; {percent(saturated) + ' of the commands reach' if saturated else 'no command reaches'} one."


def _efforts(data: Shown, unit: Array) -> list[Line]:
    limit = data.run.effort_limit
    limits = np.where(np.isfinite(limit), limit, np.nan) / unit
    same = np.allclose(limits, limits[0])
    lines = _per_joint(data, data.states["u"] / unit, width=1.3, step=True)
    for j in range(1 if same else len(limits)):
        if np.isfinite(limits[j]):
            shade, flat = "grey" if same else colour(j), np.full(len(data.states["t"]), limits[j])
            lines += [
                Line("limit" if same and i == 0 else "", sign * flat, shade, 1.0, (6, 4))
                for i, sign in enumerate((1, -1))
            ]
    return lines


def storage(data: Shown, report: Report) -> Plot:
    """Plot V and its bound V(0) exp(-2 beta t) on a log axis; the caption explains why V leaves the bound."""
    found, relative = report.storage, drawable(data.relative_storage, log=True)
    floor = float(np.nanmin(relative, initial=1e-3)) / 30.0
    bound = data.relative_bound
    lines = [
        Line("V / V(0)", relative, "c1", 1.5),
        Line("bound exp(−2βt)", np.where(bound > floor, bound, np.nan), "grey", 1.5, (6, 4)),
    ]
    title, caption = "V and its bound", ""
    if found is not None:
        basis = "proven" if found.guarantee_is_proven else "sampled"
        least = f"{basis}: at least {at_least(found.guaranteed_decay_rate_per_s, 3)} 1/s"
        measured = found.measured_decay_rate_per_s
        title = f"V falls at {number(measured, '1/s')}; {least}" if measured else f"V and its bound; {least}"
        caption = _bound_caption(data, report)
    return Plot(
        "storage", title, caption, data.states["t"], lines, y_label="V(t) / V(0)", y_log=True, y_range=(floor, None)
    )


def _bound_caption(data: Shown, report: Report) -> str:
    found = report.storage
    if found is None or found.leaves_bound_at_s is None or found.relative_where_it_leaves is None:
        return "V stays within its bound throughout."
    there = number(found.relative_where_it_leaves)
    leaves = f"V leaves the bound at {number(found.leaves_bound_at_s, 's')}, at {there} V(0)."
    if report.verdict.kind == "holding":
        return (
            f"{leaves} The proof assumes continuous time; the controller is sampled: it holds u for "
            f"{number(data.run.sample_period * 1e3, 'ms')}, so V levels off."
        )
    return leaves


def rate(data: Shown) -> Plot:
    """Plot -dV/dt [W]: predicted by the model for the effort sent, measured, and required by the bound."""
    lines = [
        Line("predicted", data.steps["predicted"], "grey", 4.0),
        Line("measured", data.steps["measured"], "c1", 1.2),
        Line("2βV, required by the bound", data.steps["least"], "c2", 1.2, (6, 4)),
    ]
    caption = (
        "Rate of decay of V between states: predicted by the model for the effort sent, measured, and required by the "
        "bound. Gaps: V grows because u is held."
    )
    title = "The rate of V"
    if 0 < data.size < np.inf:
        apart = data.apart / data.size
        title = f"V's rate is predicted {'to' if apart < 0.1 else 'only to'} {number(100 * apart, '%', 2)}"
    return Plot("rate", title, caption, data.steps["t"], lines, y_label="−dV/dt [W]", y_log=True)


def balance(data: Shown, report: Report) -> Plot:
    """Plot the energy supplied, dissipated and stored since the start; the other view shows the power."""
    title, energy = "Energy balance", report.energy
    if energy is not None and np.isfinite(energy.rms_residual_of_supplied):
        left = number(100 * energy.rms_residual_of_supplied, "%", 2)
        title = f"{left} of the power supplied is unexplained"
    caption = (
        "In the model, the energy that the motors supply is stored or dissipated. The residual is due to friction, "
        "load, delay or wrong parameters."
    )
    t, lines = data.steps["t"], {name: _flows(data, name) for name in ("watts", "joules")}
    watts = Plot("power", title, caption, t, lines["watts"], y_label="power [W]")
    energies = {"y_label": "energy since the start [J]", "views": {"W": watts}}
    return Plot("power", title, caption, t, lines["joules"], **energies)  # type: ignore[arg-type]


def _flows(data: Shown, unit: str) -> list[Line]:
    if not np.isfinite(data.steps["watts"]).any():
        return []
    names, colours = ("supplied", "dissipated", "stored", "residual"), ("c1", "c2", "c3", "bad")
    columns = zip(names, data.steps[unit].T, colours, (1.5, 1.5, 1.5, 1.2), strict=True)
    return [Line(name, values, shade, width) for name, values, shade, width in columns]


def _per_joint(data: Shown, values: Array, width: float = 1.5, step: bool = False) -> list[Line]:
    return [Line(joint, values[:, j], colour(j), width, step=step) for j, joint in enumerate(data.run.joints)]


BINS = 60
HALF = 0.5  # states; drawn for an empty bin on the log axis
SMALLEST = 1e-3  # ms


def period(data: Shown, report: Report) -> Plot:
    """Plot the distribution of the time between states."""
    timing, counts = report.timing, report.counts
    title = f"{counts.published} of {counts.nominal} states published"
    caption = _percentiles(timing.period_p50_us, timing.period_p99_us, timing.period_max_us)
    return _histogram("period", title, caption, data.metrics.clock.periods, "time between states [ms]", "c1")


def latency(data: Shown, report: Report) -> Plot:
    """Plot the distribution of the time from state to command."""
    timing, counts = report.timing, report.counts
    title = f"{percent(counts.answered_in_time_fraction)} answered before the next state"
    caption = _percentiles(timing.latency_p50_us, timing.latency_p99_us, timing.latency_max_us)
    return _histogram("latency", title, caption, data.metrics.clock.latencies, "state to command [ms]", "c3")


def timeline(data: Shown, report: Report) -> Plot:
    """Plot the time between states and from state to command over the run."""
    counts, t = report.counts, data.states["t"]
    lines = [
        Line("since the last state", data.states["since"] * 1e3, "c1", 1.0),
        Line("to its command", data.states["latency"] * 1e3, "c3", 1.0),
        Line("sample period", np.full(len(t), data.run.sample_period * 1e3), "grey", 1.0, (6, 4)),
    ]
    late = "" if counts.late is None else f", {plural(counts.late, 'late answer')}, {counts.unanswered} without"
    caption = "Time from state to state and from state to command, by the middleware's stamps at sending."
    title = plural(counts.gaps, "gap") + late
    return Plot("timeline", title, caption, t, lines, y_label="[ms]", y_log=True, wide=True)


def _percentiles(p50: float, p99: float, largest: float) -> str:
    return f"50 %: {milliseconds(p50)}, 99 %: {milliseconds(p99)}, largest: {milliseconds(largest)}."


def _histogram(name: str, title: str, caption: str, times: Distribution, label: str, shade: str) -> Plot:
    """Plot a histogram with two log axes that cover all values."""
    edges, heights = bins(times)
    line = Line("states", heights, shade, 1.2, step=True, fill=True)
    axes = {"x_label": label, "y_label": "states", "x_log": True, "y_log": True, "time": False}
    return Plot(name, title, caption, edges, [line], y_range=(HALF, None), **axes)  # type: ignore[arg-type]


def bins(times: Distribution) -> tuple[Array, Array]:
    """Return edges (BINS + 1,) [ms] and the counts from each edge to the next, HALF for an empty bin."""
    if not times.count:
        return np.array([SMALLEST, 1.0]), np.full(2, np.nan)
    low = max(times.least * 1e-6, SMALLEST)
    high = max(times.largest * 1e-6 * 1.01, 1.2 * low)
    edges = np.asarray(np.geomspace(min(low, high / 2) / 1.01, high, BINS + 1), dtype=np.float64)
    return edges, np.append(np.maximum(times.histogram(edges * 1e6), HALF), HALF)
