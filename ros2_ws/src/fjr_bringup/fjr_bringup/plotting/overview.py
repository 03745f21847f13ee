# SPDX-License-Identifier: Apache-2.0
"""Draw overview.png: six panels of a recorded run."""

from __future__ import annotations

from pathlib import Path
from textwrap import fill

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from fjr_bringup.analysis import headlines
from fjr_bringup.analysis.metrics import STEADY_AFTER, Report
from fjr_bringup.analysis.run_data import RunData
from fjr_bringup.plotting.joint_lines import COLOURS, DRAWABLE, colour, drawable, labels, name_joints
from fjr_bringup.recording.reader import Array
from fjr_core.robot.joint_units import joined

GREY = "#666666"
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
TITLE = 54  # characters of a line
ENLARGED = 2  # joints; with more, an inset would hide the lines
HEALTHY = 1e-3  # of V(0): leaving the bound above this value is not explained by the sample and hold


def tracking(ax: Axes, data: RunData) -> None:
    """Plot q_l over q_ld."""
    for j in range(len(data.joints)):
        ax.plot(data.t, data.q_ld[:, j], color=GREY, lw=3.2, alpha=0.35, solid_capstyle="round")
        ax.plot(data.t, drawable(data.q_l[:, j]), color=colour(j), lw=1.4)
    name_joints(ax, data, data.q_l)
    error = np.abs(data.error).max(axis=1)
    follows, many = error[-1] <= error[0], len(data.joints) > 1
    verb = ("follow" if many else "follows") if follows else ("do not follow" if many else "does not follow")
    title = f"The {'links' if many else 'link'} {verb} the reference (grey)"
    ax.set(title=title, xlabel="t [s]", ylabel=f"q_l, q_ld [{joined(each.position for each in data.units)}]")


def error(ax: Axes, data: RunData, report: Report) -> None:
    """Plot |q_l - q_ld| on a log axis."""
    size = drawable(np.abs(data.error))
    size = np.where(size > 0, size, np.nan)
    for j in range(len(data.joints)):
        ax.semilogy(data.t, size[:, j], color=colour(j), lw=1.0)
    name_joints(ax, data, size)
    worst = report.tracking.max_error_after_2s_rad
    title = "Tracking error"
    if worst and worst < DRAWABLE:
        ax.hlines(worst, STEADY_AFTER, data.t[-1], color=GREY, lw=1.0, ls="--")
        label = f"at most {headlines.steady_error(report, _power_of)} after 2 s"
        ax.annotate(label, (data.t[-1], worst), (0, 4), textcoords="offset points", ha="right", color=GREY)
        title = f"Error: from {headlines.initial_error(report)} to {headlines.steady_error(report, _power_of)}"
    ax.set(title=title, xlabel="t [s]", ylabel=f"|q_l − q_ld| [{headlines.position_unit(report)}]")


def storage(ax: Axes, data: RunData, report: Report) -> None:
    """Plot V/V(0) and exp(-2 beta t) on a log axis, with the instant V leaves the bound; without V plot the energy."""
    if not np.isfinite(data.V).any():
        ax.plot(data.t, drawable(data.H), color=COLOURS[0], lw=1.0)
        ax.set(title="The robot's energy (this law has no certificate)", xlabel="t [s]", ylabel="H [J]")
        return
    relative, bound = drawable(data.relative_storage), data.bound / (data.V[0] or 1.0)
    shown = relative[relative > 0]
    floor = float(shown.min(initial=1e-3)) / 30.0
    ax.semilogy(data.t, np.where(bound > floor, bound, np.nan), color=GREY, lw=1.4, ls="--")
    ax.semilogy(data.t, relative, color=COLOURS[0], lw=1.0)
    ax.set_ylim(floor, 30.0 * float(shown.max(initial=1.0)))
    at, height = int(np.searchsorted(-bound, -(floor ** (1 / 3)))), floor ** (1 / 3)
    text = f"bound exp(−2βt),\nβ = {data.beta:.3g} 1/s"
    ax.annotate(text, (data.t[min(at, len(data.t) - 1)], height), (8, 2), textcoords="offset points", color=GREY)
    _mark_departure(ax, data, report)
    rate = None if report.storage is None else report.storage.measured_decay_rate_per_s
    basis = "proven" if data.beta_is_proven else "sampled"
    title = f"V falls at {rate:.3g} 1/s; {basis}: at least {2 * data.beta:.3g} 1/s" if rate else "V and its bound"
    ax.set(title=title, xlabel="t [s]", ylabel="V(t) / V(0)")


