# SPDX-License-Identifier: Apache-2.0
"""Diagnose a recorded run as holding, degraded, violated or unknown: whether V decayed as guaranteed, else the causes.

Only measured states and sent efforts are used.
"""

from __future__ import annotations

from dataclasses import replace
from functools import reduce

import numpy as np

from fjr_core.errors import StateError
from fjr_core.files import importing
from fjr_core.law.rate import Rate
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, CertificateSeries, Prediction
from fjr_core.motions.domain import Domain
from fjr_core.numerics.checks import Array, instance
from fjr_core.runtime.events import Finding
from fjr_core.stability.linearization import linearize

from . import thresholds
from .causes import MISMATCH, CausePropagation, StorageGrowth, closed_loop, growth, storage_budget
from .delay_estimation import AFTER, BEFORE, ActingSums, effort_delay, foreseen
from .fault_isolation import MOST_STATES, isolate
from .record import PART, AnyRecord, Innovations, Record, limited, parts_of
from .thresholds import JointTolerances
from .torque_faults import UNKNOWN
from .verdict import EXTERNAL, NO_DECAY, SAMPLING, BlockStatistics, Diagnosis, external, unknown, violated

CONFIGURATIONS = 12  # of a run at which the sampled loop is linearised
VISITED = 200  # configurations of a run at which the rate is evaluated
FARTHEST = 1e4  # rad or m; a run that goes beyond has lost its robot, and bounds may overflow


def innovations(
    record: Record, law: TrackingLaw, series: CertificateSeries | None = None, valued: bool = True
) -> Innovations:
    """Return the innovations of the intervals that `Record.consecutive` selects; of a part, those that end in it.

    series: certificate along the record; None: it is computed here. valued: false leaves V, its slope and the effort of
    the law NaN, in half the time.
    """
    (k, n), balance, prediction = record.u.shape, Certificate(law), Prediction(law)
    if series is None and valued:
        series = balance.along(record.position, record.velocity, record.jets)
    sent, dt, first = record.held, np.diff(record.t), record.consecutive()
    older = sent[np.maximum(first - 1, 0)]
    older = np.where(np.isfinite(older), older, sent[first])
    second, q, dq = first + 1, record.position, record.velocity
    q_next, dq_next = prediction.along(q[first], dq[first], sent[first], dt[first])
    unknown = np.full((k, 4 * n), np.nan)
    V, u_law, slope = (series.V, series.u_law, series.slope) if series else (unknown[:, 0], unknown[:, :n], unknown)
    predicted = balance.along(q_next, dq_next, record.jets[second]).V if valued else V[second]
    applied = unknown[:, :n] if record.u_applied is None else record.u_applied
    return Innovations(
        dt=dt[first],
        V0=V[first],
        V1=V[second],
        predicted=predicted,
        sent=sent[first],
        law=u_law[first],
        before=applied[first],
        after=applied[second],
        error=np.hstack([q[second] - q_next, dq[second] - dq_next]),
        slope=slope[second],
        answered=np.asarray(np.isfinite(record.u[first]).all(axis=1)),
        older=older,
        latency=record.known_latency()[first] / dt[first],
        limited=limited(sent[first], older, dt[first], record.effort_limit, record.effort_rate),
        tracking=q[second, :n] - record.jets[second, 0],
        states=np.stack([np.hstack([q[rows], dq[rows]]) for rows in (first, second)], axis=1),
        t=record.t[first],
    )


def diagnose(
    record: Record,
    law: TrackingLaw,
    beta: float | None = None,
    axes: JointTolerances | None = None,
    velocities_measured: bool = True,
    size: int = PART,
) -> Diagnosis:
    """Diagnose a record and isolate the faults that explain it.

    beta [1/s]: guaranteed rate of V; None: the rate of the law at configurations of the reference. axes: names, units
    and tolerances of the joints; None: JointTolerances.plain. velocities_measured: false if an observer estimates them;
    faults are then not isolated, nor in a loop that is unstable at its sample period. size: states processed at once.
    Raises StateError for a law that has no certificate, and unless record and law have equally many joints.
    """
    instance("record", record, Record, StateError, "a fjr.Record")
    instance("law", law, TrackingLaw, StateError, "v-dPBC, a fjr.TrackingLaw, whose V decays")
    if (n := record.u.shape[1]) != law.robot.n:
        raise StateError(f"record and law have {n} and {law.robot.n} joints; expected equal")
    second = SecondPass(FirstPass(record, law, axes or JointTolerances.plain(n), size), beta)
    for part in parts_of(record, size):
        second.add(part)
    return second.result(velocities_measured)


