# SPDX-License-Identifier: Apache-2.0
"""Signals of a recorded run: states, commands that answer them, reference with four derivatives, the controller's stop.

The scenario's reference is used where it was tracked; elsewhere the recorded one is differentiated numerically.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.controller import measurement
from fjr_core.config.scenario import Scenario
from fjr_core.motions.reference import JETS
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import STARTS_REFUSED, STOPS
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_monitor.diagnosis.record import LEAD
from fjr_monitor.recording.bag import Bag, JointTable, Rows, Times, in_order
from fjr_msgs_py import names
from fjr_msgs_py.node.reports import STAMP

STATES = f"/{names.JOINT_STATES}"
HEADINGS = {STOPS: "The controller stopped at {:.3g} s", STARTS_REFUSED: "The controller did not start"}
SCANNED_MESSAGES = 1000  # for joint names
ANSWERS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
AFTERWARDS = 10**9  # ns; the last commands may arrive after the last state
REFERENCE = names.REFERENCE.replace("~", f"/{names.CONTROLLER}")
SAME = 1e-9  # rad, rad/s, relative to the size of the reference: resolution of stamps in ns
DEGREE = 5  # of the spline through the recorded velocities: its third derivative is d4q_ld


@dataclass(frozen=True)
class States(JointTable):
    """States in which links come before motors in position and velocity (k, 2n) [rad, rad/s]; NaN: not measured.

    effort (k, n): measured at the motors [N m]. number (k,): of the message in the bag.
    """

    number: NDArray[np.int64]


class RecordedStates:
    """States from tables of the topic; notes: one sentence for each signal that is missing from the start of the bag.

    known_torque: whether the motors' torque is measured. left_out: number of states that were not complete.
    """

    def __init__(self, bag: Bag, scenario: Scenario) -> None:
        self._joints, self._n = scenario.joints, len(scenario.joints)
        self._measured = measurement(scenario.controller_values, scenario.robot)
        self._ratio = np.concatenate([np.ones(self._n), np.asarray(self._measured.gear_ratio)])  # of links, motors
        self.left_out = 0
        self.known_torque = False
        self._foreign, self.notes = self._names(bag)
        self._needed: Rows | None = None  # columns of position and velocity without which a state is left out
        self.estimated = False
        self._wants_estimate = scenario.controller_values["measurement.velocity"] != "measured"

    def states(self, table: JointTable, number: NDArray[np.int64], new: NDArray[np.bool_]) -> States:
        """Return the complete states of a table in the order of the bag; new: rows that were not seen before."""
        n = self._n
        if self._foreign:
            nothing = np.full_like(table.position, np.nan)
            return States(table.stamp, table.publish_time, nothing, nothing, nothing[:, n:], number)
        position, velocity = self._positions(table), table.velocity / self._ratio
        if self._needed is None:
            self._see(table, position)
        known = np.isfinite(np.hstack([table.position, table.velocity])[:, self._needed])
        good = np.asarray(known.all(axis=1))
        self.left_out += int((~good & new).sum())
        return States(table.stamp, table.publish_time, position, velocity, table.effort[:, n:], number).rows(good)

    def _see(self, table: JointTable, position: Array) -> None:
        """Decide by the first states which signals the bag holds."""
        n, motors = self._n, not self._measured.by_torque and not np.isnan(table.position[:, self._n :]).all()
        moving, sides = not np.isnan(table.velocity).all(), 2 * n if motors else n
        self._needed = np.r_[:sides, 2 * n : 2 * n + sides if moving else 2 * n]
        self.known_torque = bool(np.isfinite(table.effort[:, n:]).any())
        self.estimated = (self._wants_estimate or not moving) and not np.isnan(position).all(axis=0).any()
        if np.isnan(position[:, n:]).all():
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
        if not self._measured.by_torque:
            return table.position / self._ratio
        n, q_l = self._n, table.position[:, : self._n]
        return np.hstack([q_l, q_l + np.linalg.solve(np.asarray(self._measured.K), table.effort[:, :n].T).T])


class EstimatedStates:
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


def commands_of(states: States, table: JointTable | None, stamped: bool) -> tuple[Array, Times]:
    """Return the command of each of k states: u (k, n) [N m], send time (k,) [ns]; NaN and -1 without a command.

    Commands are matched by stamp where they carry one; else each state has the first one sent after it and before the
    next state.
    """
    time, n = states.publish_time, states.position.shape[1] // 2
    if table is not None and stamped and len(time):
        table = table.rows((table.publish_time >= time[0]) & (table.publish_time <= time[-1] + AFTERWARDS))
        table = table.rows(first_of_each_stamp(table.stamp))
    if table is None or not len(table.stamp) or not len(time):
        return np.full((len(time), n), np.nan), np.full(len(time), -1, dtype=np.int64)
    if stamped:
        place, found = match_stamps(states.stamp, table.stamp)
    else:
        place = np.searchsorted(table.publish_time, time)
        found, place = place < len(table.stamp), np.minimum(place, len(table.stamp) - 1)
        found &= table.publish_time[place] < np.append(time[1:], np.iinfo(np.int64).max)
    return np.where(found[:, None], table.effort[place], np.nan), np.where(found, table.publish_time[place], -1)


def match_stamps(stamps: Times, others: Times) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Find each stamp in the sorted `others`: return row indices, and a mask of the stamps that were found."""
    place = np.minimum(np.searchsorted(others, stamps), len(others) - 1)
    return place, others[place] == stamps


