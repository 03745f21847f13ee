# SPDX-License-Identifier: Apache-2.0
"""States of a run in a bag, with the commands that answer them.

A bag is read several times rather than held in memory: once to find the states of the run, the longest section between
two jumps of time, then in windows.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import Rows
from fjr_monitor.recording.bag import Bag, JointTable, in_order
from fjr_monitor.recording.files import BagError, Times
from fjr_monitor.recording.timing import CountedTimes
from fjr_msgs_py import names

STATES = f"/{names.JOINT_STATES}"
ANSWERS, EFFORTS = f"/{names.JOINT_COMMANDS}", f"/{names.EFFORT_COMMANDS}"
REFERENCE = names.REFERENCE.replace("~", f"/{CONTROLLER}")
DIAGNOSTICS, EVENTS = "/diagnostics", f"/{CONTROLLER}/{names.EVENTS.removeprefix('~/')}"
SCANNED_MESSAGES = 1000  # for joint names
AFTERWARDS = 10**9  # ns; the last commands may arrive after the last state
AROUND = 2048  # states before and after a window with which its commands, repeats and reference are looked up
JUMP = 0.5  # s; a larger step back in stamps starts a new section (reset, looped bag)
TAIL = 1.0  # s; states after the last command that are dropped without a note
END = 2**63 - 1


@dataclass(frozen=True)
class States(JointTable):
    """States in which links come before motors in position and velocity (k, 2n) [rad, rad/s]; NaN: not measured.

    effort (k, n): measured at the motors [N m]. number (k,): of the message in the bag.
    """

    number: NDArray[np.int64]


class RecordedStates:
    """States from tables of the topic.

    known_torque: whether the motors' torque is measured. left_out: number of states that were not complete.
    other_names, no_motors: a sentence if joint names differ, if the motor side is not measured; else empty.
    """

    def __init__(self, bag: Bag, scenario: Scenario) -> None:
        self._joints, self._n = scenario.joints, len(scenario.joints)
        self._measured = scenario.measurement
        self._ratio = np.concatenate([np.ones(self._n), np.asarray(self._measured.gear_ratio)])  # of links, motors
        self.left_out = 0
        self.known_torque = False
        self._foreign, self.other_names = self._names(bag)
        self.no_motors = ""
        self._needed: Rows | None = None  # columns of position and velocity without which a state is left out
        self.estimated = False
        self._wants_estimate = scenario.controller_values["measurement.velocity"] != "measured"

    def states(self, table: JointTable, number: NDArray[np.int64], new: NDArray[np.bool_]) -> States:
        """Return the complete states of a table in the order of the bag; new: rows that were not seen before."""
        n = self._n
        if self._foreign:
            nothing = np.full_like(table.position, np.nan)
            return States(table.stamp, table.publish_time, nothing, nothing, nothing[:, n:], number)
        position, velocity = table.position / self._ratio, table.velocity / self._ratio
        if self._measured.by_torque:  # q_m = q_l + K^-1 tau
            deflection = np.linalg.solve(np.asarray(self._measured.K), table.effort[:, :n].T).T
            position = np.hstack([table.position[:, :n], table.position[:, :n] + deflection])
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
            self.no_motors = f"no motor side ({names.motor_name(self._joints[0])} and so on): no V, no power"

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


@dataclass
class Section:
    """States between two jumps of time: numbers of their messages, send times [ns], what is answered of them.

    number, end_number: of its first message, and of the first one after it.
    first_number: of the message with which the run begins. The run begins with the first state that has a command, and
    of the copies of that state with the last one that was sent before the command; None: no state has one.
    start, end: stamps of the first state of the run and of the last one with a command [ns].
    count, answered: number of states of the run, and up to `end`. last: latest stamp.
    length: number of states, repeated ones as well.
    """

    number: int
    end_number: int
    first_sent: int
    last_sent: int
    first_number: int | None = None
    start: int = 0
    end: int | None = None
    last: int = -1
    count: int = 0
    answered: int = 0
    length: int = 0
    steps: CountedTimes = field(default_factory=CountedTimes)

    def add(self, states: States, new: NDArray[np.bool_], sent: Times, duration: float) -> None:
        """Add states, of which only some are new, with the send times of their commands; -1: none."""
        if self.first_number is None:
            answered = np.flatnonzero(new & (sent >= 0))
            if answered.size:
                row = answered[0]
                waiting = np.flatnonzero((states.stamp <= states.stamp[row]) & (states.publish_time <= sent[row]))
                row = int(waiting[-1]) if waiting.size else int(row)
                self.first_number, self.count, self.steps = int(states.number[row]), 0, CountedTimes()
                self.start, self.last = int(states.stamp[row]), int(states.stamp[row]) - 1
            elif not self.count and new.any():
                self.start = int(states.stamp[np.argmax(new)])
                self.last = self.start - 1
        rows = self.rows(states, new, self.last, duration)
        stamps, answered = states.stamp[rows], np.flatnonzero(sent[rows] >= 0)
        if answered.size:
            self.end, self.answered = int(stamps[answered[-1]]), self.count + int(answered[-1]) + 1
        if len(rows):
            self.steps.add(np.diff(stamps, prepend=self.last) if self.count else np.diff(stamps))
            self.count, self.last = self.count + len(rows), int(stamps[-1])

    def rows(self, states: States, new: NDArray[np.bool_], after: int, duration: float) -> NDArray[np.intp]:
        """Return the rows of the first message of each stamp later than `after` and up to the new ones, in order."""
        if not new.any():
            return np.zeros(0, dtype=np.intp)
        usable = np.flatnonzero(states.number >= (self.number if self.first_number is None else self.first_number))
        rows = usable[np.unique(states.stamp[usable], return_index=True)[1]]
        stamps = states.stamp[rows]
        inside = (stamps > after) & (stamps >= self.start) & (stamps <= states.stamp[new].max())
        return np.asarray(rows[inside & ((stamps - self.start) * 1e-9 < duration - 1e-9)])


class AnsweredStates:
    """The longest section of a bag, in windows of `size` states; raises BagError if it is empty.

    duration [s] of stamped time; infinite: up to the last state that has a command. topic: of the commands, None: none
    was recorded. count: number of states of the run. last: stamp of the last one [ns]. jumps: of time in the bag.
    counters: last /diagnostics of each name. events: of the controller, each with its send time [ns].
    """

    def __init__(self, bag: Bag, scenario: Scenario, duration: float, size: int) -> None:
        self._bag, self._joints, self._duration, self._size = bag, scenario.joints, duration, size
        self.reader = RecordedStates(bag, scenario)
        self.topic = next((topic for topic in (ANSWERS, EFFORTS) if bag.holds(topic)), None)
        self._topics = (STATES, *([self.topic] if self.topic else []))
        self.counters: dict[str, dict[str, str]] = {}
        self.events: list[tuple[Any, int]] = []
        self.jumps = 0
        section = self.section = self._longest_section()
        self.count, self.last = section.count, section.last
        if not np.isfinite(duration) and section.end is not None:
            self.count, self.last = section.answered, section.end
        self.notes = self._select_notes()  # on bag, states and commands

    def windows(self) -> Iterator[tuple[States, Array, Times, slice, JointTable | None]]:
        """Yield states of the run and their commands, as of `_commands`; rows of the new states among them.

        Last in each: the recorded reference about these states, None: none was recorded.
        """
        section, last = self.section, self.section.start - 1
        for states, new, tables in self._tables((*self._topics, *([REFERENCE] if self._bag.holds(REFERENCE) else []))):
            inside = (states.number >= section.number) & (states.number < section.end_number)
            states, new = states.rows(inside), new[inside]
            fresh = section.rows(states, new, last, self._duration)
            around = section.rows(states, np.ones_like(new), section.start - 1, self._duration)
            fresh, around = (rows[states.stamp[rows] <= self.last] for rows in (fresh, around))
            if not len(fresh):
                continue
            u, answered = self._commands(states, tables, section)
            begin, last = states.stamp[fresh[[0, -1]]]
            place = int(np.searchsorted(states.stamp[around], begin))
            rows = slice(place, place + len(fresh))
            yield states.rows(around), u[around], answered[around], rows, tables.get(REFERENCE)

    def _tables(
        self, topics: tuple[str, ...], beside: tuple[str, ...] = ()
    ) -> Iterator[tuple[States, NDArray[np.bool_], dict[str, JointTable]]]:
        """Yield states in the order of the bag, which of them are new, and the tables of the topics about them.

        beside: topics from which counters and events are kept on the way.
        """
        kept: dict[str, JointTable] = {}
        first = done = 0
        joints = dict.fromkeys(topics, self._joints) | {STATES: names.state_names(self._joints)}
        for batch in self._bag.batches((*topics, *beside), STATES, self._size):
            self._keep_counters_and_events(batch)
            for topic in topics:
                table = self._bag.table(batch[topic], joints[topic])
                kept[topic] = kept[topic].followed_by(table) if topic in kept else table
            states, is_last = kept[STATES], len(batch[STATES].messages) < self._size
            end = first + len(states.stamp) - (0 if is_last else AROUND)
            number = first + np.arange(len(states.stamp))
            fresh = (number >= done) & (number < end)
            seen = self.reader.states(states, number, fresh)
            yield seen, (seen.number >= done) & (seen.number < end), kept
            done, drop = max(done, end), max(0, end - AROUND - first)
            first += drop
            left = states.rows(slice(drop, None))
            if len(left.stamp):
                since = left.publish_time[0] - AFTERWARDS
                kept = {topic: table.rows(table.publish_time >= since) for topic, table in kept.items()}
            kept[STATES] = left

    def _keep_counters_and_events(self, batch: Mapping[str, Any]) -> None:
        """Keep the last /diagnostics of each name and the events of the controller in a batch of messages."""
        for message in batch[DIAGNOSTICS].decoded if DIAGNOSTICS in batch else []:
            for status in message.status:
                self.counters[status.name] = {pair.key: pair.value for pair in status.values}
        if EVENTS in batch:
            self.events += zip(batch[EVENTS].decoded, batch[EVENTS].publish_time.tolist(), strict=True)

    def _longest_section(self) -> Section:
        """Return the longest section; raise BagError if it is empty."""
        beside = tuple(topic for topic in (DIAGNOSTICS, EVENTS) if self._bag.holds(topic))
        best: Section | None = None
        section: Section | None = None
        for states, new, tables in self._tables(self._topics, beside):
            if not new.any():
                continue
            begin = states.number[0] if section is None else section.number
            starts = states.number[1:][np.diff(states.stamp) < -JUMP * 1e9]
            edges = [int(begin), *starts[starts > begin].tolist(), END]
            for number, end in pairwise(edges):
                inside = (states.number >= number) & (states.number < end)
                part, fresh = states.rows(inside), new[inside]
                if section is not None and section.number == number:
                    section.end_number = end
                elif fresh.any():
                    self.jumps += section is not None
                    section = Section(number, end, int(part.publish_time[0]), 0)
                if section is None or not fresh.any():
                    continue
                section.last_sent = int(part.publish_time[fresh][-1])
                section.length += int(fresh.sum())
                section.add(part, fresh, self._commands(part, tables, section)[1], self._duration)
                best = section if best is None or section.length > best.length else best
        if best is None:
            raise BagError(f"{self._bag.path} holds no complete state on {STATES}")
        return best

    def _commands(self, states: States, tables: dict[str, JointTable], section: Section) -> tuple[Array, Times]:
        """Return the command of each of k states: u (k, n) [N m], send time (k,) [ns]; NaN and -1 without a command.

        Commands are matched by stamp where they carry one; else each state has the first one sent after it and before
        the next state. states, commands: of a section.
        """
        time, stamped = states.publish_time, self.topic == ANSWERS
        nothing = np.full((len(time), len(self._joints)), np.nan), np.full(len(time), -1, dtype=np.int64)
        if self.topic is None or not len(time):
            return nothing
        table, begin = tables[self.topic], section.first_sent
        end = section.last_sent + AFTERWARDS if section.end_number < END else END
        if stamped:
            begin, end = max(begin, time[0]), min(end, time[-1] + AFTERWARDS)
        table = table.rows((table.publish_time >= begin) & (table.publish_time <= end))
        if not len(table.stamp):
            return nothing
        if stamped:
            table = table.rows(first_of_each_stamp(table.stamp))
            place, found = match_stamps(states.stamp, table.stamp)
        else:
            place = np.searchsorted(table.publish_time, time)
            found, place = place < len(table.stamp), np.minimum(place, len(table.stamp) - 1)
            found &= table.publish_time[place] < np.append(time[1:], END)
        return np.where(found[:, None], table.effort[place], np.nan), np.where(found, table.publish_time[place], -1)

    def _select_notes(self) -> tuple[str, ...]:
        """Return the notes on bag, states and commands."""
        section, reader = self.section, self.reader
        unknown = "no effort of the controller, no latency"
        commands = ""
        if self.topic is None:
            commands = f"neither {ANSWERS} nor {EFFORTS} was recorded: {unknown}"
        elif section.end is None:
            commands = f"no state is answered on {self.topic}: {unknown}"
        elif self.topic == EFFORTS:
            commands = (
                f"{ANSWERS} was not recorded: a command of {EFFORTS} is taken to answer the last state sent before it"
            )
        tail, end = (section.last - self.last) * 1e-9, (self.last - section.start) * 1e-9
        said = (
            "" if self._bag.complete else "the bag was not closed: shown is what was written until then",
            reader.other_names,
            f"{reader.left_out} states are incomplete or not finite and left out" if reader.left_out else "",
            reader.no_motors,
            f"time jumps back {self.jumps} times: shown is the longest of {self.jumps + 1} parts" if self.jumps else "",
            commands,
            f"no state after {end:.3f} s is answered: the last {tail:.3g} s are not shown" if tail > TAIL else "",
        )
        return tuple(note for note in said if note)


def first_of_each_stamp(stamp: Times) -> NDArray[np.intp]:
    """Return the row of the first message of each stamp, in order of time; duplicated messages are dropped."""
    return np.unique(stamp, return_index=True)[1]


def match_stamps(stamps: Times, others: Times) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Find each stamp in the sorted `others`: return row indices, and a mask of the stamps that were found."""
    place = np.minimum(np.searchsorted(others, stamps), len(others) - 1)
    return place, others[place] == stamps
