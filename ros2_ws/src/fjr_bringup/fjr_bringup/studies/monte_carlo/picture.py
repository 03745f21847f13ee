# SPDX-License-Identifier: Apache-2.0
"""Figure of a Monte-Carlo study: success and error over the range of each drawn parameter."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator
from numpy.typing import NDArray

from fjr_bringup.formatting import number, percent
from fjr_bringup.plotting.joint_lines import COLOURS
from fjr_bringup.plotting.overview import GREY, STYLE
from fjr_bringup.studies.monte_carlo.store import Store
from fjr_core.experiments.monte_carlo.distributions import LOG_UNIFORM
from fjr_core.experiments.monte_carlo.sensitivity import Effect, Summary
from fjr_core.numerics.checks import Array
from fjr_core.simulation.batch.draws import UNITS

SHOWN = 4  # drawn parameters
DOTS = 4000
GOOD, BAD = COLOURS[0], COLOURS[1]


def draw(store: Store, summary: Summary, path: Path) -> Path:
    """Write the figure; the most influential parameters come first."""
    effects, success = summary.effects[:SHOWN], store.column("success")
    rms = np.max([store.column(f"rms.{joint}") for joint in store.sweep.scenario.joints], axis=0)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.1 * (len(effects) + 1), 6.4), layout="constrained")
        axes = figure.subplots(2, len(effects) + 1, squeeze=False)
        for column, effect in enumerate(effects):
            drawn = store.sweep.vary[effect.name.partition(".")[0]]
            _share(axes[0, column], effect)
            _dots(axes[1, column], store.column(effect.name), rms, success, effect)
            axes[1, column].xaxis.set_major_locator(MaxNLocator(5))
            if drawn.kind == LOG_UNIFORM:
                _logarithmic(axes[:, column], effect)
        axes[0, 0].set_ylabel("share of success")
        axes[1, 0].set_ylabel("RMS error, worst joint [rad]")
        _indices(axes[0, -1], summary)
        _distribution(axes[1, -1], rms, success)
        share = f"{percent(summary.succeeded / summary.runs)} of {summary.runs:,} runs succeed"
        title = f"{store.sweep.name}: {share}, each of {store.sweep.duration:g} s"
        figure.suptitle(title, fontsize=13, x=0.01, ha="left")
        figure.savefig(path)
    return path


def _logarithmic(axes: Iterable[Axes], effect: Effect) -> None:
    """Set logarithmic axes with few plain ticks."""
    ticks = np.geomspace(effect.edges[0], effect.edges[-1], 5)
    for ax in axes:
        ax.set_xscale("log")
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xticks(ticks, [number(tick, digits=2) for tick in ticks.tolist()])


def _share(ax: Axes, effect: Effect) -> None:
    ax.stairs(effect.high, effect.edges, baseline=effect.low, fill=True, color=GOOD, alpha=0.25, lw=0)
    ax.stairs(effect.share, effect.edges, color=GOOD, lw=1.8, baseline=None)
    ax.set(title=effect.name, ylim=(-0.03, 1.03), xlim=(effect.edges[0], effect.edges[-1]))
    ax.xaxis.set_major_locator(MaxNLocator(5))


def _dots(ax: Axes, values: Array, rms: Array, success: NDArray[np.bool_], effect: Effect) -> None:
    """Plot single runs; unstable runs are marked at the upper edge."""
    values, rms, success = values[:DOTS], rms[:DOTS], success[:DOTS]
    stable = np.isfinite(rms)
    for which, colour in ((success, GOOD), (stable & ~success, BAD)):
        ax.plot(values[which], rms[which], ".", ms=2.2, color=colour, alpha=0.5, rasterized=True)
    lost = values[~stable]
    ax.plot(lost, np.full(len(lost), 0.985), "x", ms=3, color=BAD, alpha=0.6, transform=ax.get_xaxis_transform())
    unit = UNITS.get(effect.name.partition(".")[0])
    label = f"{effect.name} [{unit}]" if unit else f"{effect.name} (factor)"
    ax.set(yscale="log", xlim=(effect.edges[0], effect.edges[-1]), xlabel=label)


def _indices(ax: Axes, summary: Summary) -> None:
    shown = summary.effects[: 2 * SHOWN][::-1]
    rows = np.arange(len(shown))
    ax.barh(rows + 0.2, [effect.success for effect in shown], 0.36, color=BAD, label="success")
    ax.barh(rows - 0.2, [effect.error for effect in shown], 0.36, color=GREY, label="log RMS error")
    ax.set_yticks(rows, [effect.name for effect in shown])
    ax.set(title="Part of the variance", xlim=(0, 1))
    ax.grid(axis="y", visible=False)
    ax.legend(loc="lower right", fontsize=8, frameon=False)


def _distribution(ax: Axes, rms: Array, success: NDArray[np.bool_]) -> None:
    stable = np.isfinite(rms) & (rms > 0)
    lost = int(np.sum(~np.isfinite(rms)))
    if stable.any():
        edges = np.geomspace(rms[stable].min(), rms[stable].max() * (1 + 1e-9), 41)
        parts = [rms[stable & success], rms[stable & ~success]]
        ax.hist(parts, edges, stacked=True, color=[GOOD, BAD], label=["success", "failure"])
        ax.set_xscale("log")
        ax.legend(loc="best", fontsize=8, frameon=False)
    ax.set(title=f"Runs by error; {lost} lost", xlabel="RMS error, worst joint [rad]")