class RecordedReference:
    """The tracked reference of a run that comes in parts. mismatch [rad]: recorded minus planned; NaN: unknown."""

    def __init__(self, scenario: Scenario) -> None:
        self._planned = scenario.reference
        self._size = np.ones(2)  # 1 plus the largest position and velocity
        self._since: int | None = None  # stamp [ns] of the first state with another reference than the scenario's
        self._start: float | None = None
        self.mismatch = float("nan")

    def jets(self, table: JointTable | None, stamp: Times, t: Array) -> Array:
        """Return q_ld .. d4q_ld (k, 5, n) at the stamps [ns], which are t (k,) [s] after the first state.

        table: the recorded reference about these stamps; stamps may repeat those of the part before.
        """
        planned = self._planned.jets(t)
        if table is None or not len(table.stamp) or not len(t):
            return planned
        rows = first_of_each_stamp(table.stamp)
        place, found = match_stamps(stamp, table.stamp[rows])
        position, velocity = table.position[rows][place], table.velocity[rows][place]
        if not np.isfinite(position[found]).any():
            return planned
        deviation = np.abs(position - planned[:, 0]).max(axis=1)[found]
        self.mismatch = float(np.maximum(np.nan_to_num(self.mismatch), deviation.max(initial=0.0)))
        self._size = np.maximum(self._size, 1.0 + np.abs(planned[:, :2]).max(axis=(0, 2)))
        apart = np.abs(np.stack([position, velocity], axis=1) - planned[:, :2])
        differs = found & ~(apart <= SAME * self._size[:, None]).all(axis=(1, 2))
        if self._since is None and differs.any():
            self._since = int(stamp[np.argmax(differs)])
        if self._since is None:
            return planned
        usable = found & np.isfinite(position).all(axis=1) & np.isfinite(velocity).all(axis=1) & (stamp >= self._since)
        return self._numerical(planned, t, np.flatnonzero(usable), position, velocity)

    def _numerical(self, planned: Array, t: Array, rows: NDArray[np.intp], position: Array, velocity: Array) -> Array:
        """Replace the jets from the first of `rows` on by derivatives of splines through the recorded reference."""
        if len(rows) <= DEGREE:
            return planned
        from scipy.interpolate import make_interp_spline  # loaded on use: a fifth of the imports of `fjr run`

        self._start = t[rows[0]] if self._start is None else self._start
        since = slice(rows[0], None)
        planned, inside = planned.copy(), np.clip(t[since], t[rows[0]], t[rows[-1]])
        planned[since, 0] = make_interp_spline(t[rows], position[rows], k=DEGREE)(inside)
        curve = make_interp_spline(t[rows], velocity[rows], k=DEGREE)
        for order in range(1, JETS):
            planned[since, order] = curve(inside, order - 1)
        return planned

    def notes(self, recorded: bool) -> tuple[str, ...]:
        """Return a sentence on what was taken, once all parts were read; recorded: whether the bag holds the topic."""
        if not recorded:
            return (
                f"{REFERENCE} was not recorded: the scenario's reference is taken, from the first answered state on",
            )
        if np.isnan(self.mismatch):
            return (f"{REFERENCE} has none of the scenario's joints: the scenario's is taken",)
        if self._since is not None and self._start is None:
            return ("the recorded reference differs from the scenario's for a moment, too short to differentiate",)
        if self._start is None:
            return ()
        other = "another reference than the scenario's was tracked: its derivatives are numerical"
        return (f"from {self._start:.3f} s on {other}",)


@dataclass(frozen=True)
class ControllerStop:
    """A stop of the controller. at_s [s]: time since the start of the run; heading: event; reason: one sentence."""

    at_s: float
    heading: str
    reason: str

    @property
    def sentence(self) -> str:
        """Heading and reason."""
        return f"{self.heading}: {self.reason}"


class StopFinder:
    """The first stop among the events of a controller, at the time of the last state before it.

    events: each with its send time [ns]. An event without a stamp is assigned to the last state sent before it.
    """

    def __init__(self, events: Sequence[tuple[Any, int]]) -> None:
        first: tuple[Any, int] = next((each for each in events if each[0].name in HEADINGS), (None, 0))
        self._event, when = first
        pairs = {} if self._event is None else {pair.key: pair.value for pair in self._event.values}
        self._stamped = STAMP in pairs
        self._when = int(pairs.get(STAMP, when))
        self._at = 0.0

    def add(self, stamps: Any, sent: Any, t: Any) -> None:
        """Take states: stamps and send times (k,) [ns], and times t (k,) [s] since the start of the run."""
        before = (stamps if self._stamped else sent) <= self._when
        self._at = float(t[before][-1]) if before.any() else self._at

    def stop(self) -> ControllerStop | None:
        """Return the stop; None if the controller never stopped."""
        if self._event is None:
            return None
        _, _, reason = self._event.message.partition(": ")
        return ControllerStop(self._at, HEADINGS[self._event.name].format(self._at), reason)