class FirstPass:
    """What the parts of a record, which is never in memory as a whole, say before a SecondPass diagnoses it."""

    def __init__(self, record: AnyRecord[Record], law: TrackingLaw, axes: JointTolerances, size: int = PART) -> None:
        """Read a record in parts of `size` states; axes: names, units and tolerances of the joints."""
        self.law, self.axes, self.step, k = law, axes, record.step, len(record)
        self.reference = Visited(law.robot.n, k, CONFIGURATIONS)  # a diverging robot may be anywhere else
        self.visited = Visited(law.robot.n, k, VISITED)
        self.intervals, self.moving = 0, not k
        for part in parts_of(record, size):
            self.reference.add(part.jets[:, 0], part.begin)
            self.visited.add(part.position[:, : law.robot.n], part.begin)
            self.intervals += len(part.consecutive())
            self.moving |= bool(np.isfinite(part.velocity).any())
        half = MOST_STATES // 2
        places = [(0, k)] if k <= MOST_STATES else [(0, half), (k - half, k)]
        self._ends = [record.part(*each) for each in places]
        self._timed = any(each.known_latency().any() for each in self._ends)
        with np.errstate(all="ignore"):  # a diverging run overflows; the comparisons below allow for it
            self._innovations = [innovations(each, law, valued=False) for each in self._ends]

    def acting(self, by_torque: bool = True) -> ActingSums:
        """Return what classifies the acting efforts; by_torque: as of effort_delay."""
        age = effort_delay(self._innovations, self.law.robot, self._timed, by_torque)
        return ActingSums(self._innovations, age, self.law.robot)

    def faults(self) -> tuple[Finding, ...]:
        """Return the faults that explain the record at both ends, where no motor was saturated.

        The measured torque reveals a saturated motor; how late efforts act is known by the motion alone.
        """
        found, ends = reduce(Innovations.followed_by, self._innovations), reduce(Record.followed_by, self._ends)
        late = foreseen(found)
        free = ~(self.acting().acting(found).cut != 0).any(axis=1)
        moved = self.acting(by_torque=False)
        acted = moved.acting(found)
        if moved.age.whole or moved.age.fraction:
            late = late + acted.late
        late = late + acted.lost
        return isolate(ends, found.rows(free), late[free], self.law, self.axes.names)


