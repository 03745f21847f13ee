# SPDX-License-Identifier: Apache-2.0
"""A recorded run in parts: joint motion, reference with four derivatives, certificate, send times, the stop.

Positions, velocities, efforts and times are read from the bag, all else is computed from the scenario; but where the
recorded reference differs from the scenario's, it counts, differentiated numerically, and diagnostics and events tell
of gaps and stops.
"""

from __future__ import annotations

from collections.abc import Callable
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
from fjr_monitor.recording.columns import Columns
from fjr_monitor.recording.files import Times
from fjr_monitor.recording.signals import REFERENCE, RecordedStates, RunSignals
from fjr_msgs_py.console.output import number
from fjr_msgs_py.node.reports import STAMP

OTHER_RATE = 0.05  # relative; beyond this difference the measured sample period replaces the scenario's
HEADINGS = {STOPS: "The controller stopped at {}", STARTS_REFUSED: "The controller did not start"}
SAME = 1e-9  # rad, rad/s, relative to the size of the reference: resolution of stamps in ns
SETTLED = constant("OBSERVED")
AROUND = 2048  # states before and after a part through which the splines of its reference pass
DEGREE = 5  # of the spline through the recorded velocities: its third derivative is d4q_ld


@dataclass(frozen=True, kw_only=True)
class RunData(Record):
    """Part of a run: a record with its certificate. Times in s since the first state; NaN: not known."""

    SHARED: ClassVar[tuple[str, ...]] = (*Record.SHARED, "certify")

    sent: Array  # (k,) s, send time of each state since that of the first
    answered: Array  # (k,) s, send time of its command, NaN: none
    certify: Callable[[RunData], CertificateSeries]
    torque: Array  # (k, n) N m, measured at the motors

    @cached_property
    def certificate(self) -> CertificateSeries:
        """Certificate along the states, computed on use; V, dV NaN for another law than v-dPBC."""
        return self.certify(self)

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

    duration [s] of stamped time; infinite: up to the last state that has a command. signals: of the run. columns: t,
    q_l, q_m, dq_l, dq_m, q_ld, dq_ld, the `higher` derivatives, error, u, the effort `held`, measured torque of the
    motors, external_torque, and times `since` the state before and to the command (latency) [s] by the send times.
    step [s]: median time between two. sample_period [s]. effort_limit (n,) [N m].
    velocities_measured: else an observer estimates them. reference_mismatch [rad]: recorded minus planned. stop: first
    stop of the controller, None: it never stopped. notes: one sentence for each missing or substituted signal.
    """

    def __init__(self, bag: Bag, scenario: Scenario, duration: float = np.inf) -> None:
        self.bag, self.scenario, self.columns = bag, scenario, Columns()
        self.joints, self.units = scenario.joints, scenario.robot.units
        self.lockstep = bool(scenario.plant_values["lockstep"])
        self.effort_limit = effort_limits(scenario.controller_values, scenario.robot)
        self._reader = reader = RecordedStates(bag, scenario)
        self.signals = signals = RunSignals(bag, self.joints, duration, reader.complete)
        signals.begin_with_reference(scenario.reference)
        self.stop, count = first_stop(signals), len(signals.stamp)
        self.velocities_measured = not reader.estimated
        nominal = scenario.sample_period
        seen = float(np.median(np.diff(signals.stamp))) * 1e-9 if count > 1 else 0.0
        other = seen > 0 and abs(seen - nominal) > OTHER_RATE * nominal
        self.step, self.sample_period = seen or nominal, (seen if other else nominal)
        rate = f"the scenario's robot sends them every {nominal * 1e3:g} ms"
        rate_note = (f"states came every {seen * 1e3:.4g} ms; {rate}",) if other else ()
        self.notes = (*reader.notes, *signals.notes, *self._read(signals), *rate_note)

    def _read(self, signals: RunSignals) -> tuple[str, ...]:
        """Write the columns, part by part; return the notes on velocities and reference."""
        scenario, n, reference = self.scenario, len(self.joints), RecordedReference(self.scenario)
        estimate = None if self.velocities_measured else EstimatedStates(scenario)
        torques = ExternalTorques(scenario)
        since, before = np.append(np.nan, signals.periods * 1e-9), None
        for start in range(0, len(signals.stamp), PART):
            end = start + PART
            rows, around = slice(start, end), slice(max(0, start - AROUND), end + AROUND)
            within = slice(start - around.start, end - around.start)
            t = (signals.stamp[around] - signals.stamp[0]) * 1e-9
            jets, t = reference.jets(t, *signals.reference(around))[within], t[within]
            position, velocity, torque = signals.states(rows)
            u, measured = signals.efforts(rows), position
            held = held_efforts(u, before)
            if estimate is not None:
                position, velocity, settled = estimate.of(signals.stamp[rows], position, held)
                measured = np.where(settled[:, None], measured, np.nan)
            before, latency = held[-1], (signals.answered[rows] - signals.sent[rows]) * 1e-9
            self.columns.add(
                t=t,
                q_l=position[:, :n],
                q_m=position[:, n:],
                dq_l=velocity[:, :n],
                dq_m=velocity[:, n:],
                q_ld=jets[:, 0],
                dq_ld=jets[:, 1],
                higher=jets[:, 2:].reshape(len(t), -1),
                error=position[:, :n] - jets[:, 0],
                u=u,
                held=held,
                torque=torque,
                external_torque=torques.of(t, measured, velocity),
                since=since[rows],
                latency=np.where(signals.answered[rows] >= 0, latency, np.nan),
            )
        self.reference_mismatch = reference.mismatch
        signals.close()
        estimated = "an observer's positions and velocities ({:g} rad/s): velocities are not all measured, or not used"
        estimates = () if estimate is None else (estimated.format(estimate.bandwidth),)
        return (*estimates, *reference.notes(signals.has_reference))

    @property
    def seconds(self) -> float:
        """Time [s] of the last state."""
        return float(self.signals.stamp[-1] - self.signals.stamp[0]) * 1e-9

    def __len__(self) -> int:
        return len(self.columns)

    def part(self, start: int, end: int) -> RunData:
        """Return the states from `start` to `end`, with LEAD states before them."""
        signals, begin = self.signals, min(LEAD, start)
        found = self.columns.at(np.arange(start - begin - 1, end))  # the effort before is known from the first row
        before, found = found["held"][0], {name: values[1:] for name, values in found.items()}
        rows = slice(start - begin, end)
        sent, answered = ((each[rows] - signals.sent[0]) * 1e-9 for each in (signals.sent, signals.answered))
        reference = found["q_ld"], found["dq_ld"], *np.split(found["higher"], JETS - 2, axis=1)
        inverse = np.linalg.inv(self.scenario.robot.B_m).T
        return RunData(
            begin=begin,
            before=before,
            certify=self._certify,
            u_applied=found["torque"] @ inverse if self._reader.known_torque else None,
            sample_period=self.sample_period,
            lockstep=self.lockstep,
            effort_limit=self.effort_limit,
            effort_rate=np.asarray(self.scenario.settings.effort_rate),
            t=found["t"],
            position=np.hstack([found["q_l"], found["q_m"]]),
            velocity=np.hstack([found["dq_l"], found["dq_m"]]),
            jets=np.stack(reference, axis=1),
            u=found["u"],
            torque=found["torque"],
            sent=sent,
            answered=np.where(signals.answered[rows] >= 0, answered, np.nan),
        )

    def _certify(self, part: RunData) -> CertificateSeries:
        """Return the certificate along a part; of another law than v-dPBC only what the robot alone determines."""
        found = self._certificate.along(part.position, part.velocity, part.jets, part.held)
        if self.scenario.certified_law is not None:
            return found
        return replace(found, V=np.nan * found.V, dV=np.nan * found.dV)

    @cached_property
    def _certificate(self) -> Certificate:
        scenario = self.scenario
        return Certificate(scenario.certified_law or TrackingLaw(scenario.robot, scenario.gains))


class EstimatedStates:
    """Positions and velocities by the scenario's observer, for states that come in parts."""

    def __init__(self, scenario: Scenario) -> None:
        values = scenario.controller_values
        self.bandwidth = float(values["measurement.observer_bandwidth"])  # type: ignore[arg-type]
        self._observer = VelocityObserver(scenario.robot, self.bandwidth, bool(values["compile"]))
        self._n, self._effort = scenario.robot.n, np.zeros(scenario.robot.n)

    def of(self, stamp: Times, position: Array, u: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return positions and velocities (k, 2n) at stamps (k,) [ns], and whether they have settled (k,).

        position (k, 2n): measured. u (k, n) [N m] acts from each state on, NaN: none before the first.
        """
        n, observer = self._n, self._observer
        states, settled = np.zeros((len(u), 4 * n)), np.ones(len(u), dtype=bool)
        for k, q in enumerate(position):
            observer.update(int(stamp[k]), q[:n], q[n:], self._effort)
            states[k], settled[k] = observer.state, observer.samples >= SETTLED
            self._effort = np.nan_to_num(u[k])
        return states[:, : 2 * n], states[:, 2 * n :], settled


class ExternalTorques:
    """External torques by the scenario's observer, for states that come in parts."""

    def __init__(self, scenario: Scenario) -> None:
        self._observer = torque_observer(scenario.controller_values, scenario.robot)
        self._state, self._t = self._observer.start, 0.0

    def of(self, t: Array, position: Array, velocity: Array) -> Array:
        """Return the torques (k, n) [N m] at times t (k,) [s]; position (k, 2n): measured, NaN: not to be used."""
        rows = self._observer.along(t - self._t, position, velocity, self._state)
        self._state, self._t = rows[-1], float(t[-1])
        return rows[:, -position.shape[1] // 2 :]


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
        """Replace the jets from the first of `rows` on by splines through the recorded ones and a step on."""
        if len(rows) <= DEGREE:
            return planned
        from scipy.interpolate import make_interp_spline  # loaded on use: a fifth of the imports of `fjr run`

        self._start = t[rows[0]] if self._start is None else self._start
        since, end = slice(rows[0], None), 2 * t[rows[-1]] - t[rows[-2]]  # it is published more rarely than the states
        planned, inside = planned.copy(), np.clip(t[since], t[rows[0]], end)
        planned[since, 0] = make_interp_spline(t[rows], position[rows], k=DEGREE)(inside)
        curve = make_interp_spline(t[rows], velocity[rows], k=DEGREE)
        for order in range(1, JETS):
            planned[since, order] = curve(inside, order - 1)
        return planned

    def notes(self, recorded: bool) -> tuple[str, ...]:
        """Return a sentence on what was taken, once all parts were read; recorded: whether the bag holds the topic."""
        if not recorded:
            return (f"{REFERENCE} was not recorded: the scenario's is taken, from the first answered state on",)
        if np.isnan(self.mismatch):
            return (f"{REFERENCE} has none of the scenario's joints: the scenario's is taken",)
        if self._since < np.inf and self._start is None:
            return ("the recorded reference differs from the scenario's for a moment, too short to differentiate",)
        if self._start is None:
            return ()
        other = "a transition, a trajectory, or a start before the bag's"
        return (
            f"from {self._start:.3f} s on the reference is not the scenario's ({other}): its derivatives are numerical",
        )


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
            return ControllerStop(at, HEADINGS[event.name].format(number(at, "s")), event.message.partition(": ")[2])
    return None
