# SPDX-License-Identifier: Apache-2.0
"""Study of disturbance compensation: sampled loops on robots that differ from the model of their law.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.robust_study

writes the table of docs/tables/robust.md between its markers, and its figure.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import fjr_core as fjr
from bench.figures import put
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import Robust, sampled_law
from fjr_monitor.report.picture import COLOURS, STYLE

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "figures" / "robust.png"
PERIOD = 1e-3  # s
START, END = "<!-- measured: begin -->", "<!-- measured: end -->"
RESIDUAL, INTEGRAL = Robust(residual_gain=60.0), Robust(integral_gain=5.0)
PREDICTION = Robust(delay=PERIOD)
BOTH = Robust(residual_gain=60.0, integral_gain=5.0)
SECONDS, SETTLED = 6.0, 2.0
NAMES = ("paper_k31", "two_link", "arm7")
Case = tuple[str, Scenario, fjr.Robot, fjr.Reference, float, dict[str, Robust]]


def pushed(robot: fjr.Robot, torque: Any) -> fjr.Robot:
    """Return the robot with a constant torque (n,) [N m] on its links: P_l - torque' q_l."""
    links, q = robot.links, ca.SX.sym("q", robot.n)
    d = ca.DM(np.broadcast_to(np.asarray(torque, dtype=float), robot.n))
    P_l = ca.Function("P_l", [q], [links.P_l(q) - ca.dot(d, q)])
    grad_P_l = ca.Function("grad_P_l", [q], [links.grad_P_l(q) - d])
    return replace(robot, links=replace(links, P_l=P_l, grad_P_l=grad_P_l))


def heavier(robot: fjr.Robot, factor: float, gravity: float = 1.0) -> fjr.Robot:
    """Return the robot with scaled link inertia (factor) and gravity torque (gravity)."""
    links, n = robot.links, robot.n
    q, v, w, a = (ca.SX.sym(name, n) for name in ("q", "v", "w", "a"))
    inertial = factor * links.inertial_torque(q, v, w, a)
    return replace(
        robot,
        links=replace(
            links,
            M_l=ca.Function("M_l", [q], [factor * links.M_l(q)]),
            C=ca.Function("C", [q, v, w], [factor * links.C(q, v, w)]),
            inertial_torque=ca.Function("inertial_torque", [q, v, w, a], [inertial]),
            grad_T=ca.Function("grad_T", [q, v], [factor * links.grad_T(q, v)]),
            P_l=ca.Function("P_l", [q], [gravity * links.P_l(q)]),
            grad_P_l=ca.Function("grad_P_l", [q], [gravity * links.grad_P_l(q)]),
            M_l_vertices=None,
        ),
    )


def errors(
    law: fjr.TrackingLaw,
    robust: Robust | None,
    reference: fjr.Reference,
    robot: fjr.Robot,
    seconds: float,
    delay: float = 0.0,
    position: Any = None,
) -> Array:
    """Return q_l - q_ld (k, n) [rad] of a 1 kHz loop, starting on the reference or at rest at `position` [rad].

    delay [s]: of the command; the plant takes 4 steps per sample.
    """
    n, jets = robot.n, reference.jets(0.0)
    q_l = jets[0] if position is None else np.broadcast_to(np.asarray(position, dtype=float), n)
    dq_l = jets[1] if position is None else np.zeros(n)
    x0 = robot.state(q_l, q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l)), dq_l, dq_l)
    run = fjr.simulate(fjr.Plant(robot), sampled_law(law, robust), reference, x0, seconds, PERIOD, delay=delay)
    return np.asarray(run.x[:, :n] - run.jets[:, 0])


def rms(e: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(e**2)))


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
    put(measured(found), "robust.md", START, END)
    draw(found)


if __name__ == "__main__":
    main()
