# SPDX-License-Identifier: Apache-2.0
"""HTML page of an identification: parameters with intervals, hold-out, fit, residuals."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fjr_design.uncertainty.posterior import DEFLECTION, IDENTIFIED, UNKNOWN, WEAK, Identification
from fjr_identification.page.page_figures import fit_plots
from fjr_identification.page.page_rows import BAR_HEAD, groups, reasons
from fjr_monitor.report import html
from fjr_msgs_py.console.formatting import percent, plural

HOLD_OUT = ("", "this model", "rigid joints", "without skew")
HOLD_OUT_TEXT = (
    "Root mean square of the deflection q_m - q_l that a model leaves unexplained, relative to all of it, on a record "
    "from which nothing was identified. Rigid joints: no deflection, the skew alone. Without skew: the springs alone."
)
TEXT = (
    "Bars: 95 % interval, value as a line, prior dotted. Positive parameters have a logarithmic axis from a quarter to "
    "four times the value, others a linear one. A parameter that is not identifiable keeps its prior. Numbers refer to "
    "the reasons below."
)
FOOTER = (
    "Drag over a plot to enlarge it, double-click to go back; a click on a name hides its line. robot.yaml and "
    "identification.json are in the same folder. Needs no network."
)
BY_SEGMENTS = (
    "Each segment of the record is predicted from its first state; the states of all segments are identified, too."
)
BY_MOTION = (
    "Torques that the model lacks move the joints too far for a simulation. The deflections follow from the filtered "
    "motion of the record and the identified parameters; nothing is simulated."
)
HoldOutRows = tuple[str, Sequence[Sequence[float]]]
"""Name of a record, and for each joint the unexplained shares of the columns of HOLD_OUT."""


def write_page(
    path: Path, name: str, found: Identification, hold_outs: Sequence[HoldOutRows], notes: Sequence[str], seconds: float
) -> Path:
    """Write the page as one self-contained file. seconds: length of all records. Raises AssetError."""
    places = [f"record-{i}" for i in range(len(found.fits))]
    plots = [
        plot for place, fit in zip(places, found.fits, strict=True) for plot in fit_plots(fit, found.joints, place)
    ]
    counts = counted(found)
    html.write_page(
        path,
        "identification.html",
        f"{name}: {counts[IDENTIFIED]} of {len(found.estimates)} parameters identified",
        plots,
        kicker=f"Identification of {plural(len(found.joints), 'joint')} from {plural(len(found.fits), 'record')}",
        notes=notes,
        tiles=[
            (str(counts[IDENTIFIED]), "parameters identified"),
            (str(counts[WEAK]), "weakly identified: read their intervals"),
            (str(counts[UNKNOWN]), "not identifiable from these records: as before"),
            (f"{seconds:.3g} s", "of motion"),
        ],
        groups=groups(found),
        reasons=reasons(found),
        parameters_text=TEXT,
        bar_head=BAR_HEAD,
        hold_outs=[
            (f"Hold-out: {record}", hold_out_rows(found.joints, rows), HOLD_OUT_TEXT) for record, rows in hold_outs
        ],
        hold_out_head=HOLD_OUT,
        sections=[
            (place, fit.record, BY_MOTION if DEFLECTION in fit.measured else BY_SEGMENTS)
            for place, fit in zip(places, found.fits, strict=True)
        ],
        json=html.as_json(found.as_dict()),
        footer=FOOTER,
    )
    return path


def counted(found: Identification) -> dict[str, int]:
    """Return the number of estimates of each verdict."""
    return {kind: sum(each.verdict == kind for each in found.estimates) for kind in (IDENTIFIED, WEAK, UNKNOWN)}


def hold_out_rows(joints: Sequence[str], shares: Sequence[Sequence[float]]) -> list[list[str]]:
    """Return the rows of a hold-out table, of the joints whose both sides are measured."""
    rows = zip(joints, shares, strict=True)
    return [[joint, *(percent(each, 1) for each in row)] for joint, row in rows if np.isfinite(row[0])]
