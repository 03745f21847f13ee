# SPDX-License-Identifier: Apache-2.0
"""Identification of elastic joints against mujoco.sysid, and time and memory of `fjr identify` for a minute.

Both start from the same simulated records with encoder noise and the same wrong stiffness and rotor inertia, and
estimate these and the damping of both sides. MuJoCo gets true initial states, and the likelihood of its intervals is
exact: the record has white noise and no delay. Records of seven joints are cut into pieces for it: from one rollout of
a second, 100 iterations do not reach the minimum.

The minute is a run of seven joints in lock-step on the motion that `fjr excite` designs; stiffness and rotor inertia in
the robot file are wrong. The intervals of the stiffness are compared with those from the scenario's own motion.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from io import StringIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from absl import logging
from mujoco import sysid

from bench.arm import JOINT, arm7, mujoco_spec
from bench.figures import Figure
from bench.nodes import Used, used
from fjr_core.config.scenario import Scenario
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_engines.mjcf.writing import MOTOR, SPRING
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.motion_record import MotionRecord
from fjr_identification.estimation.parameters import SMOOTHING, IdentifyOptions, prior_of
from fjr_msgs_py.scenarios import library

NAMES = ("joint_stiffness", "motor_inertia", "link_damping", "motor_damping")
CHANGES = (*NAMES, "link_coulomb_friction", "motor_coulomb_friction")
"""The parameters that MuJoCo's model can be given."""
WRONG = {"joint_stiffness": 1.3, "motor_inertia": 0.8, "link_damping": 0.5, "motor_damping": 2.0}  # times the truth
LARGEST = 5.0  # factor of a parameter that MuJoCo may try, and its inverse
NOISE = 1e-5  # rad
DURATION, PIECE = 5.0, 0.1  # s; of a record of seven joints, and of its pieces
MINUTE, SHORT = 60.0, 10.0  # s
LONGEST = 60.0  # s, on two cores


@dataclass(frozen=True, eq=False)
class Estimated:
    """Values, low and high ends of 95 % intervals (names, n) in the order of a case, and the processor time [s]."""

    values: Array
    low: Array
    high: Array
    seconds: float


@dataclass(frozen=True, eq=False)
class Case:
    """A simulated record and the robot.

    motion: true positions and velocities (k, 4n). truth, start: parameters (n,) by name, as they are and as both first
    believe them.
    """

    robot: Robot
    record: MotionRecord
    motion: Array
    truth: Mapping[str, Array]
    start: Mapping[str, Array]


def case_of(scenario: Scenario, duration: float, seed: int) -> Case:
    """Return a case of `duration` seconds with white noise on all encoders."""
    robot, n, run = scenario.robot, scenario.robot.n, scenario.simulate(duration)
    k = len(run.u)
    motion = np.array([np.concatenate([x[: 2 * n], *robot.velocities(x)]) for x in run.x[:k]])
    q = motion[:, : 2 * n] + NOISE * np.random.default_rng(seed).standard_normal((k, 2 * n))
    unmeasured, dt = np.full((k, n), np.nan), scenario.sample_period
    record = MotionRecord(scenario.name, scenario.joints, dt, run.u, q[:, :n], q[:, n:], unmeasured)
    truth = true_values(robot)
    start = {name: WRONG[name] * value for name, value in truth.items()}
    return Case(robot, record, motion, truth, start)


def true_values(robot: Robot) -> dict[str, Array]:
    """Return the true parameters (n,) of NAMES."""
    return dict(zip(NAMES, map(np.diag, (robot.K, robot.M_m, robot.D_l, robot.D_m)), strict=True))


def ours(case: Case) -> Estimated:
    """Estimate by this project."""
    prior = prior_of(case.robot, case.start)
    began = time.process_time()
    found = identify([case.record], case.robot, prior, IdentifyOptions(free=NAMES))
    seconds = time.process_time() - began
    ends = np.array([[each.value, each.low, each.high] for each in found.estimates])
    values, low, high = ends.T.reshape(3, len(NAMES), -1)
    return Estimated(values, low, high, seconds)