class SecondPass:
    """Diagnosis of a record by its parts, added once more: storage budget, errors by cause and growth of V, by blocks.

    Kept are the latest intervals, of which the first `_begin`, at most BEFORE, are done, and one number for each BLOCK.
    """

    def __init__(self, first: FirstPass, beta: float | None) -> None:
        """Start without parts; beta [1/s]: guaranteed rate of V, as of diagnose."""
        self._first, self._law, self._robot, self._period = first, first.law, first.law.robot, first.step
        self._kept: Innovations | None = None
        self._begin = 0
        if not first.intervals:
            return
        with np.errstate(all="ignore"):
            self._visited, self._acting = np.concatenate(first.reference.some), first.acting()
            self._beta = self._law.rate(self._visited).beta if beta is None else beta
            self._radius = float(linearize(self._law, self._visited).radii(self._period).max())
            whole = first.intervals // thresholds.BLOCK * thresholds.BLOCK
            loops = closed_loop(self._law, self._visited, self._period)
            self._propagation = CausePropagation(self._robot, loops, whole)
            decay = float(np.exp(-2 * self._beta * thresholds.BLOCK * self._period))
            self._statistics, self._growth = BlockStatistics(decay, first.axes), StorageGrowth(first.intervals)

    def add(self, part: Record, series: CertificateSeries | None = None) -> None:
        """Add a part; the intervals at its end wait for those that follow.

        series: certificate along the part; None: it is computed here.
        """
        if not self._first.intervals:
            return
        with np.errstate(all="ignore"):
            found = innovations(part, self._law, series)
            kept = self._kept = found if self._kept is None else self._kept.followed_by(found)
            self._sample_period = part.sample_period
            whole = (len(kept) - self._begin - AFTER) // thresholds.BLOCK * thresholds.BLOCK
            if whole > 0:
                self._process(kept, whole, whole)

    def result(self, velocities_measured: bool) -> Diagnosis:
        """Return the diagnosis of all parts, with the faults that explain it; velocities_measured: as of diagnose."""
        if not self._first.moving:
            return unknown("the states hold no velocities")
        with np.errstate(all="ignore"):
            diagnosis = unknown("no state with a command is followed by another state")
            if self._kept is not None:
                diagnosis = self._diagnosed(self._kept)
            if not velocities_measured or diagnosis.figures.get("spectral radius", 0.0) >= 1:
                return diagnosis  # the model needs measured velocities and close samples
            return with_findings(diagnosis, self._first.faults())

    def _diagnosed(self, kept: Innovations) -> Diagnosis:
        """Return the diagnosis without findings; kept: the intervals that wait."""
        left = len(kept) - self._begin
        self._process(kept, left // thresholds.BLOCK * thresholds.BLOCK, left)
        figures = {**self._growth.figures, "spectral radius": self._radius}
        first, last = self._growth.thirds
        if self._radius >= 1 and not (last < thresholds.FALLEN * first):
            return violated(NO_DECAY, (SAMPLING,), figures)
        grown = growth(self._growth.highest, self._statistics.floor(self._first.axes.storage(self._law)))
        return self._with_delay(self._statistics.conclude(grown, figures))

    def _with_delay(self, diagnosis: Diagnosis) -> Diagnosis:
        """Return the diagnosis with the age of the effort as a share of the delay margin of the loop."""
        late = diagnosis.figures["effort age"]
        loops = importing.module_if_there("fjr_design.stability.sampled_loop")
        if late < thresholds.EXACT * self._period or loops is None:
            return diagnosis
        margin = self._period * loops.check(self._law, self._period, 0.0, self._visited).delay_margin
        share = f", {100 * late / margin:.0f} % of the delay margin" if margin else ""
        sentence = f"{diagnosis.sentence}; the effort acts {1e3 * late:.3g} ms late{share}"
        return replace(diagnosis, sentence=sentence, figures={**diagnosis.figures, "delay margin": margin})

    def _process(self, kept: Innovations, in_blocks: int, count: int) -> None:
        """Process the next `in_blocks` intervals in blocks, and `count` for the growth of V and the figures."""
        robot, period, begin = self._robot, self._sample_period, self._begin
        acted = self._acting.acting(kept, begin)
        blocks = slice(begin, begin + in_blocks)
        ahead = slice(begin, begin + in_blocks + 1)  # one more, whose law effort shows what a gap missed
        budget = storage_budget(kept.rows(blocks), acted.rows(blocks), robot, self._beta, period)
        self._statistics.add(budget, self._propagation.errors(kept.rows(ahead), acted.rows(ahead), period))
        self._growth.add(kept.rows(slice(begin, begin + count)), period)
        self._growth.figures["effort age"] = acted.age * self._period
        end = begin + count
        self._begin = min(end, BEFORE)
        self._kept = kept.rows(slice(end - self._begin, None))


def with_findings(diagnosis: Diagnosis, findings: tuple[Finding, ...]) -> Diagnosis:
    """Return the diagnosis with what was found; a run with a fault of the robot or its signals does not hold.

    That nothing explains the residual torques is said only where the cause is a model mismatch or not known.
    """
    known = diagnosis.kind == "holding" or (diagnosis.kind != "unknown" and MISMATCH not in diagnosis.causes)
    findings = tuple(each for each in findings if not (known and each.kind == UNKNOWN))
    if findings and diagnosis.kind == "holding":
        diagnosis = replace(diagnosis, kind="degraded", causes=(MISMATCH,), detail=MISMATCH)
    if any(each.kind == EXTERNAL for each in findings):
        diagnosis = external(diagnosis)
    sentence = "; ".join([diagnosis.sentence, *(each.sentence for each in findings)])
    return replace(diagnosis, sentence=sentence, findings=findings)


class Visited:
    """The configurations that a run visited: their box, the largest step between two, and `some` of them."""

    def __init__(self, n: int, states: int, most: int) -> None:
        """n: joints; states: how many will come, of which about `most` are kept."""
        self._stride, self._count, self._finite = max(1, states // most), 0, True
        self._least, self._largest, self._step = np.full(n, np.inf), np.full(n, -np.inf), np.zeros(n)
        self.some: list[Array] = []

    def add(self, q_l: Array, begin: int) -> None:
        """Add configurations (k, n), of which the first `begin` were there."""
        new = q_l[begin:]
        finite = np.asarray(np.isfinite(new).all(axis=1))
        self.some.append(new[finite][-self._count % self._stride :: self._stride])
        self._count, self._finite = self._count + int(finite.sum()), self._finite and bool(finite.all())
        self._least = np.minimum(self._least, new.min(axis=0, initial=np.inf))
        self._largest = np.maximum(self._largest, new.max(axis=0, initial=-np.inf))
        self._step = np.maximum(self._step, np.max(np.abs(np.diff(q_l, axis=0)), axis=0, initial=0.0))

    def rate(self, law: TrackingLaw) -> Rate:
        """Return the convergence rate of v-dPBC: proven, else sampled at visited configurations.

        For an arm of a URDF the proof holds on the smallest box that contains all visited positions and the largest
        step between two of them.
        """
        rate = law.rate()
        if rate.proven or not self._finite:
            return rate
        farthest = max(np.abs(self._least).max(), np.abs(self._largest).max())
        bounds = importing.module_if_there("fjr_proofs.verification.inertia_bounds")
        if bounds is None or not bounds.is_provable(law.robot) or farthest > FARTHEST:
            return law.rate(np.concatenate(self.some))
        domain = Domain(self._least - self._step, self._largest + self._step)
        return law.proven_rate(domain, most_boxes=bounds.few_boxes(law.robot))
