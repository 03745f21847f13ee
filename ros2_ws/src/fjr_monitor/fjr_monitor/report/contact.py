# SPDX-License-Identifier: Apache-2.0
"""What a run says of contact: when, the external torque of each joint, and the largest force, beside the simulator's.

    residual torque of the links   tau = J(q)' f        least squares in f

Where the bag has the simulator's contact, f acts on its lines of action: J' e for the unit vector e of its force is the
torque of the simulator for 1 N. Otherwise f (3,) acts at the tip, which is right if only the tip touches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from fjr_core.config.nodes import PLANT
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.diagnosis import innovations
from fjr_monitor.diagnosis.record import blocks_of, parts_of
from fjr_monitor.diagnosis.residuals import torques
from fjr_monitor.diagnosis.torque_faults import QUIET
from fjr_monitor.recording.bag import JointTable
from fjr_monitor.recording.run import Recording
from fjr_msgs_py import names
from fjr_msgs_py.console.output import number

TOPIC = names.CONTACT.replace("~", f"/{PLANT}")
TOGETHER = 5
"""Intervals whose mean is one value, which quiets the noise of velocities; `largest` is the largest of these means."""
ALONG, AT_TIP = "along the simulator's line of action", "at the tip"


@dataclass(frozen=True)
class JointContact:
    """External torque on a joint. largest: estimated; simulated: that of the simulator, None: not in the bag."""

    joint: str
    effort_unit: str  # N for a prismatic joint
    largest_torque_nm: float
    simulated_torque_nm: float | None


@dataclass(frozen=True)
class Contact:
    """Contact of a run. begins_s, ends_s [s]: since its start. force_n: largest, estimated as `force_at` says."""

    begins_s: float
    ends_s: float
    joints: list[JointContact]
    force_n: float | None
    force_at: str
    simulated_force_n: float | None

    @property
    def sentence(self) -> str:
        """What was seen, in one sentence."""
        torques = ", ".join(f"{each.joint} {number(each.largest_torque_nm, each.effort_unit)}" for each in self.joints)
        said = f"contact from {number(self.begins_s)} to {number(self.ends_s, 's')}: external torque on {torques}"
        force = "" if self.force_n is None else f"; largest force {self.force_at} {number(self.force_n, 'N')}"
        own = "" if self.simulated_force_n is None else f", in the simulator {number(self.simulated_force_n, 'N')}"
        return said + force + own


def contact(run: Recording, law: TrackingLaw, joints: Sequence[str]) -> Contact:
    """Return the contact of a run in which external torques act on the named joints; reads its parts once more."""
    n, concerned = run.scenario.robot.n, [run.joints.index(name) for name in joints]
    t, q, torque = _residual_torques(run, law)
    largest = np.abs(torque).max(axis=0)
    touching = (np.abs(torque) > QUIET * largest)[:, concerned].any(axis=1)
    t, q, torque = t[touching], q[touching], torque[touching]
    simulated = run.bag.table(run.bag.topic(TOPIC), [*run.joints, *names.WRENCH]) if run.bag.holds(TOPIC) else None
    if simulated is None:
        forces, own, own_force = _at_tip(run.scenario.robot, q, torque), None, None
    else:
        forces, own = _along(simulated, run, t, torque), np.abs(simulated.effort).max(axis=0)
        own_force = float(np.linalg.norm(simulated.effort[:, n : n + 3], axis=1).max())
    return Contact(
        begins_s=float(t[0]),
        ends_s=float(t[-1]),
        joints=[
            JointContact(run.joints[j], run.units[j].effort, float(largest[j]), None if own is None else float(own[j]))
            for j in concerned
        ],
        force_n=float(np.nanmax(forces)) if np.isfinite(forces).any() else None,
        force_at=AT_TIP if simulated is None else ALONG,
        simulated_force_n=own_force,
    )


def _residual_torques(run: Recording, law: TrackingLaw) -> tuple[Array, Array, Array]:
    """Return times (k,), positions and residual torques (k, n) of the links, each a mean over TOGETHER intervals."""
    n, parts = run.scenario.robot.n, []
    for part in parts_of(run):
        found, first = innovations(part, law, valued=False), part.consecutive()
        torque = torques(law.robot, found.states[:, 0, : 2 * n], found.error[:, 2 * n :], found.dt)[:, :n]
        columns = part.t[first] + found.dt / 2, part.position[first, :n], torque
        parts.append([blocks_of(each, TOGETHER).mean(axis=1) for each in columns])
    t, q, torque = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return t, q, torque


def _along(simulated: JointTable, run: Recording, t: Array, torque: Array) -> Array:
    """Return the forces (k,) [N] along the simulator's lines of action that explain torques (k, n) at t (k,) best."""
    n, ended = torque.shape[1], (simulated.stamp - run.signals.stamp[0]) * 1e-9 - run.step / 2
    own = np.array([simulated.effort[np.abs(ended - each) < TOGETHER * run.step / 2].sum(axis=0) for each in t])
    per_newton = own[:, :n] / np.linalg.norm(own[:, n : n + 3], axis=1, keepdims=True)
    return np.abs((per_newton * torque).sum(axis=1)) / (per_newton**2).sum(axis=1)


def _at_tip(robot: Robot, q: Array, torque: Array) -> Array:
    """Return the sizes (k,) [N] of the forces at the tip that explain torques (k, n) at positions (k, n) best."""
    if robot.links.end_effector is None:
        return np.array([])
    q_l = ca.SX.sym("q", robot.n)
    J = ca.Function("J", [q_l], [ca.jacobian(robot.links.end_effector.position(q_l, ca.SX.zeros(3)), q_l)])
    pairs = zip(q, torque, strict=True)
    return np.array([np.linalg.norm(np.linalg.lstsq(J(at).full().T, given, rcond=None)[0]) for at, given in pairs])
