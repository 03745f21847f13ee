# SPDX-License-Identifier: Apache-2.0
"""Regenerate the table of docs/tables/compare.md on the noise that arm7 tolerates, between its markers.

. ros2_ws/install/setup.sh && fjr tune arm7_tune
.venv/bin/python -m tools.noise_study runs/tuned/arm7_tune_v_dpbc/tuned.yaml
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

import fjr_core as fjr
from bench.figures import put
from fjr_core.config.scenario import load_scenario
from fjr_core.simulation.batch import ClosedLoop
from fjr_design.studies.imperfections import directions, motion_demand
from fjr_design.studies.sweep import Sweep, figures, scenario_loop
from fjr_design.studies.sweep_file import Options, planned
from fjr_design.studies.trial import Trial
from fjr_design.tuning.equal_bandwidth import baseline_target, tune

BEGIN, END = "<!-- noise of arm7: written by tools/noise_study.py -->", "<!-- end of noise of arm7 -->"
STIFFER = 7.0  # factor on K_md
DRAWN = 200  # plants
SECONDS, SETTLED = 6.0, 2.0  # of the runs of the margin, as in the tables of laws


def without_limits(loop: ClosedLoop) -> ClosedLoop:
    """Return the loop without limits of position, speed and error; the efforts of its draws stay limited."""
    return replace(loop, settings=None)


def gains_of_arm7(study: Sweep, tuned: Path) -> dict[str, fjr.Gains]:
    """Return the gains of the table by their descriptions."""
    robot, given = study.scenario.robot, study.scenario.gains
    softer = replace(given, Pi_m=robot.K)
    by_rule = tune("v_dpbc", baseline_target(study.scenario), retune=True).law.gains
    return {
        "scenario": given,
        "`Pi_m = K`": softer,
        f"`K_md` {STIFFER:g} times as large": replace(given, K_md=STIFFER * np.asarray(given.K_md)),
        "both": replace(softer, K_md=STIFFER * np.asarray(given.K_md)),
        "[tuning rule](../compare.md#tuning-rule)": by_rule.matrices,
        "`fjr tune arm7_tune`": load_scenario(tuned).gains,
    }


def row(study: Sweep, gains: fjr.Gains) -> list[str]:
    """Return error and noise in the effort over drawn plants, noise margin and delay margin of gains as text."""
    scenario = study.scenario
    law = fjr.TrackingLaw(scenario.robot, gains)
    loop = without_limits(study.loop).with_law(law)
    draws = study.draws(0, DRAWN)
    drawn = figures(loop.run(draws), np.ones(DRAWN, dtype=bool))
    longer = without_limits(scenario_loop(scenario, law, SECONDS, settle_after=SETTLED))
    trial = Trial(longer, motion_demand(scenario.robot, scenario.reference), np.asarray(draws.effort_limit)[0])
    noise = trial.margins(directions(["noise"]))["noise up to"].level or 0.0
    check = fjr.check(law, scenario.sample_period, scenario.loop_delay, scenario.configurations())
    return [
        f"{1e3 * np.median(drawn['rms']):.2g} mrad",
        f"{np.median(drawn['effort_noise']):.2g} N m",
        f"{1e3 * noise:.2g} mrad",
        f"{check.delay_margin:.1f} samples",
    ]


def table(study: Sweep, tuned: Path) -> list[str]:
    """Return the lines of the table."""
    lines = ["| gains of arm7 | RMS error | noise in the effort | noise margin | delay margin |", "| --- " * 5 + "|"]
    for name, gains in tqdm(gains_of_arm7(study, tuned).items(), desc="noise of arm7"):
        lines.append(f"| {' | '.join([name, *row(study, gains)])} |")
    return lines


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute the table and write it into the page."""
    parser = argparse.ArgumentParser(description="Write the table of the noise of arm7 into docs/tables/compare.md.")
    parser.add_argument("tuned", type=Path, help="tuned.yaml that `fjr tune arm7_tune` has written")
    tuned = parser.parse_args(arguments).tuned
    study = planned("arm7_tune", Options(1, None, Path(), {}, {}))
    put(table(study, tuned), "compare.md", BEGIN, END)


if __name__ == "__main__":
    main()
