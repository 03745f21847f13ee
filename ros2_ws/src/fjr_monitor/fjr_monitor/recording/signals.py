# SPDX-License-Identifier: Apache-2.0
"""States of a run in a bag, the commands that answer them, and the reference that was tracked.

A bag is read once: the numbers of its messages go to a scratch file, stamps and send times to arrays. The rows of the
run are found in whole arrays: the first message of each stamp, of the longest section in which stamps do not step back.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import islice, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.scenario import Scenario
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_monitor.recording.bag import STATES, STEP, Bag, JointTable, header_stamp, in_order
from fjr_monitor.recording.columns import Columns
from fjr_monitor.recording.files import BagError, Times
from fjr_msgs_py import names

ANSWERS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
REFERENCE = names.REFERENCE.replace("~", f"/{CONTROLLER}")
EVENTS = f"/{CONTROLLER}/{names.EVENTS.removeprefix('~/')}"
FIELDS = {STATES: ("position", "velocity", "effort"), REFERENCE: ("position", "velocity")}
FIELDS |= dict.fromkeys((ANSWERS, EFFORTS), ("effort",))
SCANNED_MESSAGES = 1000  # for joint names
TOGETHER = 8192  # states that are decoded at a time
AFTERWARDS = 10**9  # ns; the last commands may arrive after the last state
LOST = 0.01  # of the states; more that the recorder lost are noted
CLOCKS = 500_000  # ns; delays to the receiver differ by less on one machine
TAIL = 1.0  # s; states after the last command that are dropped without a note
NEAR = 1e-6  # rad, m; two references that are nearer are equal
END = 2**63 - 1  # ns; after every stamp
Completion = Callable[[JointTable], JointTable]
Places = NDArray[np.int32]
"""Rows of another topic that belong to k states; -1: none."""


class RecordedStates:
    """States from tables of the topic.

    known_torque: whether the motors' torque is measured. estimated: whether an observer estimates the velocities.
    """

    def __init__(self, bag: Bag, scenario: Scenario) -> None:
        self._bag, self._joints, self._n = bag, scenario.joints, len(scenario.joints)
        self._measured = scenario.measurement
        self._ratio = np.concatenate([np.ones(self._n), np.asarray(self._measured.gear_ratio)])  # of links, motors
        self._left_out = 0
        self._foreign, self._other_names = self._names(bag)
        self._no_motors = ""
        self._needed: NDArray[np.intp] | None = None  # columns of position and velocity without which one is left out
        self.known_torque = self.estimated = False
        self._wants_estimate = scenario.controller_values["measurement.velocity"] != "measured"

    def complete(self, table: JointTable) -> JointTable:
        """Return the complete states of a table, in which links come before motors.

        position, velocity (k, 2n) [rad, rad/s]: NaN: not measured. effort (k, n) [N m]: measured at the motors.
        """
        n = self._n
        if self._foreign:
            nothing = np.full_like(table.position, np.nan)
            return replace(table, position=nothing, velocity=nothing, effort=nothing[:, n:])
        position, velocity = table.position / self._ratio, table.velocity / self._ratio
        if self._measured.by_torque:  # q_m = q_l + K^-1 tau
            deflection = np.linalg.solve(np.asarray(self._measured.K), table.effort[:, :n].T).T
            position = np.hstack([table.position[:, :n], table.position[:, :n] + deflection])
        if self._needed is None:
            self._see(table, position)
        good = np.asarray(np.isfinite(np.hstack([table.position, table.velocity])[:, self._needed]).all(axis=1))
        self._left_out += int((~good).sum())
        return replace(table, position=position, velocity=velocity, effort=table.effort[:, n:]).rows(good)

    @property
    def notes(self) -> tuple[str, ...]:
        """A sentence for each loss, for other joint names, and if the motor side is not measured."""
        lost, kept = self._bag.held(STATES).lost or 0, self._bag.held(STATES).count
        said = (
            "" if self._bag.complete else "the bag was not closed: shown is what was written until then",
            f"the recorder lost {lost} of {lost + kept} states: they are not judged" if lost > LOST * kept else "",
            self._other_names,
            f"{self._left_out} states are incomplete or not finite and left out" if self._left_out else "",
            self._no_motors,
        )
        return tuple(filter(None, said))

    def _see(self, table: JointTable, position: Array) -> None:
        """Decide by the first states which signals the bag holds."""
        n = self._n
        sides = n if self._measured.by_torque or np.isnan(table.position[:, n:]).all() else 2 * n
        moving = not self._wants_estimate and not np.isnan(table.velocity[:, :sides]).all(axis=0).any()
        self._needed = np.r_[:sides, 2 * n : 2 * n + sides if moving else 2 * n]
        self.known_torque = bool(np.isfinite(table.effort[:, n:]).any())
        self.estimated = not moving and not np.isnan(position).all(axis=0).any()
        if np.isnan(position[:, n:]).all():
            self._no_motors = f"no motor side ({names.motor_name(self._joints[0])} and so on): no V, no power"

    def _names(self, bag: Bag) -> tuple[bool, str]:
        """Return whether joints of the scenario are missing, and a sentence if the joint names differ."""
        topic, joints = bag.held(STATES), self._joints
        first = [message for _, message in islice(in_order(bag.path, (topic.name,)), SCANNED_MESSAGES)]
        bag.table(topic, joints)  # raises for another type
        named = {name: None for message in topic.decode(first) for name in message.name}
        missing = [joint for joint in joints if joint not in named]
        more = [name for name in named if name not in names.state_names(joints)]
        if missing:
            return True, (
                f"the states name {', '.join(named) or 'no joint'}; the scenario's robot has {', '.join(missing)}: "
                "another robot's, of which only the timing is shown (give its scenario by --scenario)"
            )
        note = f"the states name {', '.join(more)}, too, which the scenario's robot does not have"
        return False, note if more else ""


class RunSignals:
    """The states of a run: the longest section of a bag between two jumps of time; raises BagError if it is empty.

    It begins with the first state that has a command, and of the copies of that state with the last one that was sent
    before the command. stamp, sent (k,) [ns]: stamps and send times of the states. answered (k,) [ns]: send times of
    their commands, -1: none. counters: last /diagnostics of each name. events: of the controller, each with its send
    time [ns]. has_reference: whether it was recorded. commands: topic of the commands, None without any. notes: on
    states and commands.

    Robot and controller on two machines send by two clocks. The recorder's clock reveals their difference, except that
    of the shortest delays from both to the recorder; it is removed from the send times of the controller.
    """

    def __init__(
        self,
        bag: Bag,
        joints: tuple[str, ...],
        duration: float = np.inf,
        complete: Completion = lambda table: table,
        until: float = np.inf,
    ) -> None:
        """Read a bag.

        duration [s] of stamped time; infinite: up to the last state that has a command. complete: returns the complete
        states of a table; without it, states are as they were recorded. until [s]: after the first command; what is
        later is not read.
        """
        self._n, self.counters = len(joints), dict[str, dict[str, str]]()
        self.events: list[tuple[Any, int]] = []
        self.commands = next(filter(bag.holds, (ANSWERS, EFFORTS)), None)
        kept = [STATES, *filter(None, [self.commands]), *filter(bag.holds, [REFERENCE])]
        self._numbers, self.has_reference = {topic: Columns() for topic in kept}, REFERENCE in kept
        self._ahead = self._read(bag, joints, complete, until)
        self.events = [(event, sent - self._ahead) for event, sent in self.events]
        self._references = _of_stamps(*self._choose(bag, duration), self._times(REFERENCE))[0]

    def states(self, rows: slice) -> tuple[Array, Array, Array]:
        """Return positions, velocities (m, 2n) [rad, rad/s] and measured motor torques (m, n) [N m] of states."""
        found = self._numbers[STATES].at(self._rows[rows])
        return found["position"], found["velocity"], found["effort"]

    def efforts(self, rows: slice) -> Array:
        """Return the commands (m, n) [N m] of states; NaN without one."""
        return self._of(self.commands or ANSWERS, self._answers[rows])["effort"]

    def reference(self, rows: slice) -> tuple[Array, Array]:
        """Return recorded positions and velocities (m, n) of the reference at states; NaN without one."""
        found = self._of(REFERENCE, self._references[rows])
        return found["position"], found["velocity"]

    def _of(self, topic: str, places: Places) -> dict[str, Array]:
        """Return the numbers of messages of a topic; NaN if it was not recorded."""
        if topic in self._numbers:
            return self._numbers[topic].at(places)
        return dict.fromkeys(FIELDS[topic], np.full((len(places), self._n), np.nan))

    def close(self) -> None:
        """Forget the numbers; stamps and send times stay."""
        self._numbers.clear()
        del self._rows, self._answers, self._references

    @property
    def periods(self) -> Times:
        """Return the times (k - 1,) [ns] from state to state, by the middleware's stamps at sending."""
        return np.diff(self.sent)

    @property
    def latencies(self) -> Times:
        """Return the times [ns] from states to their commands, where there is one."""
        return (self.answered - self.sent)[self.answered >= 0]

    def _read(self, bag: Bag, joints: tuple[str, ...], complete: Completion, until: float) -> int:
        """Read the messages, with counters and events; times [ns] are kept among the numbers, as bytes.

        Return by how much the clock of the commands is ahead of that of the states [ns].
        """
        named = dict.fromkeys(self._numbers, joints) | {STATES: names.state_names(joints)}
        ahead = dict.fromkeys(self._numbers, -END)  # send minus receive time
        beside, first = filter(bag.holds, (names.DIAGNOSTICS, EVENTS)), END  # stamp of a state with a command
        for batch in bag.batches((*self._numbers, *beside), STATES, TOGETHER):
            for topic, numbers in self._numbers.items():
                table = bag.table(batch[topic], named[topic])
                table = complete(table) if topic == STATES else table
                times = {"stamp": table.stamp.view(float), "sent": table.publish_time.view(float)}
                numbers.add(**{name: getattr(table, name) for name in FIELDS[topic]}, **times)
                ahead[topic] = max([ahead[topic], *(m.publish_time - m.log_time for m in batch[topic].messages)])
            for message in batch[names.DIAGNOSTICS].decoded if names.DIAGNOSTICS in batch else []:
                for status in (each for each in message.status if f"/{each.name}".startswith(f"{bag.namespace}/")):
                    self.counters[status.name] = {pair.key: pair.value for pair in status.values}
            if EVENTS in batch:
                self.events += zip(batch[EVENTS].decoded, batch[EVENTS].publish_time.tolist(), strict=True)
            newest = header_stamp(batch[STATES].messages[-1].data) if batch[STATES].messages else 0
            first = min(first, newest) if self.commands is None or batch[self.commands].messages else first
            if newest - first > until * 1e9 + AFTERWARDS:
                break
        return clock_difference(ahead[STATES], ahead[self.commands or STATES])

    def _times(self, topic: str) -> tuple[Times, Times]:
        """Return stamps and send times [ns] of the messages of a topic, by the clock of the states."""
        if topic not in self._numbers:
            return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
        stamp, sent = (self._numbers[topic].column(name).view(np.int64) for name in ("stamp", "sent"))
        return stamp, sent if topic == STATES else sent - self._ahead

    def _choose(self, bag: Bag, duration: float) -> tuple[Times, Times]:
        """Find the rows of the run; return its stamps, and the send times [ns] of the ends of the section."""
        stamp, sent = self._times(STATES)
        if not len(stamp):
            raise BagError(f"{bag.path} holds no complete state on {STATES}")
        starts = np.flatnonzero(np.diff(stamp) < -STEP) + 1
        begin, end = max(pairwise([0, *starts.tolist(), len(stamp)]), key=lambda ends: ends[1] - ends[0])
        stamp, sent = stamp[begin:end], sent[begin:end]
        if len(stamp) > 1 and not np.ptp(stamp):
            raise BagError(f"all {len(stamp)} states of {bag.path} have the stamp {stamp[0]} ns; expected their times")
        answers, answered = self._answers_of(stamp, sent)
        first = 0
        if (answers >= 0).any():
            row = int(np.argmax(answers >= 0))
            waiting = np.flatnonzero((stamp <= stamp[row]) & (sent <= answered[row]))
            first = int(waiting[-1]) if waiting.size else row
        rows = first + first_of_each_stamp(stamp[first:])
        rows = rows[(stamp[rows] >= stamp[first]) & ((stamp[rows] - stamp[first]) * 1e-9 < duration - 1e-9)]
        last = stamp[rows[-1]]
        if not np.isfinite(duration) and (answers[rows] >= 0).any():
            rows = rows[: 1 + int(np.flatnonzero(answers[rows] >= 0)[-1])]
        self.stamp, self.sent, self.answered = stamp[rows], sent[rows], answered[rows]
        self._rows, self._answers = (begin + rows).astype(np.int32), answers[rows]
        self.notes = self._notes(len(starts), float(last - self.stamp[-1]) * 1e-9)
        return self.stamp, sent[[0, -1]]

    def begin_with_reference(self, planned: Reference) -> None:
        """Drop the states before the first recorded reference if it is not the planned one: their motion is unknown."""
        first = int(np.argmax(self._references >= 0))
        (recorded,), t = self.reference(slice(first, first + 1))[0], (self.stamp[first] - self.stamp[0]) * 1e-9
        if first and np.abs(recorded - planned.jets(t)[0]).max() > NEAR:
            self.stamp, self.sent, self.answered = self.stamp[first:], self.sent[first:], self.answered[first:]
            self._rows, self._answers = self._rows[first:], self._answers[first:]
            self._references = self._references[first:]

    def _answers_of(self, stamp: Times, sent: Times) -> tuple[Places, Times]:
        """Return the command of each state of a section, and its send time [ns]; -1: none.

        Commands are matched by stamp where they carry one; else each state has the first one sent after it and before
        the next state.
        """
        if self.commands != EFFORTS:
            return _of_stamps(stamp, sent, self._times(ANSWERS))
        _, when = self._times(EFFORTS)
        place = np.searchsorted(when, sent)
        time = np.append(when, END)[place]
        found = (time < np.append(sent[1:], END)) & (time <= sent[-1] + AFTERWARDS)
        return np.where(found, place, -1).astype(np.int32), np.where(found, time, -1)

    def _notes(self, jumps: int, tail: float) -> tuple[str, ...]:
        """Return the notes; tail [s]: from the last state of the run to that of the section."""
        end, unknown = (self.stamp[-1] - self.stamp[0]) * 1e-9, "no effort of the controller, no latency"
        ahead = f"the commands' clock is {self._ahead * 1e-9:+.4g} s ahead (two machines, or a slow network): corrected"
        paired = ""
        if self.commands is None:
            paired = f"neither {ANSWERS} nor {EFFORTS} was recorded: {unknown}"
        elif not (self.answered >= 0).any():
            paired = f"no state is answered on {self.commands}: {unknown}"
        elif self.commands == EFFORTS:
            paired = f"no {ANSWERS}: a command of {EFFORTS} is taken to answer the last state sent before it"
        said = (
            f"time jumps back {jumps} times: shown is the longest of {jumps + 1} parts" if jumps else "",
            paired,
            ahead if self._ahead else "",
            f"no state after {end:.3f} s is answered: the last {tail:.3g} s are not shown" if tail > TAIL else "",
        )
        return tuple(filter(None, said))


