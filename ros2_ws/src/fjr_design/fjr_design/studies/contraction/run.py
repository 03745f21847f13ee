# SPDX-License-Identifier: Apache-2.0
"""`fjr contraction`: solutions of the virtual system along a simulated or recorded run, as metrics and a figure."""

from __future__ import annotations

import json
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_design.stability.contraction import Contraction, Measured, contraction, scattered
from fjr_design.studies.contraction.picture import draw
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.run import STATES
from fjr_monitor.recording.signals import ANSWERS
from fjr_msgs_py import names
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import Result

QUIET = 2.0  # s until the progress bar appears
MISMATCH = "the plant differs from the model of the controller: x(t) jumps between samples of the virtual system\n"
ROUNDING = 1e-12  # relative to the start; smaller distances are rounding errors


@dataclass(frozen=True)
class Options:
    """duration [s]; starts: number of virtual states; spread [rad]: of their initial link positions; seed."""

    duration: float
    starts: int
    spread: float
    seed: int


def run_and_draw(
    scenario: Scenario, options: Options, folder: Path | None, output: Path, stop: threading.Event
) -> Result:
    """Run along a simulated or recorded run (its folder), write <name>.png and .json; return a summary.

    Raise FjrError, and Interrupted when `stop` is set.
    """
    measured = simulated(scenario, options.duration) if folder is None else recorded(scenario, folder, options.duration)
    found = run(scenario, measured, options, stop)
    output.mkdir(parents=True, exist_ok=True)
    picture = output / f"{scenario.name}.png"
    labels = [f"{joint} [{units.position}]" for joint, units in zip(scenario.joints, scenario.robot.units, strict=True)]
    draw(scenario.name, labels, measured, scenario.reference.jets(measured.t)[:, 0], found, picture)
    numbers = picture.with_suffix(".json")
    numbers.write_text(json.dumps(metrics(found), indent=2) + "\n", encoding="utf-8")
    warning = "" if scenario.plant_is_the_model else MISMATCH
    text = f"{summary(found, scenario.name)}\n{warning}picture and figures: {picture}, {picture.stem}.json"
    return Result(text, {"scenario": scenario.name, **metrics(found), "picture": picture, "metrics": numbers})


def simulated(scenario: Scenario, duration: float) -> Measured:
    """Simulate the scenario as its nodes do in lock-step."""
    run = scenario.simulate(duration)
    return Measured(run.t, _as_the_law_sees(scenario, run.x), run.u)


def recorded(scenario: Scenario, folder: Path, duration: float) -> Measured:
    """Read `duration` [s] of a recorded run from its first command on; a missing command repeats the last."""
    bag = read_bag(folder / "bag")
    states = bag.joints(STATES, names.state_names(scenario.joints))
    answers = bag.joints(ANSWERS, scenario.joints)
    stamp, first = np.unique(states.stamp, return_index=True)
    inside = (stamp >= answers.stamp[0]) & (stamp < answers.stamp[0] + duration * 1e9)
    stamp, rows = stamp[inside], first[inside]
    latest = np.searchsorted(answers.stamp, stamp, side="right") - 1
    n, state = scenario.robot.n, scenario.robot.state
    position, velocity = states.position[rows], states.velocity[rows]
    x = [state(q[:n], q[n:], dq[:n], dq[n:]) for q, dq in zip(position, velocity, strict=True)]
    return Measured((stamp - stamp[0]) * 1e-9, np.array(x), answers.effort[latest])


def run(scenario: Scenario, measured: Measured, options: Options, stop: threading.Event) -> Contraction:
    """Integrate the virtual solutions, with a progress bar after QUIET."""
    starts = scattered(scenario.tracking_law, measured.x[0], options.starts, options.spread, options.seed)
    inner = scenario.sample_period / int(scenario.plant_values["inner_steps"])  # type: ignore[arg-type]
    form = "{desc}: {percentage:3.0f}% |{bar}| {n:.2f}/{total:.2f} s"
    total = float(measured.t[-1] - measured.t[0])
    compiled = bool(scenario.controller_values["compile"])
    with tqdm(total=total, desc=scenario.name, bar_format=form, delay=QUIET, file=sys.stderr) as bar:

        def on_progress(done: float) -> None:
            if stop.is_set():
                raise Interrupted
            bar.update(done - bar.n)

        return contraction(scenario.tracking_law, scenario.reference, measured, starts, compiled, inner, on_progress)


def metrics(found: Contraction) -> dict[str, Any]:
    """Return the metrics of the figure."""
    relative = found.distance / found.distance[0]
    seen = relative > ROUNDING
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(seen, relative / found.bound[:, None], 0.0)
    alive = ROUNDING**2 * found.W[0] < found.W
    return {
        "beta_per_s": found.beta,
        "beta_is_proven": found.proven,
        "virtual_states": found.x_v.shape[1],
        "duration_s": float(found.t[-1] - found.t[0]),
        "largest_distance_at_start": float(found.distance[0].max()),
        "largest_distance_at_end": float(found.distance[-1].max()),
        "largest_ratio_to_bound": float(share.max()),
        "least_rate_of_contraction_per_s": float(np.nanmin(np.where(alive, found.rate, np.nan))),
        "distance_to_measured_at_end": float(found.to_measured[-1].max()),
        "residual_of_storage_balance": found.balance,
    }


def summary(found: Contraction, name: str) -> str:
    """Return the metrics as a few sentences."""
    f = metrics(found)
    basis = "proven" if f["beta_is_proven"] else "sampled along the run"
    holds = "stay below" if f["largest_ratio_to_bound"] <= 1 + 1e-6 else "LEAVE"
    return (
        f"{name}: {f['virtual_states']} virtual solutions, {f['duration_s']:g} s; their distances {holds} "
        f"exp(-beta t), beta = {at_least(f['beta_per_s'])} 1/s ({basis})\n"
        f"  largest distance {f['largest_distance_at_start']:.3g} -> {f['largest_distance_at_end']:.2g} sqrt(J), "
        f"at most {f['largest_ratio_to_bound']:.3g} times its bound\n"
        f"  exact rate of contraction at least {f['least_rate_of_contraction_per_s']:.4g} 1/s"
    )


def _as_the_law_sees(scenario: Scenario, x: Array) -> Array:
    """Return the plant states (k, 4n) with momenta of the robot model of the law."""
    if scenario.plant_is_the_model:
        return x
    n, plant, law = scenario.robot.n, scenario.plant.robot, scenario.robot
    return np.array([law.state(row[:n], row[n : 2 * n], *plant.velocities(row)) for row in x])
