# SPDX-License-Identifier: Apache-2.0
"""Read the states of a bag as the scenario's controller does: link and motor positions, velocities, torques."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.controller import measurement
from fjr_core.config.scenario import Scenario
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_monitor.diagnosis.record import LEAD
from fjr_monitor.recording.reader import Array, Bag, JointTable, Times, in_order
from fjr_msgs_py import names

STATES = f"/{names.JOINT_STATES}"
SCANNED_MESSAGES = 1000  # for joint names
Rows = slice | NDArray[np.intp] | NDArray[np.bool_]


@dataclass(frozen=True)
class States:
    """k states of n joints; unmeasured values are NaN.

    number (k,): of the message in the bag. position, velocity (k, 2n): links, then motors [rad], [rad/s].
    torque (k, n): measured at the motors [N m].
    """

    number: NDArray[np.int64]
    stamp: Times
    publish_time: Times
    position: Array
    velocity: Array
    torque: Array

    def rows(self, rows: Rows) -> States:
        """Return the selected states."""
        return States(*(values[rows] for values in vars(self).values()))


class StateReader:
    """States from tables of the topic; notes: one sentence for each signal that is missing from the start of the bag.

    known_torque: whether the motors' torque is measured. left_out: number of states that were not complete.
    """

    def __init__(self, bag: Bag, scenario: Scenario) -> None:
        self._joints, self._n = scenario.joints, len(scenario.joints)
        self._measured = measurement(scenario.controller_values, scenario.robot)
        self.left_out = 0
        self.known_torque = False
        self._foreign, self.notes = self._names(bag)
        self._needed: Rows | None = None  # columns of position and velocity without which a state is left out
        self.estimated = False
        self._wants_estimate = scenario.controller_values["measurement.velocity"] != "measured"

    def states(self, table: JointTable, number: NDArray[np.int64], new: NDArray[np.bool_]) -> States:
        """Return the complete states of a table in the order of the bag; new: rows that were not seen before."""
        n, position = self._n, self._positions(table)
        if self._needed is None:
            self._see(table, position)
        found = States(
            number, table.stamp, table.publish_time, position, self._divided(table.velocity), table.effort[:, n:]
        )
        if self._foreign:
            return found
        known = np.isfinite(np.hstack([table.position, table.velocity])[:, self._needed])
        good = np.asarray(known.all(axis=1))
        self.left_out += int((~good & new).sum())
        return found.rows(good)

    def _see(self, table: JointTable, position: Array) -> None:
        """Decide by the first states which signals the bag holds."""
        n, motors = self._n, not self._measured.by_torque and not np.isnan(table.position[:, self._n :]).all()
        moving, sides = not np.isnan(table.velocity).all(), 2 * n if motors else n
        self._needed = np.r_[:sides, 2 * n : 2 * n + sides if moving else 2 * n]
        self.known_torque = bool(np.isfinite(table.effort[:, n:]).any())
        self.estimated = (self._wants_estimate or not moving) and not np.isnan(position).all(axis=0).any()
        if not self._foreign and np.isnan(position[:, n:]).all():
            self.notes = (*self.notes, f"no motor side ({names.motor_name(self._joints[0])} and so on): no V, no power")

    def _names(self, bag: Bag) -> tuple[bool, tuple[str, ...]]:
        """Return whether joints of the scenario are missing, and a note if the joint names differ."""
        topic, joints = bag.held(STATES), self._joints
        first = [message for _, message in islice(in_order(bag.path, (topic.name,)), SCANNED_MESSAGES)]
        bag.table(topic, joints)  # raises for another type
        named = {name: None for message in topic.decode(first) for name in message.name}
        missing = [joint for joint in joints if joint not in named]
        more = [name for name in named if name not in names.state_names(joints)]
        if missing:
            return True, (
                f"the states name {', '.join(named) or 'no joint'}; the scenario's robot has {', '.join(missing)}: "
                "another robot's, of which only the timing is shown (give its scenario by --scenario)",
            )
        note = f"the states name {', '.join(more)}, too, which the scenario's robot does not have"
        return False, (note,) if more else ()

    def _positions(self, table: JointTable) -> Array:
        """Return link and motor positions (k, 2n) [rad]; q_m = q_l + K^-1 tau where the joint torque is measured."""
        if self._foreign:
            return np.full_like(table.position, np.nan)
        if not self._measured.by_torque:
            return self._divided(table.position)
        n, q_l = self._n, table.position[:, : self._n]
        return np.hstack([q_l, q_l + np.linalg.solve(np.asarray(self._measured.K), table.effort[:, :n].T).T])

    def _divided(self, values: Array) -> Array:
        """Divide motor values by the gear ratio; links are unchanged."""
        if self._foreign:
            return np.full_like(values, np.nan)
        return values / np.concatenate([np.ones(self._n), np.asarray(self._measured.gear_ratio)])


class Estimate:
    """Positions and velocities by the scenario's observer, for states that come in parts."""

    def __init__(self, scenario: Scenario) -> None:
        values, n = scenario.controller_values, scenario.robot.n
        self.bandwidth = float(values["measurement.observer_bandwidth"])  # type: ignore[arg-type]
        self._observer = VelocityObserver(scenario.robot, self.bandwidth, bool(values["compile"]))
        self._n, self._effort = n, np.zeros(n)
        self._last: Array = np.zeros((0, 4 * n))

    def of(self, states: States, u: Array, begin: int) -> tuple[Array, Array]:
        """Return positions and velocities (k, 2n); u (k, n) [N m] acts from each state on.

        The first `begin` states are the last ones of the part before.
        """
        n, rows = self._n, [*self._last[len(self._last) - begin :]]
        for k in range(begin, len(u)):
            q = states.position[k]
            self._observer.update(int(states.stamp[k]), q[:n], q[n:], self._effort)
            rows.append(self._observer.state.copy())
            self._effort = np.nan_to_num(u[k])
        estimate = np.array(rows).reshape(-1, 4 * n)
        self._last = estimate[-LEAD:]
        return estimate[:, : 2 * n], estimate[:, 2 * n :]


def first_of_each_stamp(stamp: Times) -> NDArray[np.intp]:
    """Return the row of the first message of each stamp, in order of time; duplicated messages are dropped."""
    return np.unique(stamp, return_index=True)[1]
