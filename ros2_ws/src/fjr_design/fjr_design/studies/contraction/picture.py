# SPDX-License-Identifier: Apache-2.0
"""Figure of `fjr contraction`: converging solutions, distances, differential storage and its rate."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_design.stability.contraction import Contraction, Measured
from fjr_monitor.report.picture import COLOURS, GREY, STYLE

SHOWN = 3  # joints
FLOOR = 1e-12  # relative to the start; rounding level of a distance
BOUND = COLOURS[1]
PALETTE = COLOURS[:6]  # black is the measured trajectory


def draw(name: str, joints: Sequence[str], measured: Measured, q_ld: Array, found: Contraction, path: Path) -> None:
    """Write the figure. joints: names with units; q_ld (k, n): reference at the measured instants."""
    shown = min(len(joints), SHOWN)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 7.4), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.0))
        for j, ax in enumerate(np.atleast_1d(left.subplots(shown, 1, sharex=True))):
            _positions(ax, joints[j], measured.x[:, j], q_ld[:, j], found.t, found.x_v[:, :, j])
            ax.set_xlabel("t [s]" if j == shown - 1 else "")
        part = "" if shown == len(joints) else f" (first {shown} of {len(joints)} joints)"
        np.atleast_1d(left.axes)[0].set_title(f"{found.x_v.shape[1]} virtual solutions meet the measured one{part}")
        above, middle, below = right.subplots(3, 1, sharex=True, height_ratios=(3, 3, 2))
        _distances(above, found)
        _storage(middle, found)
        _rates(below, found)
        title = f"{name}: the virtual system contracts along the measured trajectory"
        figure.suptitle(title, fontsize=13, x=0.01, ha="left")
        figure.savefig(path)


def _positions(ax: Axes, joint: str, q_l: Array, q_ld: Array, t: Array, q_lv: Array) -> None:
    for i in range(q_lv.shape[1]):
        label = "virtual $q_{lv}$" if i == 0 else None
        ax.plot(t, q_lv[:, i], color=PALETTE[i % len(PALETTE)], lw=1.0, alpha=0.9, label=label)
        ax.plot(t[0], q_lv[0, i], "o", color=PALETTE[i % len(PALETTE)], ms=3.5)
    ax.plot(t, q_ld, color=GREY, lw=3.2, alpha=0.35, label="reference $q_{ld}$", zorder=1)
    ax.plot(t, q_l, color="black", lw=1.8, ls=(0, (4, 2)), label="measured $q_l$", zorder=5)
    ax.set_ylabel(joint)
    ax.legend(loc="lower right", fontsize=8, frameon=False)


def _distances(ax: Axes, found: Contraction) -> None:
    relative = found.distance / found.distance[0]
    for pair in relative.T:
        ax.semilogy(found.t, np.where(pair > FLOOR, pair, np.nan), color=COLOURS[0], lw=0.8, alpha=0.6)
    text = f"$e^{{-\\beta t}}$, $\\beta$ = {at_least(found.beta, 3)} 1/s"
    _bound(ax, found.t, found.bound, text, max(FLOOR, relative.min() / 10))
    ax.set(title="Distance of each pair in the metric P, relative to the start", ylabel="$d(t)/d(0)$")


def _storage(ax: Axes, found: Contraction) -> None:
    relative = found.W / found.W[0]
    for one in relative.T:
        ax.semilogy(found.t, np.where(one > FLOOR**2, one, np.nan), color=COLOURS[2], lw=0.8, alpha=0.8)
    _bound(ax, found.t, found.bound**2, "$e^{-2\\beta t}$", max(FLOOR**2, relative.min() / 10))
    ax.set(title="Differential storage $W = \\delta e' P\\, \\delta e/2$ of the prolonged system", ylabel="$W(t)/W(0)$")


def _rates(ax: Axes, found: Contraction) -> None:
    rates = np.where(FLOOR**2 * found.W[0] < found.W, found.rate, np.nan)
    for one in rates.T:
        ax.plot(found.t, one, color=COLOURS[2], lw=0.8, alpha=0.8)
    ax.axhline(found.beta, color=BOUND, lw=1.6, ls="--")
    basis = "proven" if found.proven else "sampled"
    ax.annotate(
        f"$\\beta$ = {at_least(found.beta, 3)} 1/s, {basis}",
        (found.t[-1], found.beta),
        (0, -5),
        textcoords="offset points",
        ha="right",
        va="top",
        color=BOUND,
    )
    top = float(np.nanpercentile(rates, 99)) if np.isfinite(rates).any() else found.beta
    ax.set(title="Its exact rate: never below $\\beta$", xlabel="t [s]", ylabel="$-\\dot W/2W$ [1/s]")
    ax.set_ylim(0.0, 1.15 * max(top, found.beta))


def _bound(ax: Axes, t: Array, bound: Array, text: str, floor: float) -> None:
    shown = np.where(bound > floor, bound, np.nan)
    ax.semilogy(t, shown, color=BOUND, lw=1.8, ls="--")
    at = int(0.3 * np.count_nonzero(np.isfinite(shown)))
    ax.annotate(text, (t[at], bound[at]), (8, 4), textcoords="offset points", color=BOUND)
    ax.set_ylim(floor, 3.0)
