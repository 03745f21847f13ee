# SPDX-License-Identifier: Apache-2.0
"""Walls at random places of a motion, a face across the way of a link, and what the report of a run at one says."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from diagnosis_benchmark.lock_step import LockStepLoop, write_bag
from fjr_core.config.scenario import Scenario
from fjr_core.errors import ParameterError
from fjr_engines.drawing import DrawnArm
from fjr_monitor.diagnosis.verdict import EXTERNAL
from fjr_monitor.recording.bag import read_bag
from fjr_monitor.report.write import report_bag
from fjr_msgs_py.scenarios import library
from fjr_plant.lock_step import START

Array = NDArray[Any]
SCENARIO = "arm7_contact"
DURATION = 3.0  # s
BEGIN, END = 0.5, 2.5  # s; when the wall would be passed
TILT = 0.5  # of the normal, relative to the direction of motion
SLOW = 0.1  # m/s; slower places meet no wall
SIDE = 0.5  # m
LOADED, UNLOADED = 0.1, 0.025  # of the largest torque on a joint; between both, a joint may be named


@cache
def unchanged() -> Scenario:
    """Return the scenario."""
    return loaded({})


def loaded(changes: Mapping[str, Any]) -> Scenario:
    """Return the scenario with changed parameters, in lock-step."""
    return library.as_run(library.find(SCENARIO), {"lockstep": True, **changes})[1]


def random_walls(count: int, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the parameters of walls that the arm meets, outside the arm at the start."""
    rng, loop = np.random.default_rng(seed), LockStepLoop(loaded({"obstacle.present": False})).run(END)
    free = loop.record().position[:, : loop.scenario.robot.n]
    while count:
        wall = _wall(rng, free)
        if wall is not None:
            count -= 1
            yield wall


def _wall(rng: np.random.Generator, free: Array) -> dict[str, Any] | None:
    """Return a wall across the way of a link at a time of the free motion (k, n); None where it would not be met."""
    arm, k = drawn_arm(), int(rng.uniform(BEGIN, END) * 1e3)
    geom = int(rng.choice(np.flatnonzero(arm.model.geom_type == mujoco.mjtGeom.mjGEOM_CYLINDER)))
    arm.pose(free[k - 1], free[k - 1])
    before = arm.data.geom_xpos[geom].copy()
    arm.pose(free[k], free[k])
    place, axes = arm.data.geom_xpos[geom], arm.data.geom_xmat[geom].reshape(3, 3)
    velocity = (place - before) * 1e3
    if np.linalg.norm(velocity) < SLOW:
        return None
    d = velocity / np.linalg.norm(velocity) + TILT * rng.uniform(-1, 1, 3)
    d /= np.linalg.norm(d)
    wall = {
        "obstacle.position": (place + axes @ support(arm.model.geom_size[geom], d @ axes)).tolist(),
        "obstacle.normal": (-d).tolist(),
        "obstacle.size": [SIDE, SIDE, 0.1],
    }
    try:
        LockStepLoop(loaded(wall))
    except ParameterError:  # the wall is inside the arm
        return None
    return wall


@cache
def drawn_arm() -> DrawnArm:
    """Return the arm of the scenario, whose links are cylinders."""
    return DrawnArm(unchanged())


def support(size: Array, d: Array) -> Array:
    """Return the farthest point (3,) of a cylinder of size (radius, half its length) in a direction, in its frame."""
    return np.append(size[0] * d[:2] / np.linalg.norm(d[:2]), size[1] * np.sign(d[2]))


@dataclass(frozen=True)
class Met:
    """What a run at a wall showed. right: whether the named joints are those that the simulator loads.

    begins_s [s]: of the contact, in the simulator. force, own_force [N]: largest, as reported. beyond: efforts above a
    limit. finite: whether all values are. external: whether the verdict is external torque.
    """

    begins_s: float
    stopped: bool
    external: bool
    right: bool
    joints: str
    force: float
    own_force: float
    beyond: int
    finite: bool


def met(wall: Mapping[str, Any], folder: Path) -> Met:
    """Run the arm at a wall in lock-step, report its bag, and compare the report with the simulator's torques.

    Joints are right if each is named whose torque reaches LOADED of the largest, and none that stays below UNLOADED.
    """
    loop = LockStepLoop(loaded(wall)).run(DURATION)
    write_bag(loop, folder / "bag")
    report = report_bag("wall", read_bag(folder / "bag"), loop.scenario, folder, pages=False).report
    stamps, contacts = zip(*loop.contacts, strict=True)
    n, record = loop.scenario.robot.n, loop.record()
    torque = np.abs(np.array(contacts)[:, :n]).max(axis=0)
    share = dict(zip(loop.scenario.joints, torque / torque.max(), strict=True))
    named = [each.joint for each in report.contact.joints] if report.contact else []
    efforts = record.u[np.isfinite(record.u).all(axis=1)]
    return Met(
        begins_s=(stamps[0] - START) * 1e-9,
        stopped=bool(loop.tracker.counters.get("stops")),
        external=EXTERNAL in report.verdict.causes,
        right={j for j in share if share[j] >= LOADED} <= {*named} <= {j for j in share if share[j] >= UNLOADED},
        joints=", ".join(each.removeprefix("joint") for each in named),
        force=(report.contact and report.contact.force_n) or 0.0,
        own_force=(report.contact and report.contact.simulated_force_n) or 0.0,
        beyond=int((np.abs(efforts) > record.effort_limit).sum()),
        finite=all(np.isfinite(each).all() for each in (record.position, record.velocity, efforts, contacts)),
    )