def _mark_departure(ax: Axes, data: RunData, report: Report) -> None:
    """Mark where V leaves its bound, with the reason."""
    if report.storage is None:
        return
    leaves, relative = report.storage.leaves_bound_at_s, report.storage.relative_where_it_leaves
    if leaves is None or relative is None or not relative < DRAWABLE:
        return
    ax.plot([leaves], [relative], "o", color=COLOURS[1], ms=5, zorder=5)
    text = _reason(data, leaves, relative)
    ax.text(0.98, 0.97, text, transform=ax.transAxes, ha="right", va="top", color=COLOURS[1])


def _reason(data: RunData, leaves: float, relative: float) -> str:
    first = f"leaves the bound at {leaves:.2f} s, {_power(relative)} V(0)"
    if relative > HEALTHY:
        return f"{first}: not healthy.\nCommands were late or missing, or the gains\nare too high for the sample rate."
    return (
        f"{first}: healthy.\n"
        f"The proof is for continuous time; holding u for {data.sample_period * 1e3:g} ms\n"
        "is a small disturbance, and V stays on its floor."
    )


def effort(ax: Axes, data: RunData, report: Report) -> None:
    """Plot the commands; for up to ENLARGED joints add an inset of the first 0.25 s."""
    _steps(ax, data)
    name_joints(ax, data, data.u)
    if len(data.joints) <= ENLARGED:
        zoom = ax.inset_axes((0.36, 0.12 if data.u[0].sum() < 0 else 0.52, 0.6, 0.36))
        _steps(zoom, data)
        zoom.set_xlim(-0.005, 0.25)
        zoom.set_title("first 0.25 s", fontsize=8, fontweight="normal", color=GREY, loc="center", pad=2)
        zoom.tick_params(labelsize=7)
    title = f"Effort: {headlines.peak_effort_and_share(report)}"
    ax.set(title=title, xlabel="t [s]", ylabel=f"u [{headlines.effort_unit(report)}]")


def _steps(ax: Axes, data: RunData) -> None:
    for j in range(len(data.joints)):
        ax.step(data.t, drawable(data.u[:, j]), where="post", color=colour(j), lw=1.2)


def period(ax: Axes, data: RunData, report: Report) -> None:
    """Plot the histogram of the periods between states."""
    timing, counts = report.timing, report.counts
    _histogram(ax, np.diff(data.sent) * 1e3, COLOURS[0])
    _marks(ax, (timing.period_p50_us, timing.period_p99_us, timing.period_max_us))
    title = f"{counts.published} of {counts.nominal} states published"
    ax.set(title=title, xlabel="time between states [ms]", ylabel="states")


def latency(ax: Axes, data: RunData, report: Report) -> None:
    """Plot the histogram of the latencies from state to command."""
    timing, counts = report.timing, report.counts
    _histogram(ax, data.latency[~np.isnan(data.latency)] * 1e3, COLOURS[2])
    _marks(ax, (timing.latency_p50_us, timing.latency_p99_us, timing.latency_max_us))
    title = f"{100 * (counts.answered_in_time_fraction or 0.0):.2f} % answered before the next state"
    ax.set(title=title, xlabel="state to command [ms]", ylabel="states")


