# SPDX-License-Identifier: Apache-2.0
"""HTML page of an identification: parameters with their intervals as bars, hold-out, fit over time, residuals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fjr_core.model.joints import Units
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import DEFLECTION, IDENTIFIED, UNKNOWN, WEAK, Estimate, Fit, Identification
from fjr_monitor.report import html
from fjr_monitor.report.html import Line, Plot, colour
from fjr_msgs_py.console.output import DASH, interval, number, percent, plural

from .estimation.validation import HoldOut

STIFFNESS = "joint_stiffness"
HOLD_OUT = ("", "this model", "rigid joints", "without skew")
COLOURS = {IDENTIFIED: "ok", WEAK: "maybe", UNKNOWN: "no"}
WIDEST = 4.0  # factor between the value and each end of the axis of a positive parameter
LONGEST_LAG = 1.0  # s
MOST_LAGS = 1000  # samples
TITLES = {"q_l": "links", "q_m": "motors", "torque": "torque sensors", DEFLECTION: "deflections"}
PREDICTED_BY_SIMULATION = "predicted from the effort and the state at the start of each segment"
PREDICTED_BY_MOTION = "predicted from the motion of the record"


def write_page(
    path: Path,
    name: str,
    identification: Identification,
    units: Sequence[Units],
    hold_outs: Sequence[HoldOut],
    notes: Sequence[str],
    seconds: float,
) -> None:
    """Write the page as one self-contained file. units: of each joint. seconds: of all records. Raises AssetError."""
    joints, fits = identification.joints, identification.fits
    places = [f"record-{i}" for i in range(len(fits))]
    pairs = list(zip(places, fits, strict=True))
    counts, of_stiffness = counted(identification), counted(identification, STIFFNESS)
    html.write_page(
        path,
        "identification.html",
        f"{name}: joint stiffness K of {of_stiffness[IDENTIFIED]} of {plural(len(joints), 'joint')} identified",
        [plot for place, fit in pairs for plot in fit_plots(fit, joints, units, place)],
        kicker=f"Identification of {plural(len(joints), 'joint')} from {plural(len(fits), 'record')}",
        notes=[*notes, *springs_seen(identification)],
        tiles=[
            (f"{counts[IDENTIFIED]} of {sum(counts.values())}", "parameters identified"),
            (str(counts[WEAK]), "weakly identified: read their intervals"),
            (str(counts[UNKNOWN]), "not identifiable from these records: kept as given"),
            (f"{seconds:.3g} s", "of motion"),
        ],
        groups=groups(identification),
        reasons=list(reasons(identification).items()),
        hold_outs=[(f"Hold-out: {held.record}", hold_out_rows(held)) for held in hold_outs],
        hold_out_head=HOLD_OUT,
        sections=[(place, fit.record, DEFLECTION not in fit.measured) for place, fit in pairs],
        json=identification.as_dict(),
    )


def counted(identification: Identification, name: str = "") -> dict[str, int]:
    """Return the number of estimates of each verdict, of one parameter or of all."""
    verdicts = [estimate.verdict for estimate in identification.estimates if name in ("", estimate.name)]
    return {verdict: verdicts.count(verdict) for verdict in (IDENTIFIED, WEAK, UNKNOWN)}


def hold_out_rows(held: HoldOut) -> list[list[str]]:
    """Return the rows of a hold-out table, of the joints whose both sides are measured."""
    rows = zip(held.joints, held.shares, strict=True)
    return [[joint, *(percent(share, 1) for share in row)] for joint, row in rows if np.isfinite(row[0])]


@dataclass(frozen=True)
class ParameterRow:
    """Texts of one estimate, and its bar in percent of the axis; prior_at: None if it is outside.

    reason: number of the reason of the verdict in `reasons`, from 1 on; None without one.
    """

    joint: str
    value: str
    interval: str
    prior: str
    verdict: str
    reason: int | None
    colour: str
    left: float
    width: float
    middle: float
    prior_at: float | None


def reason(estimate: Estimate) -> str:
    """Return the reason of a verdict, in the same words for every joint."""
    return estimate.reason.replace(f" of {estimate.joint};", " of the same joint;")


def reasons(identification: Identification, *verdicts: str) -> dict[str, str]:
    """Return parameters and joints of each reason of some verdicts, or of all, in the order of the estimates."""
    found: dict[str, dict[str, list[str]]] = {}
    for estimate in identification.estimates:
        if estimate.reason and (not verdicts or estimate.verdict in verdicts):
            found.setdefault(reason(estimate), {}).setdefault(estimate.name, []).append(estimate.joint or "the arm")
    return {why: "; ".join(_of_joints(names)) for why, names in found.items()}


def springs_seen(identification: Identification) -> list[str]:
    """Return at which deflections each stiffness was seen, or which bound it exceeds."""
    return [f"{each.name} of {each.joint}: {each.seen}" for each in identification.estimates if each.seen]


def _of_joints(names: Mapping[str, list[str]]) -> Iterator[str]:
    """Yield names and their joints, those of the same joints together."""
    for joints in dict.fromkeys(map(tuple, names.values())):
        yield f"{', '.join(name for name in names if tuple(names[name]) == joints)} of {', '.join(joints)}"


def groups(identification: Identification) -> list[tuple[str, list[ParameterRow]]]:
    """Return the rows by parameter, in the order of the estimates."""
    rows = {}
    for name in dict.fromkeys(estimate.name for estimate in identification.estimates):
        words = name.replace("_", " ").replace("coulomb", "Coulomb")
        estimates = [estimate for estimate in identification.estimates if estimate.name == name]
        rows[words[:1].upper() + words[1:]] = list(_rows(estimates, list(reasons(identification))))
    return list(rows.items())


def _rows(estimates: Sequence[Estimate], why: Sequence[str]) -> Iterator[ParameterRow]:
    """Yield the rows of one parameter; all bars have one axis, logarithmic around the value or linear."""
    logarithmic = all(estimate.low > 0 for estimate in estimates)
    largest = max((abs(end) for e in estimates for end in (e.low, e.high, e.prior)), default=1.0) or 1.0
    for e in estimates:
        ends = [e.low, e.value, e.high, e.prior]
        places = [_ratio_place(end, e.value) if logarithmic else 50.0 * (1.0 + 0.95 * end / largest) for end in ends]
        left, middle, right, prior = (round(min(100.0, max(0.0, place)), 2) for place in places)
        known = e.verdict != UNKNOWN
        yield ParameterRow(
            e.joint or "arm",
            number(e.value, e.unit),
            interval(e.low, e.high) if known else DASH,
            number(e.prior),
            e.verdict,
            why.index(reason(e)) + 1 if e.reason else None,
            COLOURS[e.verdict],
            left if known else 0.0,
            round(right - left, 2) if known else 0.0,
            middle,
            prior if 0.0 <= places[3] <= 100.0 else None,
        )


def _ratio_place(value: float, middle: float) -> float:
    """Return the place in percent on a logarithmic axis around a value; -1 for a value that has none."""
    return 50.0 * (1.0 + math.log(value / middle) / math.log(WIDEST)) if value > 0 and middle > 0 else -1.0


def fit_plots(fit: Fit, joints: tuple[str, ...], units: Sequence[Units], place: str) -> list[Plot]:
    """Return the plots of one record: a fit for each joint, residuals and autocorrelations of each signal."""
    drawn = [*_fits(fit, joints, units, place), *_residuals(fit, joints, place)]
    return [plot for plot in drawn if not plot.is_empty]


def _fits(fit: Fit, joints: tuple[str, ...], units: Sequence[Units], place: str) -> Iterator[Plot]:
    """Yield measured and predicted deflection of each joint; torque or motor position where a side is missing."""
    by = PREDICTED_BY_MOTION if DEFLECTION in fit.measured else PREDICTED_BY_SIMULATION
    for j, joint in enumerate(joints):
        what, measured, predicted = _compared(fit, j)
        what = units[j].of(what)
        if not np.isfinite(measured).any():
            continue
        lines = [Line("measured", measured, "grey", 1.2), Line("predicted", predicted, colour(j), 1.5)]
        title, share = f"{joint}: {what}", np.sqrt(np.maximum(1 - fit.explained[j], 0.0))
        if np.isfinite(share):
            title = f"{joint}: {100 * share:.1f} % of the deflection unexplained (root mean square)"
        yield Plot(f"{place}-fit-{j}", title, f"{what}; {by}.", fit.t, lines, y_label=what, place=place)


def _compared(fit: Fit, j: int) -> tuple[str, Array, Array]:
    """Return what a plot compares, measured and predicted (k,)."""
    seen = [name for name, values in fit.measured.items() if np.isfinite(values[:, j]).any()]
    if DEFLECTION in fit.measured:
        measured, predicted = (side[DEFLECTION][:, j] * 1e3 for side in (fit.measured, fit.predicted))
        return "q_m - q_l [mrad]", measured, predicted
    if {"q_l", "q_m"} <= set(seen):
        measured, predicted = ((side["q_m"] - side["q_l"])[:, j] * 1e3 for side in (fit.measured, fit.predicted))
        return "q_m - q_l [mrad]", measured, predicted
    name = next(name for name in ("torque", "q_l", "q_m") if name in seen)
    unit = "N m" if name == "torque" else "rad"
    return f"{name} [{unit}]", fit.measured[name][:, j], fit.predicted[name][:, j]


def _residuals(fit: Fit, joints: tuple[str, ...], place: str) -> Iterator[Plot]:
    """Yield the residuals of each signal in standard deviations of its noise, then their autocorrelations."""
    dt = float(fit.t[1] - fit.t[0])
    lags = min(MOST_LAGS, int(LONGEST_LAG / dt), len(fit.t) // 4)
    later: list[Plot] = []
    for name in fit.measured:
        values = np.asarray((fit.measured[name] - fit.predicted[name]) / fit.noise[name])
        known = np.isfinite(values).sum(axis=0)
        measured = np.flatnonzero(known).tolist()
        lines = [Line(joints[j], values[:, j], colour(j), 1.0) for j in measured]
        caption = "Measured minus predicted, in standard deviations of the noise."
        title = f"Residuals of the {TITLES[name]}"
        yield Plot(f"{place}-residual-{name}", title, caption, fit.t, lines, y_label="residual [1]", place=place)
        coloured = [Line(joints[j], autocorrelation(values[:, j], lags), colour(j), 1.3) for j in measured]
        band = np.full(lags + 1, 1.96 / np.sqrt(max(1, int(known[measured].min(initial=len(values))))))
        bounds = [Line("95 % of white noise", band, "grey", 1.0, (4, 4)), Line("", -band, "grey", 1.0, (4, 4))]
        later.append(
            Plot(
                f"{place}-autocorrelation-{name}",
                f"Autocorrelation of the residuals of the {TITLES[name]}",
                "Far outside the dashed band residuals are coloured: the intervals take this into account.",
                dt * np.arange(lags + 1, dtype=float),
                [*coloured, *bounds],
                x_label="lag [s]",
                y_label="autocorrelation [1]",
                time=False,
                place=place,
            )
        )
    yield from later


def autocorrelation(values: Array, lags: int) -> Array:
    """Return the autocorrelation (lags + 1,) of a series with mean 0; pairs with a NaN are left out."""
    known = np.isfinite(values)
    series = np.where(known, values, 0.0)
    size = 2 ** int(np.ceil(np.log2(len(values) + lags + 1)))
    power, count = (
        np.fft.irfft(np.abs(np.fft.rfft(rows, size)) ** 2, size)[: lags + 1] for rows in (series, known.astype(float))
    )
    mean = power / np.maximum(count, 0.5)
    return np.asarray(mean / mean[0]) if mean[0] > 0 else np.zeros(lags + 1)