def theirs(case: Case, pieces: int = 1, substeps: int = 1) -> Estimated:
    """Estimate by mujoco.sysid with its defaults; each parameter is a factor of its start.

    pieces: of the record, each of which is simulated from its true initial state. substeps: of a sample period.
    """
    n = case.robot.n
    on = ["ACTUATION", *(("CONSTRAINT", "FRICTIONLOSS") if any("friction" in name for name in case.truth) else ())]
    logging.set_verbosity(logging.ERROR)  # it warns of each piece that the model has no sensors
    spec = mujoco_spec(case.robot, case.record.dt / substeps, on)
    model = spec.compile()
    began = time.process_time()
    sequences = [_sequences(case, spec, model, pieces, substeps)]
    observed = [(name, kind) for name, (kind, _) in _positions(model, n).items()]
    residual = sysid.build_residual_fn(models_sequences=sequences, enabled_observations=observed)
    with redirect_stdout(StringIO()):
        found, result = sysid.optimize(_factors(case), residual, verbose=False)
    at_end, _, _ = residual(result.x, found)
    half = sysid.calculate_intervals(at_end, result.jac)[1]
    seconds = time.process_time() - began
    values, half = (np.reshape(each, (-1, n)) * list(case.start.values()) for each in (result.x, half))
    return Estimated(values, values - half, values + half, seconds)


def _sequences(case: Case, spec: Any, model: Any, pieces: int, substeps: int) -> Any:
    """Return the pieces of the record with their true initial states."""
    record, n = case.record, case.robot.n
    edges = np.round(np.linspace(0, len(record.u) - 1, pieces + 1)).astype(int)
    states, controls, observed = [], [], []
    for first, last in pairwise(edges):
        piece, t = slice(first, last + 1), record.dt * np.arange(last + 1 - first)
        x, q = case.motion[first], np.hstack([record.q_l[piece], record.q_m[piece]])
        states.append(sysid.create_initial_state(model, x[: 2 * n], x[2 * n :]))
        held = np.repeat(record.u[piece], substeps, axis=0)[: (len(t) - 1) * substeps + 1]
        controls.append(sysid.TimeSeries(np.linspace(0.0, t[-1], len(held)), held))
        observed.append(sysid.TimeSeries(t, q, _positions(model, n)))
    names = [f"piece {k}" for k in range(pieces)]
    return sysid.ModelSequences("arm", spec, names, states, controls, observed, allow_missing_sensors=True)


def _positions(model: Any, n: int) -> dict[str, Any]:
    """Return the mapping of all joint positions to the columns of a table."""
    mapping = sysid.TimeSeries.compute_all_state_mappings(model)[0]
    names = [f"{JOINT.format(i)}{side}_qpos" for side in ("", MOTOR) for i in range(n)]
    return {name: (mapping[name][0], np.array([column])) for column, name in enumerate(names)}


def _factors(case: Case) -> Any:
    """Return the parameters of mujoco.sysid, each with its change of the model."""
    parameters = sysid.ParameterDict()
    for name, starts in case.start.items():
        for i, start in enumerate(starts):
            change = partial(_change, name, i, float(start))
            parameters.add(sysid.Parameter(f"{name} {i}", 1.0, 1 / LARGEST, LARGEST, modifier=change))
    return parameters


def _change(name: str, i: int, start: float, spec: Any, parameter: Any) -> None:
    """Give the i-th joint of a model a parameter, a factor of its start; springs and dampers are polynomials there.

    The creep of dry friction ends within the shortest time constant that the solver takes, two steps.
    """
    value, joint = start * parameter.value[0], JOINT.format(i)
    if name == "joint_stiffness":
        spec.tendon(joint + SPRING).stiffness = np.array([value, 0.0, 0.0])
    elif name == "motor_inertia":
        spec.joint(joint + MOTOR).armature = value
    else:
        side = spec.joint(joint if name.startswith("link") else joint + MOTOR)
        if name.endswith("damping"):
            side.damping = np.array([value, 0.0, 0.0])
        else:
            side.frictionloss, side.solref_friction[0] = value, 2 * spec.option.timestep


def figures(label: str, cases: Sequence[Case], pieces: int = 1) -> list[Figure]:
    """Return the error of K, the coverage of all parameters, and processor time, of both on the same records."""
    ours(cases[0])  # compiled
    found = {"ours": [ours(each) for each in cases], "sysid": [theirs(each, pieces) for each in cases]}
    truth = np.array(list(cases[0].truth.values()))
    error, inside, seconds = {}, {}, {}
    for name, each in found.items():
        error[f"{name} [%]"] = 100 * float(np.median([np.abs(e.values / truth - 1)[0] for e in each]))
        inside[f"{name} [%]"] = 100 * float(np.mean([(e.low <= truth) & (truth <= e.high) for e in each]))
        seconds[f"{name} [s]"] = float(np.median([e.seconds for e in each]))
    relative = seconds["ours [s]"] / seconds["sysid [s]"]
    return [
        Figure(f"error of the stiffness, {label}, median", error["ours [%]"], "%", parts=error),
        Figure(f"95 % intervals with the truth, {label}", inside["ours [%]"], "%", parts=inside),
        Figure(f"identification, {label}, processor time relative to mujoco.sysid", relative, "", parts=seconds),
    ]


