# SPDX-License-Identifier: Apache-2.0
"""A recorded run in parts: joint motion, reference with four derivatives, certificate, send times, the stop.

Positions, velocities, efforts and times are read from the bag, all else is computed from the scenario; but where the
recorded reference differs from the scenario's, it counts, differentiated numerically, and diagnostics and events tell
of gaps and stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.controller import effort_limits, torque_observer
from fjr_core.config.scenario import Scenario
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, CertificateSeries
from fjr_core.motions.reference import JETS
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import STARTS_REFUSED, STOPS
from fjr_core.runtime.library import constant
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_monitor.diagnosis.record import LEAD, PART, Record, held_efforts
from fjr_monitor.recording.bag import Bag, JointTable
from fjr_monitor.recording.files import Times
from fjr_monitor.recording.signals import REFERENCE, AnsweredStates, States, first_of_each_stamp, match_stamps
from fjr_msgs_py.node.reports import STAMP

OTHER_RATE = 0.05  # relative; beyond this difference the measured sample period replaces the scenario's
HEADINGS = {STOPS: "The controller stopped at {:.3g} s", STARTS_REFUSED: "The controller did not start"}
SAME = 1e-9  # rad, rad/s, relative to the size of the reference: resolution of stamps in ns
SETTLED = constant("OBSERVED")
DEGREE = 5  # of the spline through the recorded velocities: its third derivative is d4q_ld


@dataclass(frozen=True, kw_only=True)
class RunData(Record):
    """Part of a run: a record, certificate, external torque. Times in s since the first state; NaN: not known."""

    SHARED: ClassVar[tuple[str, ...]] = (*Record.SHARED, "certify", "observe")

    sent: Array  # (k,) s, send time of each state since that of the first
    answered: Array  # (k,) s, send time of its command, NaN: none
    certify: Callable[[RunData], CertificateSeries]
    observe: Callable[[RunData], Array]
    measured: Array  # (k, 2n) rad, positions as measured; NaN while velocities of an observer settle
    torque: Array  # (k, n) N m, measured at the motors

    @cached_property
    def certificate(self) -> CertificateSeries:
        """Certificate along the states, computed on use; V, dV NaN for another law than v-dPBC."""
        return self.certify(self)

    @cached_property
    def external_torque(self) -> Array:
        """Estimated external torques on the links (k, n) [N m], computed on use, part by part."""
        return self.observe(self)

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


class Recording:
    """A run in a bag, from the first state with a command on; raises BagError.

    duration [s] of stamped time; infinite: up to the last state that has a command. states: their number. step [s]:
    median time between two. start: stamp of the first one [ns]. sample_period [s]. effort_limit (n,) [N m].
    velocities_measured: else an observer estimates them. notes: one sentence for each missing or substituted signal;
    those on reference and velocities, reference_mismatch [rad] and stop are known once the parts were read. counters:
    last /diagnostics of each name. size: states of a part.
    """

    def __init__(self, bag: Bag, scenario: Scenario, duration: float = np.inf, size: int = PART) -> None:
        self.bag, self.scenario = bag, scenario
        self.joints, self.units = scenario.joints, scenario.robot.units
        self.lockstep = bool(scenario.plant_values["lockstep"])
        self.effort_limit = effort_limits(scenario.controller_values, scenario.robot)
        self.reference_mismatch = float("nan")
        self.stop: ControllerStop | None = None
        self._answered = answered = AnsweredStates(bag, scenario, duration, size)
        self.counters, self.states, self.start = answered.counters, answered.count, answered.section.start
        self.velocities_measured = not answered.reader.estimated
        nominal, seen = scenario.sample_period, answered.section.steps.quantile(0.5) * 1e-9
        known = seen > 0
        other = known and abs(seen - nominal) > OTHER_RATE * nominal
        self.step, self.sample_period = (seen if known else nominal), (seen if other else nominal)
        rate = f"the scenario's robot sends them every {nominal * 1e3:g} ms"
        self._rate_note = (f"states came every {seen * 1e3:.4g} ms; {rate}",) if other else ()
        self.notes = (*answered.notes, *self._rate_note)

    def parts(self) -> Iterator[RunData]:
        """Yield the run in parts; each repeats up to LEAD states of the one before."""
        reference, stop = RecordedReference(self.scenario), StopFinder(self._answered.events)
        estimate = None if self.velocities_measured else EstimatedStates(self.scenario)
        torque_is_known = self._answered.reader.known_torque
        certificate, torques, count, first_sent = self._certificate(), ExternalTorques(self.scenario), 0, 0
        held: Array = np.zeros((0, len(self.joints)))
        for states, u, answered, new, recorded in self._answered.windows():
            begin = min(LEAD, count, new.start)  # states of the part before, which the next one repeats
            cut = slice(new.start - begin, new.stop)
            t = np.asarray((states.stamp - self.start) * 1e-9, dtype=np.float64)
            jets = reference.jets(recorded, states.stamp, t)[cut]
            seen, u, answered, t = states.rows(cut), u[cut], answered[cut], t[cut]
            if estimate is not None:
                position, velocity = estimate.of(seen, u, begin)
                measured = np.where(estimate.settled[:, None], seen.position, np.nan)
                seen = replace(seen, position=position, velocity=velocity)
            first_sent, count = first_sent or int(seen.publish_time[0]), count + new.stop - new.start
            stop.add(seen.stamp, seen.publish_time, t)
            before = held[-begin - 1] if len(held) > begin else None
            held = held_efforts(u, before)
            yield RunData(
                begin=begin,
                before=before,
                certify=certificate,
                observe=torques.of,
                measured=seen.position if estimate is None else measured,
                u_applied=seen.effort @ np.linalg.inv(self.scenario.robot.B_m).T if torque_is_known else None,
                sample_period=self.sample_period,
                lockstep=self.lockstep,
                effort_limit=self.effort_limit,
                effort_rate=np.asarray(self.scenario.settings.effort_rate),
                t=t,
                position=seen.position,
                velocity=seen.velocity,
                jets=jets,
                u=u,
                torque=seen.effort,
                sent=np.asarray((seen.publish_time - first_sent) * 1e-9, dtype=np.float64),
                answered=np.where(answered >= 0, (answered - first_sent) * 1e-9, np.nan),
            )
        self.reference_mismatch, self.stop = reference.mismatch, stop.stop()
        estimated = "no velocities were measured: positions and velocities are an observer's ({:g} rad/s)"
        estimates = () if estimate is None else (estimated.format(estimate.bandwidth),)
        found = *estimates, *reference.notes(self.bag.holds(REFERENCE))
        self.notes = (*self._answered.notes, *found, *self._rate_note)

    def time_series(self) -> Iterator[dict[str, Array]]:
        """Yield the columns (k,) of a table of the run, part by part, by name, joint and unit: `q_l.joint1 [rad]`."""
        n = len(self.joints)
        for part in self.parts():
            signals = (
                ("q_l", "position", part.q_l),
                ("q_m", "position", part.position[:, n:]),
                ("dq_l", "velocity", part.velocity[:, :n]),
                ("dq_m", "velocity", part.velocity[:, n:]),
                ("q_ld", "position", part.q_ld),
                ("dq_ld", "velocity", part.jets[:, 1]),
                ("u", "effort", part.u),
                ("external_torque", "effort", part.external_torque),
            )
            columns = {"t [s]": part.t, "V [J]": part.V, "H [J]": part.certificate.H, "latency [s]": part.latency}
            for name, quantity, values in signals:
                for joint, units, column in zip(self.joints, self.units, values.T, strict=True):
                    columns[f"{name}.{joint} [{getattr(units, quantity)}]"] = column
            yield {name: column[part.begin :] for name, column in columns.items()}

    def _certificate(self) -> Callable[[RunData], CertificateSeries]:
        """Return the certificate along a part; of another law than v-dPBC only what the robot alone determines."""
        scenario, law = self.scenario, self.scenario.certified_law
        made = Certificate(law or TrackingLaw(scenario.robot, scenario.gains))

        def along(part: RunData) -> CertificateSeries:
            found = made.along(part.position, part.velocity, part.jets, part.u)
            return found if law is not None else replace(found, V=np.nan * found.V, dV=np.nan * found.dV)

        return along


class EstimatedStates:
    """Positions and velocities by the scenario's observer, for states that come in parts.

    settled (k,): whether the velocities of the last part may be used.
    """

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
        n, rows, self.settled = self._n, [*self._last[len(self._last) - begin :]], np.ones(len(u), dtype=bool)
        for k in range(begin, len(u)):
            q = states.position[k]
            self._observer.update(int(states.stamp[k]), q[:n], q[n:], self._effort)
            rows.append(self._observer.state.copy())
            self.settled[k] = self._observer.samples >= SETTLED
            self._effort = np.nan_to_num(u[k])
        estimate = np.array(rows).reshape(-1, 4 * n)
        self._last = estimate[-LEAD:]
        return estimate[:, : 2 * n], estimate[:, 2 * n :]


class ExternalTorques:
    """External torques by the scenario's observer, for parts of a run; a part that follows no other restarts it."""

    def __init__(self, scenario: Scenario) -> None:
        self._observer = torque_observer(scenario.controller_values, scenario.robot)
        self._rows, self._t = np.tile(self._observer.start, (LEAD, 1)), 0.0

    def of(self, part: RunData) -> Array:
        """Return the torques (k, n) [N m] at the states of a part."""
        t, new = part.t, slice(part.begin, None)
        rows = self._observer.along(t[new] - self._t, part.measured[new], part.velocity[new], self._rows[-1])
        rows = np.concatenate([self._rows[LEAD - part.begin :], rows])
        self._rows, self._t = np.concatenate([self._rows, rows])[-LEAD:], float(t[-1])
        return rows[:, -part.u.shape[1] :]


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
        self._event, sent = first
        pairs = {} if self._event is None else {pair.key: pair.value for pair in self._event.values}
        self._stamped, self._when = STAMP in pairs, int(pairs.get(STAMP, sent))
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
