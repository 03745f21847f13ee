# SPDX-License-Identifier: Apache-2.0
"""A recorded run in parts: joint motion, reference with four derivatives, certificate, send times, the stop.

Positions, velocities, efforts and times are read from the bag, all else is computed from the scenario; but where the
recorded reference differs from the scenario's, it counts, differentiated numerically, and diagnostics and events tell
of gaps and stops.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

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
from fjr_monitor.recording.bag import Bag
from fjr_monitor.recording.files import Times
from fjr_monitor.recording.signals import REFERENCE, RunSignals
from fjr_msgs_py.node.reports import STAMP

OTHER_RATE = 0.05  # relative; beyond this difference the measured sample period replaces the scenario's
HEADINGS = {STOPS: "The controller stopped at {:.3g} s", STARTS_REFUSED: "The controller did not start"}
SAME = 1e-9  # rad, rad/s, relative to the size of the reference: resolution of stamps in ns
SETTLED = constant("OBSERVED")
AROUND = 2048  # states before and after a part through which the splines of its reference pass
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

    duration [s] of stamped time; infinite: up to the last state that has a command. signals: of the run. states: their
    number. step [s]: median time between two. sample_period [s]. effort_limit (n,) [N m]. velocities_measured: else an
    observer estimates them. stop: first stop of the controller, None: it never stopped. notes: one sentence for each
    missing or substituted signal; those on reference and velocities, and reference_mismatch [rad], are known once the
    parts were read. size: states of a part.
    """

    def __init__(self, bag: Bag, scenario: Scenario, duration: float = np.inf, size: int = PART) -> None:
        self.bag, self.scenario, self._size = bag, scenario, size
        self.joints, self.units = scenario.joints, scenario.robot.units
        self.lockstep = bool(scenario.plant_values["lockstep"])
        self.effort_limit = effort_limits(scenario.controller_values, scenario.robot)
        self.reference_mismatch = float("nan")
        self.signals = signals = RunSignals(bag, scenario, duration)
        self.stop, self.states = first_stop(signals), len(signals.stamp)
        self.velocities_measured = not signals.reader.estimated
        nominal, seen = scenario.sample_period, 0.0
        if self.states > 1:
            seen = float(np.median(np.diff(signals.stamp))) * 1e-9
        other = seen > 0 and abs(seen - nominal) > OTHER_RATE * nominal
        self.step, self.sample_period = seen or nominal, (seen if other else nominal)
        rate = f"the scenario's robot sends them every {nominal * 1e3:g} ms"
        self._rate_note = (f"states came every {seen * 1e3:.4g} ms; {rate}",) if other else ()
        self.notes = (*signals.notes, *self._rate_note)

    @property
    def seconds(self) -> float:
        """Time [s] of the last state."""
        return float(self.signals.stamp[-1] - self.signals.stamp[0]) * 1e-9

    def parts(self) -> Iterator[RunData]:
        """Yield the run in parts; each repeats up to LEAD states of the one before."""
        signals, reference = self.signals, RecordedReference(self.scenario)
        estimate = None if self.velocities_measured else EstimatedStates(self.scenario)
        certificate, torques = self._certificate(), ExternalTorques(self.scenario)
        held: Array = np.zeros((0, len(self.joints)))
        for start in range(0, self.states, self._size):
            begin, end = min(LEAD, start), start + self._size
            rows, around = slice(start - begin, end), slice(max(0, start - AROUND), end + AROUND)
            within = slice(rows.start - around.start, rows.stop - around.start)
            t = (signals.stamp[around] - signals.stamp[0]) * 1e-9
            jets = reference.jets(t, *signals.reference(around))[within]
            position, velocity, torque = signals.states(rows)
            u, answered, measured = signals.efforts(rows), signals.answered[rows], position
            if estimate is not None:
                position, velocity = estimate.of(signals.stamp[rows], position, u, begin)
                measured = np.where(estimate.settled[:, None], measured, np.nan)
            before = held[-begin - 1] if len(held) > begin else None
            held = held_efforts(u, before)
            yield RunData(
                begin=begin,
                before=before,
                certify=certificate,
                observe=torques.of,
                measured=measured,
                u_applied=torque @ np.linalg.inv(self.scenario.robot.B_m).T if signals.reader.known_torque else None,
                sample_period=self.sample_period,
                lockstep=self.lockstep,
                effort_limit=self.effort_limit,
                effort_rate=np.asarray(self.scenario.settings.effort_rate),
                t=t[within],
                position=position,
                velocity=velocity,
                jets=jets,
                u=u,
                torque=torque,
                sent=(signals.sent[rows] - signals.sent[0]) * 1e-9,
                answered=np.where(answered >= 0, (answered - signals.sent[0]) * 1e-9, np.nan),
            )
        self.reference_mismatch = reference.mismatch
        estimated = "no velocities were measured: positions and velocities are an observer's ({:g} rad/s)"
        estimates = () if estimate is None else (estimated.format(estimate.bandwidth),)
        found = *estimates, *reference.notes(signals.has_reference)
        self.notes = (*signals.notes, *found, *self._rate_note)

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

    def of(self, stamp: Times, position: Array, u: Array, begin: int) -> tuple[Array, Array]:
        """Return positions and velocities (k, 2n) at stamps (k,) [ns] with measured positions (k, 2n).

        u (k, n) [N m] acts from each state on. The first `begin` states are the last ones of the part before.
        """
        n, rows, self.settled = self._n, [*self._last[len(self._last) - begin :]], np.ones(len(u), dtype=bool)
        for k in range(begin, len(u)):
            q = position[k]
            self._observer.update(int(stamp[k]), q[:n], q[n:], self._effort)
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
        self._since = np.inf  # s; time of the first state with another reference than the scenario's
        self._start: float | None = None
        self.mismatch = float("nan")

    def jets(self, t: Array, position: Array, velocity: Array) -> Array:
        """Return q_ld .. d4q_ld (k, 5, n) at times t (k,) [s]; times may repeat those of the part before.

        position, velocity (k, n): of the recorded reference there, NaN: none.
        """
        planned = self._planned.jets(t)
        found = np.isfinite(position).any(axis=1)
        if not found.any():
            return planned
        deviation = np.abs(position - planned[:, 0]).max(axis=1)[found]
        self.mismatch = float(np.maximum(np.nan_to_num(self.mismatch), deviation.max(initial=0.0)))
        self._size = np.maximum(self._size, 1.0 + np.abs(planned[:, :2]).max(axis=(0, 2)))
        apart = np.abs(np.stack([position, velocity], axis=1) - planned[:, :2])
        differs = found & ~(apart <= SAME * self._size[:, None]).all(axis=(1, 2))
        if differs.any():
            self._since = min(self._since, float(t[np.argmax(differs)]))
        usable = np.isfinite(np.hstack([position, velocity])).all(axis=1) & (t >= self._since)
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
        if self._since < np.inf and self._start is None:
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


def first_stop(signals: RunSignals) -> ControllerStop | None:
    """Return the first stop among the events of a controller, at the time of the last state before it; None: none.

    An event without a stamp is assigned to the last state sent before it.
    """
    for event, sent in signals.events:
        if event.name in HEADINGS:
            pairs = {pair.key: pair.value for pair in event.values}
            before = signals.stamp <= int(pairs[STAMP]) if STAMP in pairs else signals.sent <= sent
            at = float(signals.stamp[before].max(initial=signals.stamp[0]) - signals.stamp[0]) * 1e-9
            return ControllerStop(at, HEADINGS[event.name].format(at), event.message.partition(": ")[2])
    return None
