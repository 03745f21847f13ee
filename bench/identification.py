# SPDX-License-Identifier: Apache-2.0
"""Coverage of the intervals of `fjr identify`: random arms and records, identified, compared with the truth.

    python -m bench.identification --cases 30 --joints 1 2 3 4 5 6 7 --measured both --out coverage

A case draws an arm, its springs and friction, noise and steps of the encoders, skews and a delay of the effort. Its
record follows a multi-sine by PD control. Each case is a file of the folder; the same command goes on with the missing
ones, and prints the tables of all. A study of an hour for many joints: no part of `make bench`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest
from tqdm import tqdm

import fjr_identification
from bench.figures import kept, markdown
from fjr_core.errors import FjrError
from fjr_core.model.newton_euler import serial_chain
from fjr_core.model.rigid_arm import Body
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import program_digest
from fjr_design.uncertainty.posterior import LOG, UNKNOWN, Identification
from fjr_identification.estimation.elastic_arm import ElasticArm
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.motion_record import SIGNALS, MotionRecord
from fjr_identification.estimation.multiple_shooting import SKEWS
from fjr_identification.estimation.parameters import (
    KINDS,
    SMOOTHING,
    STRIBECK,
    USUAL_SMOOTHING,
    USUAL_STRIBECK,
    IdentifyOptions,
    Prior,
    prior_of,
    size,
)
from fjr_identification.estimation.shooting import HeldEffort, Shooting

Row = dict[str, Any]
Key = tuple[str, int, int]
"""Kind of measurement, number of joints, and seed of a case."""
CODE = program_digest(*(Path(name).parent for name in (fjr_identification.__file__, __file__)))
"""Of estimator and cases: results of each are in a folder of their own."""
FIRST = 1000
"""First seed, so that no case is one by which the estimator was made."""
FINE = 1e-4  # s; step of the simulation, and grain of skews and delays
ARMS = 3  # different arms of each number of joints; their equations are compiled once
MEASURED = {
    "both": ("q_l", "q_m"),
    "motor": ("q_m",),
    "motor-torque": ("q_m", "torque"),
    "link-torque": ("q_l", "torque"),
}
"""Signals of a record by kind of measurement."""
SENSOR = 1e-3  # of the torque's root mean square; least noise and steps of a torque sensor


@dataclass(frozen=True, eq=False)
class Case:
    """A record with the robot and the prior that the estimator is given, and the true parameters by name."""

    record: MotionRecord
    robot: Robot
    prior: Prior
    truth: Mapping[str, Array]


@cache
def arm(n: int, number: int) -> Robot:
    """Return a random serial arm of n joints with unit springs, motors and no damping."""
    rng = np.random.default_rng([n, number])
    bodies = [_body(rng, i) for i in range(n)]
    one, none = np.eye(n), np.zeros((n, n))
    return Robot(serial_chain(bodies), M_m=one, K=one, D_l=none, D_m=none, B_m=one)


def _body(rng: np.random.Generator, i: int) -> Body:
    length, mass = rng.uniform(0.2, 0.4), rng.uniform(2, 6) * 0.75**i
    axis = np.eye(3)[(0, 1, 2, 1)[i % 4] if i else rng.integers(3)]
    inertia = mass * length**2 / 12 * np.diag(rng.uniform(0.5, 1.5, 3))
    com = np.array([rng.uniform(-0.03, 0.03), rng.uniform(-0.03, 0.03), length / 2])
    return Body(np.eye(3), np.array([0, 0, 0.35 * (i > 0)]), axis, mass, com, inertia + 0.01 * mass * np.eye(3) * 0.3)


def draw(n: int, seed: int, duration: float | None = None, measured: str = "both") -> Case:
    """Return a random case of n joints with one kind of measurement; times count from the motor's, or else the link's.

    Cases of the same n and seed have the same arm, friction and reference.
    """
    rng = np.random.default_rng([n, seed, 1])
    robot = arm(n, seed % ARMS)
    truth = _true_parameters(rng, robot)
    signals = MEASURED[measured]
    truth |= {} if "q_m" in signals else {"link_skew": np.zeros(n)}
    if "torque" in signals:
        truth["torque_skew"] = np.round(np.random.default_rng([n, seed, 2]).uniform(-4e-3, 4e-3, n) / FINE) * FINE
    whole = _record(rng, robot, truth, duration or rng.uniform(8, 16))
    unmeasured: dict[str, Any] = {name: np.full_like(whole.u, np.nan) for name in SIGNALS if name not in signals}
    record = replace(whole, **unmeasured)
    spread = {"joint_stiffness": 0.5, "motor_inertia": 0.3}
    guess = {name: truth[name] * np.exp(sd * rng.standard_normal(n)) for name, sd in spread.items()}
    return Case(record, robot, prior_of(robot, guess), truth)


def _true_parameters(rng: np.random.Generator, robot: Robot) -> dict[str, Array]:
    n = robot.n
    where = rng.uniform(-1, 1, (20, n))
    free = np.mean([1 / np.diag(np.linalg.inv(robot.M_l(q))) for q in where], axis=0)
    torque = np.max([np.abs(robot.grad_P_l(q)) for q in where], axis=0) + 10 * free
    K, B = free * (2 * np.pi * rng.uniform(7, 18, n)) ** 2, free * rng.uniform(0.4, 2.5, n)
    damping = 2 * np.sqrt(K * B)
    found: dict[str, Array] = {name: np.zeros(size(name, n)) for name in KINDS}
    found |= {"joint_stiffness": K, "motor_inertia": B}
    found |= {name: damping * rng.uniform(0.004, 0.04, n) for name in ("link_damping", "motor_damping")}
    found |= {f"{side}_coulomb_friction": torque * rng.uniform(0, 0.05, n) for side in ("link", "motor")}
    found[SMOOTHING], found[STRIBECK] = np.full(n, USUAL_SMOOTHING), np.full(n, USUAL_STRIBECK)
    found["offset"] = rng.uniform(-5e-3, 5e-3, n)
    found["link_skew"] = np.round(rng.uniform(-4e-3, 4e-3, n) / FINE) * FINE
    found["effort_delay"] = np.full(n, np.round(rng.uniform(0, 4e-3) / FINE) * FINE)
    return found


def _record(rng: np.random.Generator, robot: Robot, truth: Mapping[str, Array], duration: float) -> MotionRecord:
    n, dt = robot.n, float(rng.choice([1e-3, 1e-3, 2e-3]))
    fine, samples = round(dt / FINE), round(duration / dt)
    step = Shooting(ElasticArm(robot, ()), ())
    p = {**truth, "effort_delay": np.zeros(n)}  # the efforts are delayed here
    reference = _reference(rng, n, dt * np.arange(samples, dtype=float))
    q = reference[0]  # at rest
    x = np.concatenate([q, q + robot.grad_P_l(q) / truth["joint_stiffness"] + truth["offset"], np.zeros(2 * n)])
    late = round(float(truth["effort_delay"][0]) / FINE)
    noise = rng.uniform(2e-6, 3e-5, (2, n))
    states, efforts, sent = [x[None]], [], [robot.grad_P_l(x[:n])] * (late // fine + 2)
    none = np.zeros(2 * n)
    gain = truth["motor_inertia"] * (2 * np.pi * 2.5) ** 2
    for k in range(samples):
        q, v = x[n : 2 * n] + noise[1] * rng.standard_normal(n), x[3 * n :]
        u = gain * (reference[k] - q) - 1.0 * np.sqrt(gain * truth["motor_inertia"]) * v + robot.grad_P_l(reference[k])
        sent.append(u + 0.05 * np.abs(gain) * rng.standard_normal(n) * 0.1)
        efforts.append(sent[-1])
        ages = [(late - i + fine - 1) // fine if late > i else 0 for i in range(fine)]
        held = HeldEffort(np.array([sent[-1 - age] for age in ages]), FINE, 1, none, none)
        found = step(x, held, 0, fine, p)
        assert found is not None
        states.append(found[0][1:])
        x = found[0][-1]
    return _measured(rng, np.vstack(states), np.array(efforts), truth, dt, noise)


def _measured(
    rng: np.random.Generator, x: Array, u: Array, truth: Mapping[str, Array], dt: float, noise: Array
) -> MotionRecord:
    n, k, fine = u.shape[1], len(u), round(dt / FINE)
    at = np.arange(k)[:, None] * fine
    read = {name: np.clip(at + np.round(truth[name] / FINE).astype(int), 0, len(x) - 1) for name in SKEWS.values()}
    link, motor = x[read["link_skew"], np.arange(n)], x[at, n + np.arange(n)]
    deflection = (x[:, n : 2 * n] - x[:, :n])[read["torque_skew"], np.arange(n)] - truth["offset"]
    bits = 2 * np.pi / 2.0 ** rng.integers(18, 23, n)
    q_l, q_m = (q + s * rng.standard_normal(q.shape) for q, s in zip((link, motor), noise, strict=True))
    joints = tuple(f"joint{j + 1}" for j in range(n))
    torque = truth["joint_stiffness"] * deflection
    step = SENSOR * rng.uniform(1, 4, n) * np.sqrt(np.mean(torque**2, axis=0))
    torque = step * np.round(torque / step + rng.standard_normal(torque.shape))
    return MotionRecord("simulated", joints, dt, u, bits * np.round(q_l / bits), q_m, torque)


def _reference(rng: np.random.Generator, n: int, t: Array) -> Array:
    """Return a multi-sine (k, n) of 0.1 to 3 Hz about a random pose."""
    f = np.array([0.13, 0.31, 0.73, 1.6, 3.1])
    amplitude = np.array([0.4, 0.3, 0.15, 0.06, 0.02]) * rng.uniform(0.5, 1.2, (n, 1))
    phase = rng.uniform(0, 2 * np.pi, (n, 5))
    waves = np.sin(2 * np.pi * f * t[:, None, None] + phase)
    return rng.uniform(-0.6, 0.6, n) + np.sum(amplitude * waves, axis=2)


def identified(key: Key) -> Row:
    """Identify a case; return its estimates beside the truth, or why it was refused."""
    measured, n, seed = key
    case, began = draw(n, seed, measured=measured), time.perf_counter()
    line: Row = {"measured": measured, "joints": n, "seed": seed}
    try:
        rows = compared(case, identify([case.record], case.robot, case.prior, IdentifyOptions(threads=1)))
    except FjrError as error:
        return {**line, "error": str(error), "rows": []}
    return {**line, "seconds": round(time.perf_counter() - began, 2), "rows": rows}


def compared(case: Case, found: Identification) -> list[Row]:
    """Return for each parameter whether its interval contains the truth; score: its error in standard deviations."""
    rows = []
    posterior = dict(zip(found.free, zip(found.mean, np.sqrt(np.diag(found.covariance)), strict=True), strict=True))
    for k, each in enumerate(found.estimates):
        true = float(case.truth[each.name][found.joints.index(each.joint)])
        z, sd = posterior.get(k, (np.nan, np.nan))
        rows.append(
            {
                "name": each.name,
                "joint": each.joint,
                "verdict": each.verdict,
                "inside": bool(each.low <= true <= each.high),
                "score": float((z - (np.log(true) if KINDS[each.name].coordinate == LOG else true)) / sd),
                "error": abs(each.value / true - 1) if true else float("nan"),
            }
        )
    return rows


def table(rows: Sequence[Row]) -> list[str]:
    """Return a Markdown table with one line for each kind of parameter; behind the share, its 95 % Wilson interval."""
    cells = []
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        known = [row for row in own if row["verdict"] != UNKNOWN]
        share, error = "", ""
        if known:
            test = binomtest(sum(row["inside"] for row in known), len(known))
            low, high = test.proportion_ci(method="wilson")
            share = f"{test.statistic:.1%} ({100 * low:.1f} to {100 * high:.1f})"
            error = f"{np.nanmedian([row['error'] for row in known]):.2%}"
        cells.append((name.replace("_", " "), str(len(known)), share, str(len(own) - len(known)), error))
    head = ("parameter", "intervals", "inside", "not identifiable", "median error")
    return markdown(head, cells, right=head[1:])


def report(lines: Sequence[Row]) -> Iterable[str]:
    """Return the table of each kind of measurement, below what it consists of."""
    for measured in dict.fromkeys(line["measured"] for line in lines):
        own = [line for line in lines if line["measured"] == measured]
        numbers = {n: sum(line["joints"] == n for line in own) for n in sorted({line["joints"] for line in own})}
        refused = sum("error" in line for line in own)
        shares = ", ".join(f"{count} of {n}" for n, count in numbers.items())
        yield f"\n{measured}: {len(own)} records (joints: {shares}), {refused} refused\n"
        yield from table([row for line in own for row in line["rows"]])
        known = [row for line in own for row in line["rows"] if row["verdict"] != UNKNOWN]
        largest = max((abs(row["score"]) for row in known), default=0.0)
        times = {n: [line["seconds"] for line in own if line["joints"] == n and "seconds" in line] for n in numbers}
        medians = ", ".join(f"{np.median(each):.1f} s ({n})" for n, each in times.items() if each)
        longest = max((each for own in times.values() for each in own), default=0.0)
        yield f"\nlargest error: {largest:.1f} standard deviations"
        yield f"median time (joints): {medians}; longest: {longest:.0f} s"


def main() -> None:
    """Run what is missing of the study, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=30, help="of each number of joints and kind of measurement")
    parser.add_argument("--joints", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6, 7])
    parser.add_argument("--measured", choices=MEASURED, nargs="+", default=["both"])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("coverage"))
    options = parser.parse_args()
    folder = options.out / CODE[:12]
    keys = list(product(options.measured, options.joints, range(FIRST, FIRST + options.cases)))
    with Pool(options.processes) as pool:
        for _ in tqdm(pool.imap_unordered(partial(_kept, folder), keys), total=len(keys)):
            pass
    lines = [json.loads(file.read_text(encoding="utf-8")) for file in sorted(folder.glob("*.json"))]
    print("\n".join(report(lines)))


def _kept(folder: Path, key: Key) -> Row:
    found: Row = kept(folder / "{}-{}-{}.json".format(*key), lambda: identified(key))
    return found


if __name__ == "__main__":
    main()
