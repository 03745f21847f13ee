# SPDX-License-Identifier: Apache-2.0
"""`fjr contraction`: solutions of the virtual system along a simulated or recorded run, as metrics and a figure.

The figure shows converging solutions, distances, differential storage and its rate.
"""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from tqdm import tqdm

from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import at_least
from fjr_design.stability.contraction import Contraction, Measured, contraction, scattered
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.recording.run import STATES
from fjr_monitor.recording.signals import ANSWERS
from fjr_monitor.report.picture import COLOURS, GREY, STYLE
from fjr_msgs_py import names
from fjr_msgs_py.console.ending import Interrupted
from fjr_msgs_py.console.output import Result

QUIET = 2.0  # s until the progress bar appears
MISMATCH = "the plant differs from the model of the controller: x(t) jumps between samples of the virtual system\n"
ROUNDING = 1e-12  # relative to the start; smaller distances are rounding errors

SHOWN = 3  # joints
FLOOR = 1e-12  # relative to the start; rounding level of a distance
BOUND = COLOURS[1]
PALETTE = COLOURS[:6]  # black is the measured trajectory


@dataclass(frozen=True)
class ContractionOptions:
    """duration [s]; starts: number of virtual states; spread [rad]: of their initial link positions; seed."""

    duration: float
    starts: int
    spread: float
    seed: int


def run_and_draw(
    scenario: Scenario, options: ContractionOptions, folder: Path | None, output: Path, stop: threading.Event
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


def run(scenario: Scenario, measured: Measured, options: ContractionOptions, stop: threading.Event) -> Contraction:
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


def draw(name: str, joints: Sequence[str], measured: Measured, q_ld: Array, found: Contraction, path: Path) -> None:
    """Write the figure. joints: names with units; q_ld (k, n): reference at the measured instants."""
    shown = min(len(joints), SHOWN)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 7.4), layout="constrained")
        left, right = figure.subfigures(1, 2, width_ratios=(1.0, 1.0))
        for j, ax in enumerate(np.atleast_1d(left.subplots(shown, 1, sharex=True))):
            _positions(ax, joints[j], measured.x[:, j], q_ld[:, j], found.t, found.x_v[:, :, j])
            ax.set_xlabel("t [s]" if j == shown - 1 else "")
        part = "" if shown == len(joints) else f" (first {shown} of {len(joints)} joints)"
        np.atleast_1d(left.axes)[0].set_title(f"{found.x_v.shape[1]} virtual solutions meet the measured one{part}")
        above, middle, below = right.subplots(3, 1, sharex=True, height_ratios=(3, 3, 2))
        _distances(above, found)
        _storage(middle, found)
        _rates(below, found)
        title = f"{name}: the virtual system contracts along the measured trajectory"
        figure.suptitle(title, fontsize=13, x=0.01, ha="left")
        figure.savefig(path)


def _positions(ax: Axes, joint: str, q_l: Array, q_ld: Array, t: Array, q_lv: Array) -> None:
    for i in range(q_lv.shape[1]):
        label = "virtual $q_{lv}$" if i == 0 else None
        ax.plot(t, q_lv[:, i], color=PALETTE[i % len(PALETTE)], lw=1.0, alpha=0.9, label=label)
        ax.plot(t[0], q_lv[0, i], "o", color=PALETTE[i % len(PALETTE)], ms=3.5)
    ax.plot(t, q_ld, color=GREY, lw=3.2, alpha=0.35, label="reference $q_{ld}$", zorder=1)
    ax.plot(t, q_l, color="black", lw=1.8, ls=(0, (4, 2)), label="measured $q_l$", zorder=5)
    ax.set_ylabel(joint)
    ax.legend(loc="lower right", fontsize=8, frameon=False)


def _distances(ax: Axes, found: Contraction) -> None:
    relative = found.distance / found.distance[0]
    for pair in relative.T:
        ax.semilogy(found.t, np.where(pair > FLOOR, pair, np.nan), color=COLOURS[0], lw=0.8, alpha=0.6)
    text = f"$e^{{-\\beta t}}$, $\\beta$ = {at_least(found.beta, 3)} 1/s"
    _bound(ax, found.t, found.bound, text, max(FLOOR, relative.min() / 10))
    ax.set(title="Distance of each pair in the metric P, relative to the start", ylabel="$d(t)/d(0)$")


def _storage(ax: Axes, found: Contraction) -> None:
    relative = found.W / found.W[0]
    for one in relative.T:
        ax.semilogy(found.t, np.where(one > FLOOR**2, one, np.nan), color=COLOURS[2], lw=0.8, alpha=0.8)
    _bound(ax, found.t, found.bound**2, "$e^{-2\\beta t}$", max(FLOOR**2, relative.min() / 10))
    ax.set(title="Differential storage $W = \\delta e' P\\, \\delta e/2$ of the prolonged system", ylabel="$W(t)/W(0)$")


def _rates(ax: Axes, found: Contraction) -> None:
    rates = np.where(FLOOR**2 * found.W[0] < found.W, found.rate, np.nan)
    for one in rates.T:
        ax.plot(found.t, one, color=COLOURS[2], lw=0.8, alpha=0.8)
    ax.axhline(found.beta, color=BOUND, lw=1.6, ls="--")
    basis = "proven" if found.proven else "sampled"
    ax.annotate(
        f"$\\beta$ = {at_least(found.beta, 3)} 1/s, {basis}",
        (found.t[-1], found.beta),
        (0, -5),
        textcoords="offset points",
        ha="right",
        va="top",
        color=BOUND,
    )
    top = float(np.nanpercentile(rates, 99)) if np.isfinite(rates).any() else found.beta
    ax.set(title="Its exact rate: never below $\\beta$", xlabel="t [s]", ylabel="$-\\dot W/2W$ [1/s]")
    ax.set_ylim(0.0, 1.15 * max(top, found.beta))


def _bound(ax: Axes, t: Array, bound: Array, text: str, floor: float) -> None:
    shown = np.where(bound > floor, bound, np.nan)
    ax.semilogy(t, shown, color=BOUND, lw=1.8, ls="--")
    at = int(0.3 * np.count_nonzero(np.isfinite(shown)))
    ax.annotate(text, (t[at], bound[at]), (8, 4), textcoords="offset points", color=BOUND)
    ax.set_ylim(floor, 3.0)