def against_mujoco(records: int = 20, of_seven: int = 2) -> list[Figure]:
    """Compare on records of the paper's joint, and on records of the seven-joint arm."""
    joint, arm = library.load("paper_k31"), arm7()
    single = [case_of(joint, 1.0, seed) for seed in range(records)]
    seven = [case_of(arm, DURATION, seed) for seed in range(of_seven)]
    found = figures(f"one joint, {records} records of 1 s", single)
    pieces = round(DURATION / PIECE)
    return found + (figures(f"seven joints, {of_seven} records of {DURATION:g} s", seven, pieces) if seven else [])


def of_a_minute(duration: float = MINUTE) -> list[Figure]:
    """Measure the command on a record of `duration` [s], and count the intervals that contain the truth."""
    with tempfile.TemporaryDirectory() as name:
        run = _recorded(Path(name), _excited(Path(name), duration), duration)
        found, estimates = _identified(Path(name), run)
    truth, joints = true_values(arm7().robot), arm7().joints
    known = {(name, joint): value for name in truth for joint, value in zip(joints, truth[name], strict=True)}
    inside = [  # the arm has none of the other parameters, and no friction that turns over
        each["low"] <= known.get((each["name"], each["joint"]), 0.0) <= each["high"]
        for each in estimates
        if each["name"] != SMOOTHING
    ]
    label = f"{duration:g} s of seven joints"
    bound = LONGEST if duration == MINUTE else None
    parts = {"processor [s]": found.processor, "memory [MB]": found.memory}
    return [
        Figure(f"fjr identify, {label}", found.seconds, "s", bound=bound, parts=parts),
        Figure(f"95 % intervals with the truth, {label}", 100 * sum(inside) / len(inside), "%"),
    ]


def of_designed_motion(duration: float = SHORT) -> list[Figure]:
    """Compare the intervals of the stiffness from the scenario's motion with those from the designed one."""
    with tempfile.TemporaryDirectory() as name:
        motions = "arm7", _excited(Path(name), duration)
        runs = [_recorded(Path(name), motion, duration) for motion in motions]
        before, after = (
            np.array([e["high"] - e["low"] for e in _identified(Path(name), run)[1] if e["name"] == "joint_stiffness"])
            for run in runs
        )
    parts = {"least": float(min(before / after)), "most": float(max(before / after))}
    name = f"intervals of the stiffness over those of the designed motion, {duration:g} s, median"
    return [Figure(name, float(np.median(before / after)), "", parts=parts)]


def _excited(folder: Path, duration: float) -> str:
    """Return the scenario with the motion that `fjr excite` designs for `arm7`."""
    excited = str(folder / "excited.yaml")
    used("fjr", "excite", "arm7", "--duration", f"{min(duration, 20.0):g}", "--output", excited)
    return excited


def _recorded(folder: Path, scenario: str, duration: float) -> str:
    """Return the folder of a run with encoder noise."""
    noise = [f"imperfections.{side}_position_noise:={[NOISE] * 7}" for side in ("link", "motor")]
    changes = [argument for each in noise for argument in ("--set", each)]
    run = ["--lockstep", "--no-report", "--duration", f"{duration:g}", "--output", str(folder / "runs")]
    used("fjr", "run", scenario, *run, *changes)
    return str(folder / "runs" / Path(scenario).stem)


def _identified(folder: Path, run: str) -> tuple[Used, list[dict[str, Any]]]:
    """Identify a run from a robot file with wrong values; return what the command used, and its estimates."""
    truth = true_values(arm7().robot)
    guess = {name: (WRONG[name] * truth[name]).tolist() for name in ("joint_stiffness", "motor_inertia")}
    document = {"file": "package://fjr_bringup/robots/arm7.yaml", **guess}
    file, output = folder / "guessed.yaml", folder / "identified" / Path(run).name
    file.write_text(yaml.safe_dump({"/**": {"ros__parameters": {"robot": document}}}), encoding="utf-8")
    found = used("fjr", "identify", run, "--robot", str(file), "--output", str(output))
    return found, json.loads((output / "identification.json").read_text(encoding="utf-8"))["estimates"]