def _of_stamps(stamp: Times, sent: Times, times: tuple[Times, Times]) -> tuple[Places, Times]:
    """Return the first message with each stamp, and its send time [ns]; -1: none.

    sent: send times of the first to the last state of the section, among which the message was sent. times: stamps and
    send times of the messages.
    """
    stamps, when = times
    inside = np.flatnonzero((when >= sent[0]) & (when <= sent[-1] + AFTERWARDS)).astype(np.int32)
    if not len(inside):
        return np.full(len(stamp), -1, dtype=np.int32), np.full(len(stamp), -1)
    inside = inside[first_of_each_stamp(stamps[inside])]
    rows = inside[np.minimum(np.searchsorted(stamps[inside], stamp), len(inside) - 1)]
    found = stamps[rows] == stamp
    return np.where(found, rows, np.int32(-1)), np.where(found, when[rows], -1)


def clock_difference(states: int, commands: int) -> int:
    """Return how far the clock of the commands is ahead [ns], 0 up to CLOCKS, by largest send minus receive times."""
    ahead = commands - states
    return ahead if abs(ahead) > CLOCKS else 0


def first_of_each_stamp(stamp: Times) -> NDArray[np.intp]:
    """Return the row of the first message of each stamp, in order of time; duplicated messages are dropped."""
    in_order = (stamp[1:] >= stamp[:-1]).all()  # sorting takes time and memory
    return np.flatnonzero(np.diff(stamp, prepend=stamp[:1] - 1)) if in_order else np.unique(stamp, return_index=True)[1]
