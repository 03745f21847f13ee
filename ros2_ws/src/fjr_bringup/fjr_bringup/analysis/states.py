# SPDX-License-Identifier: Apache-2.0
"""Read the states of a bag as the scenario's controller does: link and motor positions, velocities, torques."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.recording.reader import Array, Bag, JointTable, Times
from fjr_core.config.measurement import measurement
from fjr_core.config.scenario import Scenario
from fjr_core.estimation.measurement_model import Measurement
from fjr_core.estimation.velocity_observer import VelocityObserver
from fjr_msgs_py import names

STATES = f"/{names.JOINT_STATES}"
JUMP = 0.5  # s; a larger step back in stamps starts a new part (reset, looped bag)
SCANNED_MESSAGES = 1000  # for joint names
Rows = slice | NDArray[np.intp] | NDArray[np.bool_]


@dataclass(frozen=True)
class States:
    """k states of n joints, one per stamp, in order of time; unmeasured values are NaN.

    position, velocity (k, 2n): links, then motors [rad], [rad/s]. torque (k, n): measured at the motors [N m].
    notes: one sentence for each missing or substituted signal.
    """

    stamp: Times
    publish_time: Times
    position: Array
    velocity: Array
    torque: Array
    notes: tuple[str, ...] = field(default=())

    def rows(self, rows: Rows) -> States:
        """Return the selected rows."""
        each = ("stamp", "publish_time", "position", "velocity", "torque")
        return replace(self, **{name: getattr(self, name)[rows] for name in each})


def recorded_states(bag: Bag, scenario: Scenario) -> States:
    """Return the states of the scenario's joints; raise BagError if the bag holds no joint states."""
    joints, measured = scenario.joints, measurement(scenario.controller_values, scenario.robot)
    n, table = len(joints), bag.joints(STATES, names.state_names(joints))
    foreign, name_notes = _names(bag, joints)
    if foreign:
        unknown = np.full_like(table.position, np.nan)
        return _states(table, unknown, unknown, name_notes)
    rows, left_out = _usable(table, n, needs_motor=not measured.by_torque)
    notes = (*name_notes, *left_out)
    position, velocity = _positions(table, measured, n), _divided(table.velocity, measured)
    found = _states(table, position, velocity, notes).rows(rows)
    if np.isnan(position[:, n:]).all():
        note = f"no motor side ({names.motor_name(joints[0])} and so on): no V, no power"
        return replace(found, notes=(*notes, note))
    return found


def first_of_each_stamp(stamp: Times) -> NDArray[np.intp]:
    """Return the row of the first message of each stamp, in order of time; duplicated messages are dropped."""
    return np.unique(stamp, return_index=True)[1]


def without_jumps(states: States) -> tuple[States, tuple[str, ...]]:
    """Return the longest part with monotonic time, and a note if there are several parts."""
    jumps = np.flatnonzero(np.diff(states.stamp) < -JUMP * 1e9) + 1
    if jumps.size == 0:
        return states, ()
    edges = np.array([0, *jumps, len(states.stamp)])
    longest = int(np.argmax(np.diff(edges)))
    note = f"time jumps back {jumps.size} times: shown is the longest of {jumps.size + 1} parts"
    return states.rows(slice(edges[longest], edges[longest + 1])), (note,)


def with_velocities(states: States, u: Array, scenario: Scenario) -> States:
    """Estimate velocities by the observer if none were measured; u (k, n) [N m] acts from each state on."""
    n, wanted = scenario.robot.n, scenario.controller_values["measurement.velocity"] != "measured"
    if not (np.isnan(states.velocity).all() or wanted) or np.isnan(states.position).all(axis=0).any():
        return states
    bandwidth = float(scenario.controller_values["measurement.observer_bandwidth"])  # type: ignore[arg-type]
    observer, compile = VelocityObserver, bool(scenario.controller_values["compile"])
    found, held = observer(scenario.robot, bandwidth, compile), np.nan_to_num(np.vstack([np.zeros((1, n)), u[:-1]]))
    estimate = np.empty((len(states.stamp), 4 * n))
    for k, (stamp, q, effort) in enumerate(zip(states.stamp, states.position, held, strict=True)):
        found.update(int(stamp), q[:n], q[n:], effort)
        estimate[k] = found.state
    note = f"no velocities were measured: positions and velocities are an observer's ({bandwidth:g} rad/s)"
    return replace(states, position=estimate[:, : 2 * n], velocity=estimate[:, 2 * n :], notes=(*states.notes, note))


def _names(bag: Bag, joints: tuple[str, ...]) -> tuple[bool, tuple[str, ...]]:
    """Return whether joints of the scenario are missing, and a note if the joint names differ."""
    named = {name: None for message in bag.topic(STATES).first(SCANNED_MESSAGES) for name in message.name}
    missing = [joint for joint in joints if joint not in named]
    more = [name for name in named if name not in names.state_names(joints)]
    if missing:
        return True, (
            f"the states name {', '.join(named) or 'no joint'}; the scenario's robot has {', '.join(missing)}: "
            "another robot's, of which only the timing is shown (give its scenario by --scenario)",
        )
    return False, (f"the states name {', '.join(more)}, too, which the scenario's robot does not have",) if more else ()


def _usable(table: JointTable, n: int, needs_motor: bool) -> tuple[NDArray[np.bool_], tuple[str, ...]]:
    """Return a mask of the complete rows, and a note on the others."""
    wanted = table.position if needs_motor and not np.isnan(table.position[:, n:]).all() else table.position[:, :n]
    good = np.asarray(np.isfinite(wanted).all(axis=1))
    if not np.isnan(table.velocity).all():
        good &= np.isfinite(table.velocity[:, : wanted.shape[1]]).all(axis=1)
    left_out = int((~good).sum())
    return good, (f"{left_out} states are incomplete or not finite and left out",) if left_out else ()


def _positions(table: JointTable, measured: Measurement, n: int) -> Array:
    """Return link and motor positions (k, 2n) [rad]; q_m = q_l + K^-1 tau where the joint torque is measured."""
    if not measured.by_torque:
        return _divided(table.position, measured)
    q_l = table.position[:, :n]
    return np.hstack([q_l, q_l + np.linalg.solve(np.asarray(measured.K), table.effort[:, :n].T).T])


def _divided(values: Array, measured: Measurement) -> Array:
    """Divide motor values by the gear ratio; links are unchanged."""
    return values / np.concatenate([np.ones(measured.n), np.asarray(measured.gear_ratio)])


def _states(table: JointTable, position: Array, velocity: Array, notes: tuple[str, ...]) -> States:
    n = position.shape[1] // 2
    return States(table.stamp, table.publish_time, position, velocity, table.effort[:, n:], notes)
