# SPDX-License-Identifier: Apache-2.0
"""Tables of motion for `fjr identify`: records of independent oracles in encoder steps, with map and robot file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import fjr_core as fjr
from core.oracles.elastic_joint import TRUTH, ElasticJoint, usual_record
from core.oracles.elastic_two_link import ElasticTwoLink, Recorded, recorded
from fjr_core.model.robot import Robot
from fjr_design.uncertainty.posterior import Identification
from fjr_identification.estimation.motion_record import MotionRecord
from system.executables import fjr_here

Array = np.ndarray
STEP = 2 * np.pi / 2**17  # rad, of the encoders
ROBOTS = {
    1: "joints: [joint1]\n    robot:\n      model: single_link\n      link_damping: [0.0]\n",
    2: """joints: [shoulder, elbow]
    robot:
      model: planar_two_link
      link_mass: [1.6, 1.1]
      link_length: [0.35, 0.3]
      link_com: [0.17, 0.14]
      link_inertia: [0.02, 0.01]
""",
}
PRIOR = {1: ([40.0], [0.005]), 2: ([300.0, 80.0], [0.05, 0.03])}  # guesses of joint_stiffness and motor_inertia
SIGNALS = {
    "effort": "effort: {column: 'u_{joint}', unit: N m}",
    "link": "link_position: {column: 'link_{joint}', unit: rad}",
    "motor": "motor_position: {column: 'motor_{joint}', unit: rad}",
    "torque": "joint_torque: {column: 'torque_{joint}', unit: N m}",
}


@dataclass(frozen=True, eq=False)
class MotionTable:
    """Time t (k,) [s] and signals (k, n) by name: effort, link, motor, torque; truth: parameters (n,) by name."""

    joints: tuple[str, ...]
    t: Array
    signals: Mapping[str, Array]
    truth: Mapping[str, Array] = field(default_factory=dict)

    def of(self, *names: str) -> MotionTable:
        """Return the table with the effort and these signals only; without motors, times count from the links."""
        signals = {name: self.signals[name] for name in ("effort", *names)}
        if "motor" in names:
            return replace(self, signals=signals)
        skew = self.truth["link_skew"]
        truth = {**self.truth, "effort_delay": self.truth["effort_delay"] - skew, "torque_skew": -skew}
        return replace(self, signals=signals, truth=truth)

    def with_signal(self, name: str, values: Array) -> MotionTable:
        """Return the table with other values (k, n) of a signal."""
        return replace(self, signals={**self.signals, name: values})

    def with_joint(self, name: str, j: int, values: Array) -> MotionTable:
        """Return the table with other values (k,) of a signal of joint j."""
        changed = self.signals[name].copy()
        changed[:, j] = values
        return self.with_signal(name, changed)

    def rows(self, chosen: slice | Iterable[int]) -> MotionTable:
        """Return some rows."""
        at = np.arange(len(self.t))[chosen if isinstance(chosen, slice) else list(chosen)]
        return replace(self, t=self.t[at], signals={name: values[at] for name, values in self.signals.items()})

    @property
    def record(self) -> MotionRecord:
        """Return the table as it is read."""
        nothing = np.full((len(self.t), len(self.joints)), np.nan)
        columns = (self.signals.get(name, nothing) for name in ("effort", "link", "motor", "torque"))
        return MotionRecord("motion.csv", self.joints, float(self.t[1] - self.t[0]), *columns)

    @property
    def guess(self) -> Robot:
        """Return the robot of the robot file that `written` writes."""
        K, B = PRIOR[len(self.joints)]
        if len(self.joints) == 1:
            return fjr.single_link(stiffness=K, motor_inertia=B, link_damping=0.0)
        links = {"link_mass": (1.6, 1.1), "link_length": (0.35, 0.3), "link_com": (0.17, 0.14)}
        return fjr.planar_two_link(K, **links, link_inertia=(0.02, 0.01), motor_inertia=B)

    def written(self, folder: Path, entries: Mapping[str, str] | None = None) -> list[str]:
        """Write motion.csv, map.yaml with other entries of signals or time, and arm.yaml; return arguments of `fjr`."""
        names = ["t", *(f"{name}_{joint}".replace("effort", "u") for name in self.signals for joint in self.joints)]
        columns = np.column_stack([self.t, *self.signals.values()])
        np.savetxt(folder / "motion.csv", columns, "%.12g", ",", header=",".join(names), comments="")
        lines = {"time": "time: {column: t, unit: s}", **{name: SIGNALS[name] for name in self.signals}}
        (folder / "map.yaml").write_text("\n".join({**lines, **(entries or {})}.values()) + "\n")
        n, (K, B) = len(self.joints), PRIOR[len(self.joints)]
        values = f"joint_stiffness: {K}\n      motor_inertia: {B}\n"
        guesses = f"      guesses: {{joint_stiffness: {K}, motor_inertia: {B}}}\n"
        (folder / "arm.yaml").write_text(f"/**:\n  ros__parameters:\n    {ROBOTS[n]}      {values}{guesses}")
        files = {"": "motion.csv", "--robot": "arm.yaml", "--map": "map.yaml", "--output": "out"}
        return ["identify", *(part for key, name in files.items() for part in (key, str(folder / name)) if part)]

    def identified(self, folder: Path, *more: str, **entries: str) -> tuple[Identification, str]:
        """Return what `fjr identify` finds in the written table, and what it says."""
        said = fjr_here(*self.written(folder, entries), *more)
        values: dict[str, Any] = json.loads((folder / "out/identification.json").read_text())
        return Identification.from_dict(values), said


@cache
def one_joint() -> MotionTable:
    """Return the usual record of the elastic joint."""
    joint, (u, link, motor) = ElasticJoint(), usual_record()
    k = np.arange(len(u))
    torque = joint.K * (motor - np.interp(k - joint.skew / 4e-3, k, link) - joint.offset)
    return _table(("joint1",), 4e-3 * k, [each[:, None] for each in (u, link, motor, torque)], joint)


@cache
def two_joints() -> MotionTable:
    """Return the record of the planar arm."""
    return _planar(recorded())


@cache
def shoulder_at_rest() -> MotionTable:
    """Return a record, 0.3 s after its start, of a planar arm that moves its elbow a little and holds its shoulder.

    The noise of the sensors hides what the coupling of the joints tells about the shoulder.
    """
    table, random = _planar(recorded(1.2, (0.0, 0.03))), np.random.default_rng(8)
    noise = {"effort": 0.0, "link": 2e-5, "motor": 2e-5, "torque": 4e-3}  # rad, N m
    late = table.rows(slice(75, None))
    noisy = {name: each + noise[name] * random.standard_normal(each.shape) for name, each in late.signals.items()}
    return replace(late, signals=noisy)


def _planar(found: Recorded) -> MotionTable:
    signals = [found.u, found.link, found.motor, found.torque]
    return _table(("shoulder", "elbow"), found.dt * np.arange(len(found.u)), signals, ElasticTwoLink())


def _table(joints: tuple[str, ...], t: Array, signals: list[Array], arm: object) -> MotionTable:
    effort, link, motor, torque = signals
    noise = 1e-3 * np.sqrt(np.mean(torque**2, axis=0)) * np.random.default_rng(1).standard_normal(torque.shape)
    truth = {name: np.broadcast_to(getattr(arm, field), len(joints)) for name, field in TRUTH.items()}
    truth["friction_smoothing_velocity"] = np.full(len(joints), 0.01)  # rad/s
    steps = {name: STEP * np.round(values / STEP) for name, values in (("link", link), ("motor", motor))}
    values = {"effort": effort, **steps, "torque": torque + noise}
    friction = ("link_load_friction", "motor_load_friction")
    none = dict.fromkeys(("torque_skew", "actuator_lag", "gear_ratio_error", *friction), np.zeros(len(joints)))
    return MotionTable(joints, t, values, {**truth, **none})