def _histogram(ax: Axes, milliseconds: Array, face: str) -> None:
    """Draw a histogram with logarithmic axes over the full range of values."""
    low, high = float(milliseconds.min(initial=0.5)), float(milliseconds.max(initial=2.0))
    ax.hist(
        milliseconds,
        bins=np.geomspace(max(low, 1e-3), high * 1.01, 81).tolist(),
        color=face,
        log=True,
        histtype="stepfilled",
    )
    ax.set_xscale("log")
    ticks = [digit * 10.0**power for power in range(-2, 4) for digit in (1, 2, 5)]
    ax.set_xticks([tick for tick in ticks if low <= tick <= high] or [low])
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_ylim(0.7, 3.0 * ax.get_ylim()[1])


def _marks(ax: Axes, microseconds: tuple[float, float, float]) -> None:
    """Mark the percentiles and list them as text, since they are often too close for labels."""
    for value in microseconds[:2]:
        ax.axvline(value * 1e-3, color=GREY, lw=1.0, ls="--")
    names = ("50 %", "99 %", "max")
    text = "\n".join(f"{name}: {value * 1e-3:.2f} ms" for name, value in zip(names, microseconds, strict=True))
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 1.5}
    ax.text(0.98, 0.97, text, transform=ax.transAxes, ha="right", va="top", color=GREY, bbox=box)


def _power_of(value: float, unit: str) -> str:
    return f"{_power(value)} {unit}"


def _power(value: float) -> str:
    """Typeset 1.5e-05 as 1.5 x 10^-5 in plain text; Matplotlib's own formulas take a tenth of the drawing."""
    mantissa, exponent = f"{value:.1e}".split("e")
    return f"{mantissa}×{_power_of_ten(int(exponent))}"


def _power_of_ten(exponent: int) -> str:
    return "10" + str(exponent).translate(SUPERSCRIPTS)


def _label_powers(axis: Axis) -> None:
    """Label the ticks of a logarithmic axis with powers of ten in plain text."""
    axis.set_major_formatter(lambda value, _: _power_of_ten(round(np.log10(value))))


STYLE = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": GREY,
    "axes.grid": True,
    "grid.color": "#E6E6E6",
    "grid.linewidth": 0.7,
    "axes.axisbelow": True,
    "savefig.dpi": 150,
}


@mpl.rc_context(STYLE)
def draw_overview(name: str, data: RunData, report: Report, folder: Path) -> Path:
    """Write overview.png into the folder and return its path."""
    figure = Figure(figsize=(14.0, 7.2))
    longest = max(map(len, labels(data.joints))) if len(data.joints) > 1 else 0
    space = 0.26 + 0.03 * max(0, longest - 7)  # between the columns, for the names
    margins = {"left": 0.05, "right": 0.99, "bottom": 0.07, "top": 0.89, "wspace": space, "hspace": 0.32}
    axes = figure.subplots(2, 3, gridspec_kw=margins)  # an automatic layout takes as long as the drawing
    tracking(axes[0, 0], data)
    error(axes[0, 1], data, report)
    storage(axes[0, 2], data, report)
    effort(axes[1, 0], data, report)
    period(axes[1, 1], data, report)
    latency(axes[1, 2], data, report)
    clock = "in lock-step" if report.lockstep else "in real time"
    rate = f"{1.0 / data.sample_period:g} Hz"
    title = f"{name}: plant and controller as two ROS 2 nodes, {rate} {clock}"
    figure.suptitle(title, fontsize=13, x=0.01, y=0.98, ha="left")
    path = folder / "overview.png"
    for ax in figure.axes:
        if ax.get_yscale() == "log":
            _label_powers(ax.yaxis)
        ax.set_title(fill(ax.get_title(loc="left"), TITLE))
        ax.minorticks_off()  # on log axes each is drawn by five artists, a third of the drawing time
    figure.savefig(path, pil_kwargs={"compress_level": 3})
    return path
