# SPDX-License-Identifier: Apache-2.0
"""A recorded run in parts: joint motion, storage function of the law, energy of the robot, send times.

Positions, velocities, efforts and times are read from the bag, all else is computed from the scenario; but where the
recorded reference differs from the scenario's, it counts, and diagnostics and events tell of gaps and stops. A run is
read several times rather than held in memory: once to find its states, then part by part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.controller import effort_limits
from fjr_core.config.scenario import Scenario
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, CertificateSeries
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.record import LEAD, PART, Record
from fjr_monitor.recording.bag import Bag, JointTable, Times
from fjr_monitor.recording.signals import (
    AFTERWARDS,
    ANSWERS,
    EFFORTS,
    REFERENCE,
    STATES,
    ControllerStop,
    EstimatedStates,
    RecordedReference,
    RecordedStates,
    States,
    StopFinder,
    commands_of,
)
from fjr_monitor.recording.timing import CountedTimes
from fjr_monitor.recording.topic import BagError
from fjr_msgs_py import names

AROUND = 2048  # states before and after a part with which its commands, repeats and reference are looked up
JUMP = 0.5  # s; a larger step back in stamps starts a new section (reset, looped bag)
TAIL = 1.0  # s; states after the last command that are dropped without a note
END = 2**63 - 1
OTHER_RATE = 0.05  # relative; beyond this difference the measured sample period replaces the scenario's
DIAGNOSTICS, EVENTS = "/diagnostics", f"/{names.CONTROLLER}/{names.EVENTS.removeprefix('~/')}"


@dataclass(frozen=True, kw_only=True)
class RunData(Record):
    """Part of a run: a record with the certificate along it. Times in s since the first state; NaN: not known."""

    sent: Array  # (k,) s, send time of each state since that of the first
    answered: Array  # (k,) s, send time of its command, NaN: none
    certify: Callable[[RunData], CertificateSeries]
    torque: Array  # (k, n) N m, measured at the motors

    @cached_property
    def certificate(self) -> CertificateSeries:
        """Certificate along the states, computed on use; V, dV NaN for another law than v-dPBC."""
        return self.certify(self)

    @property
    def q_l(self) -> Array:
        """Link positions (k, n) [rad]."""
        return self.position[:, : self.u.shape[1]]

    @property
    def q_ld(self) -> Array:
        """Reference (k, n) [rad]."""
        return np.asarray(self.jets[:, 0])

    @property
    def error(self) -> Array:
        """q_l - q_ld (k, n) [rad]."""
        return self.q_l - self.q_ld

    @property
    def V(self) -> Array:
        """Storage of the law (k,) [J] at each state, x_v = x."""
        return self.certificate.V

    @property
    def latency(self) -> Array:
        """Time from sending a state to sending its command (k,) [s]; NaN without a command."""
        return self.answered - self.sent


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


class Recording:
    """A run in a bag, from the first state with a command on; raises BagError.

    duration [s] of stamped time; infinite: up to the last state that has a command. states: their number. step [s]:
    median time between two. sample_period [s]. effort_limit (n,) [N m]. notes: one sentence for each missing or
    substituted signal; those on reference and velocities, reference_mismatch [rad] and stop are known once the parts
    were read. counters: last /diagnostics of each name. size: states of a part.
    """

    def __init__(self, bag: Bag, scenario: Scenario, duration: float = np.inf, size: int = PART) -> None:
        self.bag, self.scenario, self._size, self._duration = bag, scenario, size, duration
        self.joints, self.units = scenario.joints, scenario.robot.units
        self.lockstep = bool(scenario.plant_values["lockstep"])
        self.effort_limit = effort_limits(scenario.controller_values, scenario.robot)
        self.reference_mismatch = float("nan")
        self.stop: ControllerStop | None = None
        self.counters: dict[str, dict[str, str]] = {}
        self._events: list[tuple[Any, int]] = []  # (event, send time) of the controller
        self._reader = RecordedStates(bag, scenario)
        self._topics = [topic for topic in (ANSWERS, EFFORTS) if bag.holds(topic)][:1]
        section = self._section = self._longest_section()
        self.states, self._last = section.count, section.last
        if not np.isfinite(duration) and section.end is not None:
            self.states, self._last = section.answered, section.end
        nominal, seen = scenario.sample_period, section.steps.quantile(0.5) * 1e-9
        known = seen > 0
        other = known and abs(seen - nominal) > OTHER_RATE * nominal
        self.step, self.sample_period = (seen if known else nominal), (seen if other else nominal)
        rate = f"the scenario's robot sends them every {nominal * 1e3:g} ms"
        self._rate_note = (f"states came every {seen * 1e3:.4g} ms; {rate}",) if other else ()
        self._notes = self._select_notes()
        self._notes_of_parts: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """One sentence for each missing or substituted signal."""
        return (*self._notes, *self._notes_of_parts, *self._rate_note)

    @property
    def velocities_measured(self) -> bool:
        """Whether velocities are measured; else an observer estimates them."""
        return not self._reader.estimated

    def parts(self) -> Iterator[RunData]:
        """Yield the run in parts; each repeats up to LEAD states of the one before."""
        section, tables = self._section, (*self._topics, *([REFERENCE] if self.bag.holds(REFERENCE) else []))
        reference = RecordedReference(self.scenario)
        estimate = EstimatedStates(self.scenario) if self._reader.estimated else None
        certificate, known_torque = self._certificate(), self._reader.known_torque
        last, count, first_sent, stop = section.start - 1, 0, 0, StopFinder(self._events)
        for states, new, window in self._windows((STATES, *tables)):
            inside = (states.number >= section.number) & (states.number < section.end_number)
            states = states.rows(inside)
            around, place, fresh = self._rows(states, new[inside], last)
            if not fresh:
                continue
            begin = min(LEAD, count, place)  # states of the part before, which the next one repeats
            cut = slice(place - begin, place + fresh)
            u, answered = self._commands(states, window, section)
            t = np.asarray((states.stamp[around] - section.start) * 1e-9, dtype=np.float64)
            seen, u, answered = states.rows(around[cut]), u[around[cut]], answered[around[cut]]
            if estimate is not None:
                position, velocity = estimate.of(seen, u, begin)
                seen = replace(seen, position=position, velocity=velocity)
            jets = reference.jets(window.get(REFERENCE), states.stamp[around], t)[cut]
            first_sent = first_sent or int(seen.publish_time[0])
            stop.add(seen.stamp, seen.publish_time, t[cut])
            yield RunData(
                begin=begin,
                certify=certificate,
                u_applied=seen.effort @ np.linalg.inv(self.scenario.robot.B_m).T if known_torque else None,
                sample_period=self.sample_period,
                lockstep=self.lockstep,
                effort_limit=self.effort_limit,
                t=t[cut],
                position=seen.position,
                velocity=seen.velocity,
                jets=jets,
                u=u,
                torque=seen.effort,
                sent=np.asarray((seen.publish_time - first_sent) * 1e-9, dtype=np.float64),
                answered=np.where(answered >= 0, (answered - first_sent) * 1e-9, np.nan),
            )
            last, count = int(seen.stamp[-1]), count + fresh
        self.reference_mismatch, self.stop = reference.mismatch, stop.stop()
        estimated = "no velocities were measured: positions and velocities are an observer's ({:g} rad/s)"
        estimates = () if estimate is None else (estimated.format(estimate.bandwidth),)
        self._notes_of_parts = (*estimates, *reference.notes(self.bag.holds(REFERENCE)))

    def _rows(self, states: States, new: NDArray[np.bool_], last: int) -> tuple[NDArray[np.intp], int, int]:
        """Return the rows of the run's states, the place there of the first one after `last`, and how many are fresh.

        new: states whose turn it is; the others lie around them.
        """
        section = self._section
        fresh, around = (
            section.rows(states, those, after, self._duration)
            for those, after in ((new, last), (np.ones_like(new), section.start - 1))
        )
        fresh, around = (rows[states.stamp[rows] <= self._last] for rows in (fresh, around))
        place = int(np.searchsorted(states.stamp[around], states.stamp[fresh[0]])) if len(fresh) else 0
        return around, place, len(fresh)

    def _windows(
        self, topics: tuple[str, ...], beside: tuple[str, ...] = ()
    ) -> Iterator[tuple[States, NDArray[np.bool_], dict[str, JointTable]]]:
        """Yield states in the order of the bag, which of them are new, and the tables of the topics about them.

        beside: topics from which counters and events are kept on the way.
        """
        kept: dict[str, JointTable] = {}
        first = done = 0
        joints = dict.fromkeys(topics, self.joints) | {STATES: names.state_names(self.joints)}
        for batch in self.bag.batches((*topics, *beside), STATES, self._size):
            self._keep_counters_and_events(batch)
            for topic in topics:
                table = self.bag.table(batch[topic], joints[topic])
                kept[topic] = kept[topic].followed_by(table) if topic in kept else table
            states, is_last = kept[STATES], len(batch[STATES].messages) < self._size
            end = first + len(states.stamp) - (0 if is_last else AROUND)
            number = first + np.arange(len(states.stamp))
            fresh = (number >= done) & (number < end)
            seen = self._reader.states(states, number, fresh)
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
            self._events += zip(batch[EVENTS].decoded, batch[EVENTS].publish_time.tolist(), strict=True)

    def _longest_section(self) -> Section:
        """Return the longest section; raise BagError if it is empty."""
        beside = tuple(topic for topic in (DIAGNOSTICS, EVENTS) if self.bag.holds(topic))
        best: Section | None = None
        section: Section | None = None
        self._jumps = 0
        for states, new, window in self._windows((STATES, *self._topics), beside):
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
                    self._jumps += section is not None
                    section = Section(number, end, int(part.publish_time[0]), 0)
                if section is None or not fresh.any():
                    continue
                section.last_sent = int(part.publish_time[fresh][-1])
                section.length += int(fresh.sum())
                section.add(part, fresh, self._commands(part, window, section)[1], self._duration)
                best = section if best is None or section.length > best.length else best
        if best is None:
            raise BagError(f"{self.bag.path} holds no complete state on {STATES}")
        return best

    def _commands(self, states: States, window: dict[str, JointTable], section: Section) -> tuple[Array, Times]:
        """Return efforts and send times of the commands to states of a section."""
        if not self._topics:
            return commands_of(states, None, False)
        table = window[self._topics[0]]
        end = section.last_sent + AFTERWARDS if section.end_number < END else END
        inside = (table.publish_time >= section.first_sent) & (table.publish_time <= end)
        return commands_of(states, table.rows(inside), self._topics[0] == ANSWERS)

    def _select_notes(self) -> tuple[str, ...]:
        """Return the notes on bag, states and commands."""
        section, reader = self._section, self._reader
        torn = () if self.bag.complete else ("the bag was not closed: shown is what was written until then",)
        left_out = (f"{reader.left_out} states are incomplete or not finite and left out",) if reader.left_out else ()
        jumps = f"time jumps back {self._jumps} times: shown is the longest of {self._jumps + 1} parts"
        unknown = "no effort of the controller, no latency"
        commands = ""
        if not self._topics:
            commands = f"neither {ANSWERS} nor {EFFORTS} was recorded: {unknown}"
        elif section.end is None:
            commands = f"no state is answered on {self._topics[0]}: {unknown}"
        elif self._topics[0] == EFFORTS:
            commands = (
                f"{ANSWERS} was not recorded: a command of {EFFORTS} is taken to answer the last state sent before it"
            )
        tail, end = (section.last - self._last) * 1e-9, (self._last - section.start) * 1e-9
        silent = f"no state after {end:.3f} s is answered: the last {tail:.3g} s are not shown"
        said = [jumps] * bool(self._jumps) + [commands] * bool(commands) + [silent] * (tail > TAIL)
        names_first = reader.notes[:1] if reader.notes and "motor side" not in reader.notes[0] else ()
        return (*torn, *names_first, *left_out, *reader.notes[len(names_first) :], *said)

    def _certificate(self) -> Callable[[RunData], CertificateSeries]:
        """Return the certificate along a part; of another law than v-dPBC only what the robot alone determines."""
        scenario, law = self.scenario, self.scenario.certified_law
        made = Certificate(law or TrackingLaw(scenario.robot, scenario.gains))

        def along(part: RunData) -> CertificateSeries:
            found = made.along(part.position, part.velocity, part.jets, part.u)
            return found if law is not None else replace(found, V=np.nan * found.V, dV=np.nan * found.dV)

        return along
