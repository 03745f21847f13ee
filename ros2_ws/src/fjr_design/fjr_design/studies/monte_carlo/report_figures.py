# SPDX-License-Identifier: Apache-2.0
"""Plots of a Monte-Carlo study: success and error over each drawn parameter, distribution of the error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fjr_core.numerics.checks import Array
from fjr_core.simulation.batch.draws import UNITS
from fjr_design.experiments.monte_carlo.sensitivity import Effect, Summary
from fjr_design.studies.monte_carlo.store import Store
from fjr_monitor.report.html import Line, Plot
from fjr_msgs_py.console.output import percent

SHOWN = 4  # drawn parameters
DOTS = 4000
GOOD, BAD, LOST = "c1", "c2", "bad"
BINS = 40  # of the distribution
ABOVE = 1.5  # times the largest error: where unstable runs are drawn
ERROR = "RMS error, worst joint [rad]"


def sweep_plots(store: Store, summary: Summary) -> list[Plot]:
    """Return the plots: of each of the SHOWN most influential parameters, then of all runs."""
    rms = np.max([store.column(f"rms.{joint}") for joint in store.sweep.scenario.joints], axis=0)
    success, plots = store.column("success"), []
    for number, effect in enumerate(summary.effects[:SHOWN]):
        log = store.sweep.is_logarithmic(effect.name)
        plots += [_share(number, effect, log), _runs(number, effect, log, store.column(effect.name), rms, success)]
    plots.append(_distribution(rms, success))
    return [plot for plot in plots if not plot.is_empty]


def _share(number: int, effect: Effect, log: bool) -> Plot:
    """Plot the success rate over a parameter, in bins of equal probability."""
    lines = [
        Line("95 %: to", _held(effect.high), GOOD, 0.8, step=True),
        Line("from", _held(effect.low), GOOD, 0.8, step=True),
        Line("success", _held(effect.share), GOOD, 2.0, step=True),
    ]
    return Plot(
        f"share-{number}",
        f"{effect.name} explains {percent(effect.success, 0)} of the variance of success",
        "Success rate in bins of equal probability, with its 95 % interval.",
        effect.edges,
        lines,
        x_label=_label(effect.name),
        y_label="success rate [%]",
        x_log=log,
        y_range=(-3.0, 103.0),
        time=False,
        band=(0, 1),
    )


def _held(shares: Array) -> Array:
    """Return shares of the bins as percentages at the edges."""
    return 100.0 * np.append(shares, shares[-1:])


def _runs(number: int, effect: Effect, log: bool, values: Array, rms: Array, success: NDArray[np.bool_]) -> Plot:
    """Plot the first DOTS runs as dots over a parameter."""
    order = np.argsort(values[:DOTS], kind="stable")
    drawn, error, good = values[order], rms[order], success[order]
    stable = np.isfinite(error) & (error > 0)
    edge = ABOVE * float(error[stable].max(initial=1e-12))
    lines = _present(
        Line("succeeds", np.where(good & stable, error, np.nan), GOOD, dots=True),
        Line("fails", np.where(~good & stable, error, np.nan), BAD, dots=True),
        Line("unstable (upper edge)", np.where(stable, np.nan, edge), LOST, dots=True),
    )
    return Plot(
        f"runs-{number}",
        f"{effect.name} explains {percent(effect.error, 0)} of the variance of log RMS error",
        f"One dot per run{f', the first {DOTS}' if len(values) > DOTS else ''}.",
        drawn,
        [Line("run", order.astype(float), "grey", unseen=True), *lines],
        x_label=_label(effect.name),
        y_label=ERROR,
        x_log=log,
        y_log=True,
        time=False,
    )


def _distribution(rms: Array, success: NDArray[np.bool_]) -> Plot:
    """Plot a histogram of the errors of the stable runs."""
    stable = np.isfinite(rms) & (rms > 0)
    errors = rms[stable] if stable.any() else np.ones(1)
    edges = np.geomspace(errors.min() / 1.001, errors.max() * 1.001, BINS + 1)
    good, bad = (np.histogram(rms[which], edges)[0] for which in (stable & success, stable & ~success))
    lines = [
        Line("succeed", np.append(good, 0.0), GOOD, 1.2, step=True, fill=True),
        Line("fail", np.append(bad, 0.0), BAD, 1.2, step=True, fill=True),
    ]
    return Plot(
        "distribution",
        f"{percent(float(stable.mean()))} of the runs are stable",
        "Stable runs by their error; log axis.",
        edges,
        lines,
        x_label=ERROR,
        y_label="runs",
        x_log=True,
        time=False,
        y_range=(0.0, None),
        wide=True,
    )


def _present(*lines: Line) -> Sequence[Line]:
    return [line for line in lines if np.isfinite(line.values).any()]


def _label(name: str) -> str:
    unit = UNITS.get(name.partition(".")[0])
    return f"{name} [{unit}]" if unit else f"{name} (factor)"
