# SPDX-License-Identifier: Apache-2.0
"""Regenerate the table of docs/tables/robust.md between its markers, and its figure.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.robust_study.table
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import fjr_core as fjr
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import Robust
from fjr_monitor.report.picture import COLOURS, STYLE

from .loops import PERIOD, errors, heavier, pushed, rms

ROOT = Path(__file__).resolve().parents[2]
PAGE, PICTURE = ROOT / "docs" / "tables" / "robust.md", ROOT / "docs" / "figures" / "robust.png"
START, END = "<!-- measured: begin -->", "<!-- measured: end -->"
RESIDUAL, INTEGRAL = Robust(residual_gain=60.0), Robust(integral_gain=5.0)
PREDICTION = Robust(delay=PERIOD)
BOTH = Robust(residual_gain=60.0, integral_gain=5.0)
SECONDS, SETTLED = 6.0, 2.0
NAMES = ("paper_k31", "two_link", "arm7")
Case = tuple[str, Scenario, fjr.Robot, fjr.Reference, float, dict[str, Robust]]


def cases() -> list[Case]:
    """Return the cases: disturbance, scenario of the law, robot, reference, delay [s] and options."""
    joint, planar, arm = (load_scenario(ROOT / f"ros2_ws/src/fjr_bringup/scenarios/{name}.yaml") for name in NAMES)
    load = {"residual": RESIDUAL, "integral": INTEGRAL, "both": BOTH}
    slow = fjr.Sine(0.3, 2 * np.pi * 0.2, offset=arm.reference.jets(0.5)[0])
    disturbed: list[Case] = [
        ("`paper_k31` at standstill, 0.3 N m on the link", joint, pushed(joint.robot, 0.3), fjr.Hold([0.5]), 0.0, load),
        ("`paper_k31` moving, 0.3 N m on the link", joint, pushed(joint.robot, 0.3), joint.reference, 0.0, load),
        ("`two_link` moving, inertia 20 % larger", planar, heavier(planar.robot, 1.2), planar.reference, 0.0, load),
        ("`arm7`, 0.3 rad at 0.2 Hz, inertia 20 % larger", arm, heavier(arm.robot, 1.2), slow, 0.0, load),
        ("the same, weight 20 % larger too", arm, heavier(arm.robot, 1.2, 1.2), slow, 0.0, load),
    ]
    predicted = {"prediction": PREDICTION}
    return disturbed + [
        (f"`{name}` moving, one sample of delay", loop, loop.robot, loop.reference, PERIOD, predicted)
        for name, loop in zip(NAMES, (joint, planar, arm), strict=True)
    ]


def measured(found: list[tuple[Case, dict[str, Array]]]) -> list[str]:
    """Return the rows of the table: RMS of q_l - q_ld [rad] without and with each option, and their ratio."""
    lines = [
        "| disturbance | error without, rad | option | error with, rad | ratio |",
        "| --- | --- | --- | --- | --- |",
    ]
    settled = round(SETTLED / PERIOD)
    for (text, *_), runs in found:
        plain = rms(runs["none"][settled:])
        for name, e in runs.items():
            if name != "none":
                left = rms(e[settled:])
                lines.append(f"| {text} | {plain:.1e} | {name} | {left:.1e} | {min(plain / left, 1e6):.3g} |")
    return lines


def draw(found: list[tuple[Case, dict[str, Array]]]) -> None:
    """Draw the largest joint error over time, one colour for each option."""
    colours = {
        "none": "black",
        "residual": COLOURS[0],
        "integral": COLOURS[1],
        "both": COLOURS[2],
        "prediction": COLOURS[0],
    }
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 3.8), layout="constrained")
        for ax, i in zip(figure.subplots(1, 3), (1, 3, 5), strict=True):
            (text, *_), runs = found[i]
            for name, e in runs.items():
                t = PERIOD * np.arange(len(e))
                ax.semilogy(t, np.maximum(np.abs(e).max(axis=1), 1e-9), color=colours[name], label=name, lw=1.0)
            ax.set_title(text.replace("`", ""), fontsize=9)
            ax.set_xlabel("t [s]")
            ax.set_ylim(bottom=1e-8)
            ax.legend(fontsize=8, loc="upper right")
        figure.axes[0].set_ylabel("largest |q_l - q_ld| [rad]")
        figure.savefig(PICTURE)


def run(case: Case) -> dict[str, Array]:
    """Return the errors (k, n) [rad] without and with each option."""
    _, scenario, robot, reference, delay, options = case
    law = fjr.TrackingLaw(scenario.robot, scenario.gains, compile=True)
    start = 0.5 if law.robot.n == 1 and not isinstance(reference, fjr.Hold) else None
    return {
        name: errors(law, option, reference, robot, SECONDS, delay, start)
        for name, option in ({"none": None} | options).items()
    }


def main() -> None:
    """Run all cases, write the table, draw the figure."""
    found = [(case, run(case)) for case in tqdm(cases(), desc="robust")]
    before, rest = PAGE.read_text(encoding="utf-8").split(START)
    after = rest.split(END)[1]
    table = "\n".join(measured(found))
    PAGE.write_text(f"{before}{START}\n{table}\n{END}{after}", encoding="utf-8")
    draw(found)


if __name__ == "__main__":
    main()
