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

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.diagnosis import innovations
from fjr_monitor.diagnosis.record import Table
from fjr_monitor.diagnosis.residuals import block_means, torques
from fjr_monitor.diagnosis.torque_faults import QUIET
from fjr_monitor.recording.bag import JointTable
from fjr_monitor.recording.run import Recording
from fjr_msgs_py import names
from fjr_msgs_py.console.output import number

TOPIC = names.CONTACT.replace("~", f"/{names.PLANT}")
TOGETHER = 5
"""Intervals whose mean is one value, which quiets the noise of velocities."""
ALONG, AT_TIP = "along the simulator's line of action", "at the tip"


@dataclass(frozen=True)
class JointContact:
    """External torque on a joint. largest: estimated; simulated: that of the simulator, None: not in the bag."""

    joint: str
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
        torques = ", ".join(f"{each.joint} {number(each.largest_torque_nm, 'N m')}" for each in self.joints)
        said = f"contact from {self.begins_s:.3g} to {self.ends_s:.3g} s: external torque on {torques}"
        force = "" if self.force_n is None else f"; largest force {self.force_at} {number(self.force_n, 'N')}"
        own = "" if self.simulated_force_n is None else f", in the simulator {number(self.simulated_force_n, 'N')}"
        return said + force + own


@dataclass(frozen=True)
class _Moments(Table):
    """Residual torques (k, n) of the links, at k times and link positions (k, n)."""

    t: Array
    q: Array
    torque: Array


def contact(run: Recording, law: TrackingLaw, joints: Sequence[str]) -> Contact:
    """Return the contact of a run in which external torques act on the named joints; reads its parts once more."""
    robot, concerned = run.scenario.robot, [run.joints.index(name) for name in joints]
    seen = _moments(run, law)
    largest = np.abs(seen.torque).max(axis=0)
    seen = seen.rows((np.abs(seen.torque) > QUIET * largest)[:, concerned].any(axis=1))
    simulated = _simulated(run)
    forces, own, size = _forces(run, seen, simulated), None, None
    if simulated is not None:
        own = np.abs(simulated.effort).max(axis=0)
        size = float(np.linalg.norm(simulated.effort[:, robot.n : robot.n + 3], axis=1).max())
    return Contact(
        begins_s=float(seen.t[0]),
        ends_s=float(seen.t[-1]),
        joints=[
            JointContact(run.joints[j], float(largest[j]), own if own is None else float(own[j])) for j in concerned
        ],
        force_n=float(np.nanmax(forces)) if np.isfinite(forces).any() else None,
        force_at=AT_TIP if simulated is None else ALONG,
        simulated_force_n=size,
    )


def _moments(run: Recording, law: TrackingLaw) -> _Moments:
    """Return the residual torques of all intervals of a run, TOGETHER averaged."""
    n, parts = run.scenario.robot.n, []
    for part in run.parts():
        found, first = innovations(part, law, valued=False), part.consecutive()
        torque = torques(law.robot, found.states[:, 0, : 2 * n], found.error[:, 2 * n :], found.dt)[:, :n]
        parts.append([block_means(each, TOGETHER) for each in (part.t[first] + found.dt / 2, part.q_l[first], torque)])
    return _Moments(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def _simulated(run: Recording) -> JointTable | None:
    """Return torques (k, n) and wrench (k, 6) by the simulator's obstacle, in the efforts of a table; None without."""
    if not run.bag.holds(TOPIC):
        return None
    return run.bag.joints(TOPIC, [*run.joints, *names.WRENCH])


def _forces(run: Recording, seen: _Moments, simulated: JointTable | None) -> Array:
    """Return the sizes (k,) [N] of the forces that explain torques best, at the tip or on the simulator's lines."""
    robot, found = run.scenario.robot, []
    if simulated is not None:
        ended = (simulated.stamp - run.start) * 1e-9 - run.step / 2
        for instant, torque in zip(seen.t, seen.torque, strict=True):
            rows = np.abs(ended - instant) < TOGETHER * run.step / 2
            own = simulated.effort[rows].sum(axis=0)
            per_newton = own[: robot.n] / np.linalg.norm(own[robot.n : robot.n + 3])
            found.append(abs(per_newton @ torque) / (per_newton @ per_newton))
    elif robot.links.end_effector is not None:
        q = ca.SX.sym("q", robot.n)
        jacobian = ca.Function("J", [q], [ca.jacobian(robot.links.end_effector.position(q, ca.SX.zeros(3)), q)])
        for q_l, torque in zip(seen.q, seen.torque, strict=True):
            found.append(np.linalg.norm(np.linalg.lstsq(jacobian(q_l).full().T, torque, rcond=None)[0]))
    return np.array(found)
