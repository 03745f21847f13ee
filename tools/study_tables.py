# SPDX-License-Identifier: Apache-2.0
"""Studies of robust options and of noise: tables of docs/tables, between their markers.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.study_tables robust
fjr tune arm7_tune && .venv/bin/python -m tools.study_tables noise --tuned runs/tuned/*/arm7_tune_v_dpbc.yaml

They are seeded and need no ROS. `robust` also draws docs/figures/robust.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import fjr_core as fjr
from bench.figures import ROOT, markdown, put
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import Robust, sampled_law
from fjr_design.batch import ClosedLoop, Draws, scenario_loop
from fjr_design.studies.sweep import Sweep, figures, planned
from fjr_design.studies.trial import Trial, directions, motion_demand
from fjr_design.tuning.equal_bandwidth import baseline_target, tune
from fjr_monitor.report.picture import COLOURS, write_picture
from fjr_msgs_py.console.output import number
from fjr_msgs_py.scenarios import library

PICTURE = ROOT / "docs" / "figures" / "robust.png"
SECONDS, SETTLED = 6.0, 2.0  # s
LEAST = 1e-4  # mrad, of the picture


# Robust options.

PERIOD = 1e-3  # s
RESIDUAL, INTEGRAL = Robust(residual_gain=60.0), Robust(integral_gain=5.0)
LOAD = {"none": None, "residual": RESIDUAL, "integral": INTEGRAL, "both": Robust(residual_gain=60.0, integral_gain=5.0)}
PREDICTION = {"none": None, "prediction": Robust(delay=PERIOD)}
OPTION_COLOURS = dict(zip(LOAD, ("black", *COLOURS[:3]), strict=True)) | {"prediction": COLOURS[0]}
DRAWN_CASES = (1, 3, 5)

Errors = Mapping[str, Array]
"""q_l - q_ld (k, n) [rad] by option."""


def disturbed() -> Iterator[tuple[str, Errors]]:
    """Yield the cases of the table: robots that differ from the model of their law, with each option against that."""
    joint, planar, arm = map(library.load, ("paper_k31", "two_link", "arm7"))
    slow = fjr.Sine(0.3, 2 * np.pi * 0.2, offset=arm.reference.jets(0.5)[0])
    pushed, heavier, late = Draws(1, link_torque=0.3), Draws(1, link_inertia=1.2), Draws(1, delay=PERIOD)
    loaded = Draws(1, link_inertia=1.2, gravity=1.2)
    yield "`paper_k31` at standstill, 0.3 N m on the link", errors(joint, pushed, LOAD, fjr.Hold([0.5]))
    yield "`paper_k31` moving, 0.3 N m on the link", errors(joint, pushed, LOAD)
    yield "`two_link` moving, inertia 20 % larger", errors(planar, heavier, LOAD)
    yield "`arm7`, 0.3 rad at 0.2 Hz, inertia 20 % larger", errors(arm, heavier, LOAD, slow)
    yield "the same, weight 20 % larger too", errors(arm, loaded, LOAD, slow)
    for each in (joint, planar, arm):
        yield f"`{each.name}` moving, one sample of delay", errors(each, late, PREDICTION)


def errors(
    scenario: Scenario, deviation: Draws, options: Mapping[str, Robust | None], motion: fjr.Reference | None = None
) -> Errors:
    """Return the errors of a robot with each option, from the reference; a moving single joint from 0.5 rad at rest."""
    robot, n, reference = scenario.robot, scenario.robot.n, motion or scenario.reference
    law = fjr.TrackingLaw(robot, scenario.gains, compile=True)
    q_l, dq_l = ([0.5], [0.0]) if n == 1 else reference.jets(0.0)[:2]
    x0 = robot.state(q_l, q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l)), dq_l, dq_l)
    found = {}
    for name, option in options.items():
        loop = ClosedLoop(robot, sampled_law(law, option), reference, x0, SECONDS, PERIOD)
        run = loop.recorded(deviation)[1]
        found[name] = run.x[0, :, :n] - reference.jets(run.t)[:, 0]
    return found


def robust() -> None:
    """Write the RMS of q_l - q_ld [mrad] without and with each option, and draw the errors of three cases."""
    found, rows = list(tqdm(disturbed(), desc="robust")), []
    for text, with_options in found:
        settled = (e[round(SETTLED / PERIOD) :] for e in with_options.values())
        plain, *left = (1e3 * float(np.sqrt(np.mean(e**2))) for e in settled)
        for name, rms in zip(list(with_options)[1:], left, strict=True):
            rows.append((text, number(plain, digits=2), name, number(rms, digits=2), f"{min(plain / rms, 1e6):.3g}"))
    head = ("disturbance", "error without, mrad", "option", "error with, mrad", "ratio")
    put("robust.md", "robust", markdown(head, rows))
    write_picture(PICTURE, (12.0, 3.8), partial(draw, [found[i] for i in DRAWN_CASES]))


def draw(found: Sequence[tuple[str, Errors]], figure: Figure) -> None:
    """Draw the largest error of the joints over time, with each option."""
    for ax, (text, with_options) in zip(figure.subplots(1, len(found)), found, strict=True):
        for name, e in with_options.items():
            largest = np.maximum(1e3 * np.abs(e[1:]).max(axis=1), 1e-9)
            t = PERIOD * np.arange(1, len(e), dtype=float)
            ax.semilogy(t, largest, color=OPTION_COLOURS[name], label=name, lw=1.0)
        ax.set_title(text.replace("`", ""), fontsize=9)
        ax.set_xlabel("t [s]")
        ax.set_ylim(bottom=LEAST)
        ax.legend(fontsize=8, loc="best")
    figure.axes[0].set_ylabel("largest |q_l - q_ld| [mrad]")


# Noise of arm7.

STIFFER = 7.0  # factor on K_md
DRAWN = 200  # plants


def noise(tuned: Path) -> None:
    """Write the noise that arm7 tolerates with six sets of gains; tuned: scenario of `fjr tune arm7_tune`."""
    study = planned("arm7_tune")
    robot, given = study.scenario.robot, study.scenario.gains
    softer = replace(given, Pi_m=robot.K)
    gains = {
        "scenario": given,
        "`Pi_m = K`": softer,
        f"`K_md` {STIFFER:g} times as large": replace(given, K_md=STIFFER * np.asarray(given.K_md)),
        "both": replace(softer, K_md=STIFFER * np.asarray(given.K_md)),
        "[tuning rule](../compare.md#tuning-rule)": tune(
            "v_dpbc", baseline_target(study.scenario), retune=True
        ).law.gains,
        "`fjr tune arm7_tune`": load_scenario(tuned).gains,
    }
    rows = [(name, *_noise(study, each)) for name, each in tqdm(gains.items(), desc="noise of arm7")]
    head = ("gains of arm7", "RMS error", "noise in the effort", "noise margin", "delay margin")
    put("compare.md", "noise of arm7", markdown(head, rows))


def _noise(study: Sweep, gains: fjr.Gains) -> Iterator[str]:
    """Yield error and noise in the effort over drawn plants, noise margin and delay margin of gains as text.

    The loops have no limits of position, speed and error; the efforts of the draws stay limited.
    """
    scenario, draws = study.scenario, study.draws(0, DRAWN)
    law = fjr.TrackingLaw(scenario.robot, gains)
    drawn = figures(replace(study.loop, settings=None).with_law(law).run(draws), np.ones(DRAWN, dtype=bool))
    yield f"{1e3 * np.median(drawn['rms']):.2g} mrad"
    yield f"{np.median(drawn['effort_noise']):.2g} N m"
    longer = replace(scenario_loop(scenario, law, SECONDS, settle_after=SETTLED), settings=None)
    trial = Trial(longer, motion_demand(scenario.robot, scenario.reference), draws.values["effort_limit"][0])
    yield f"{1e3 * (trial.margins(directions(['noise']))['noise up to'].level or 0.0):.2g} mrad"
    check = fjr.check(law, scenario.sample_period, scenario.loop_delay, scenario.configurations())
    yield f"{check.delay_margin:.1f} samples"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the named studies."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="+", choices=("robust", "noise"))
    parser.add_argument("--tuned", type=Path, help="scenario that `fjr tune arm7_tune` has written, for noise")
    given = parser.parse_args(arguments)
    if "noise" in given.studies and given.tuned is None:
        parser.error("noise needs --tuned")
    studies: dict[str, Callable[[], None]] = {"robust": robust, "noise": partial(noise, given.tuned)}
    for name in given.studies:
        studies[name]()


if __name__ == "__main__":
    main()
