# SPDX-License-Identifier: Apache-2.0
"""Plots of the identification page: fit over time, residuals, and their autocorrelation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import DEFLECTION, Fit
from fjr_monitor.plotting.figure import Line, Plot, colour

LONGEST_LAG = 1.0  # s
MOST_LAGS = 1000
TITLES = {"q_l": "links", "q_m": "motors", "torque": "torque sensors", DEFLECTION: "deflections"}
BY_SIMULATION = "predicted from the effort and the state at the start of each segment"
BY_MOTION = "predicted from the motion of the record"


def fit_plots(fit: Fit, joints: tuple[str, ...], place: str) -> list[Plot]:
    """Return the plots of one record: a fit for each joint, residuals and autocorrelations of each signal."""
    drawn = [*_fits(fit, joints, place), *_residuals(fit, joints, place), *_autocorrelations(fit, joints, place)]
    return [plot for plot in drawn if not plot.is_empty]


def _fits(fit: Fit, joints: tuple[str, ...], place: str) -> Iterator[Plot]:
    """Yield measured and predicted deflection of each joint; torque or motor position where a side is missing."""
    for j, joint in enumerate(joints):
        what, measured, predicted = _compared(fit, j)
        if not np.isfinite(measured).any():
            continue
        lines = [
            Line("measured", measured, "grey", 1.2),
            Line("predicted", predicted, colour(j), 1.5),
        ]
        title, share = f"{joint}: {what}", np.sqrt(np.maximum(1 - fit.explained[j], 0.0))
        if np.isfinite(share):
            title = f"{joint}: {share:.1%} of the deflection unexplained (root mean square)"
        caption = f"{what}; {BY_MOTION if DEFLECTION in fit.measured else BY_SIMULATION}."
        yield Plot(f"{place}-fit-{j}", title, caption, fit.t, lines, y_label=what, place=place)


def _compared(fit: Fit, j: int) -> tuple[str, Array, Array]:
    """Return what a plot compares, measured and predicted (k,)."""
    if DEFLECTION in fit.measured:
        measured, predicted = (each[DEFLECTION][:, j] * 1e3 for each in (fit.measured, fit.predicted))
        return "q_m - q_l [mrad]", measured, predicted
    known = [
        name
        for name in ("q_l", "q_m", "torque")
        if np.isfinite(fit.measured.get(name, np.full((1, j + 1), np.nan))[:, j]).any()
    ]
    if {"q_l", "q_m"} <= set(known):
        measured, predicted = ((each["q_m"] - each["q_l"])[:, j] * 1e3 for each in (fit.measured, fit.predicted))
        return "q_m - q_l [mrad]", measured, predicted
    name = "torque" if "torque" in known else known[0]
    unit = "N m" if name == "torque" else "rad"
    return f"{name} [{unit}]", fit.measured[name][:, j], fit.predicted[name][:, j]


def _scaled_residuals(fit: Fit, name: str) -> Array:
    """Return the residuals (k, n) of a signal in standard deviations of its noise."""
    return np.asarray((fit.measured[name] - fit.predicted[name]) / fit.noise[name])


def _residuals(fit: Fit, joints: tuple[str, ...], place: str) -> Iterator[Plot]:
    for name in fit.measured:
        values = _scaled_residuals(fit, name)
        lines = [
            Line(joint, values[:, j], colour(j), 1.0)
            for j, joint in enumerate(joints)
            if np.isfinite(values[:, j]).any()
        ]
        caption = "Measured minus predicted, in standard deviations of the noise."
        title = f"Residuals of the {TITLES[name]}"
        yield Plot(f"{place}-residual-{name}", title, caption, fit.t, lines, y_label="residual [1]", place=place)


def _autocorrelations(fit: Fit, joints: tuple[str, ...], place: str) -> Iterator[Plot]:
    dt = float(fit.t[1] - fit.t[0])
    lags = min(MOST_LAGS, int(LONGEST_LAG / dt), len(fit.t) // 4)
    for name in fit.measured:
        values = _scaled_residuals(fit, name)
        known = [j for j in range(len(joints)) if np.isfinite(values[:, j]).any()]
        lines = [Line(joints[j], autocorrelation(values[:, j], lags), colour(j), 1.3) for j in known]
        band = 1.96 / np.sqrt(max(1, int(np.isfinite(values[:, known]).sum(axis=0).min(initial=len(values)))))
        bounds = [Line("95 % of white noise", np.full(lags + 1, sign * band), "grey", 1.0, (4, 4)) for sign in (1, -1)]
        bounds[1] = Line("", bounds[1].values, "grey", 1.0, (4, 4))
        yield Plot(
            f"{place}-autocorrelation-{name}",
            f"Autocorrelation of the residuals of the {TITLES[name]}",
            "Far outside the dashed band residuals are coloured: the intervals take this into account.",
            dt * np.arange(lags + 1, dtype=float),
            [*lines, *bounds],
            x_label="lag [s]",
            y_label="autocorrelation [1]",
            time=False,
            place=place,
        )


def autocorrelation(values: Array, lags: int) -> Array:
    """Return the autocorrelation (lags + 1,) of a series with mean 0; pairs with a NaN are left out."""
    known = np.isfinite(values)
    series = np.where(known, values, 0.0)
    size = 2 ** int(np.ceil(np.log2(len(values) + lags + 1)))
    power, count = (
        np.fft.irfft(np.abs(np.fft.rfft(each, size)) ** 2, size)[: lags + 1] for each in (series, known.astype(float))
    )
    mean = power / np.maximum(count, 0.5)
    return np.asarray(mean / mean[0]) if mean[0] > 0 else np.zeros(lags + 1)
