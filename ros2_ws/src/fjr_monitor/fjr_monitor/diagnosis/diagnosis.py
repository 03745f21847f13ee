# SPDX-License-Identifier: Apache-2.0
"""Diagnose a recorded run as holding, degraded, violated or unknown: whether V decayed as guaranteed, else the causes.

Only measured states and sent efforts are used.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, CertificateSeries, Prediction
from fjr_core.numerics.checks import Array
from fjr_core.numerics.one_line import brief
from fjr_core.stability.linearization import linearize

from . import thresholds
from .causes import (
    CAUSES,
    CauseErrors,
    CausePropagation,
    StorageBudget,
    closed_loop,
    detail,
    foreign,
    growth,
    highest,
    rises,
    storage_budget,
)
from .delay_estimation import AFTER, BEFORE, CANDIDATES, ActingSums, DelaySums, regular_changes
from .fault_isolation import MOST_STATES, UNKNOWN, Finding, isolate
from .record import PART, Ends, Innovations, Record, held, innovations, latency, needed
from .thresholds import JointTolerances

SAMPLING, SATURATION = "sampling", "saturation"
NO_DECAY = "V does not decay as guaranteed"
CONFIGURATIONS = 12  # of a run at which the sampled loop is linearised
_EXPLANATIONS = {
    "model mismatch": "the robot differs from the model: torques act on links or motors that the model lacks",
    SATURATION: "the effort was saturated at a limit",
    "delay": "the effort acted late",
    "loss": "states or efforts were lost",
    SAMPLING: "the loop is unstable at this sample period",
}


@dataclass(frozen=True)
class Diagnosis:
    """Result of comparing V with its guaranteed decay.

    kind: "holding": V decayed as guaranteed, to the floor that hold and noise predict. "degraded": V exceeds the floor
    and the resulting tracking error is within the tolerance. "violated": it is not, or V grew. "unknown": too few
    data. causes: of the violating blocks, the strongest first, out of "model mismatch", "saturation",
    "delay", "loss", "sampling"; empty if none is known. sentence: kind and causes as text. figures: the underlying
    numbers by name. errors: the tracking error (n,) [rad; m if the joint slides] that each cause makes.
    detail: causes with the largest of these, e.g. "delay makes 0.14 mrad at joint2". findings: faults of the robot or
    its signals, by joint, side and kind.
    """

    kind: Literal["holding", "degraded", "violated", "unknown"]
    causes: tuple[str, ...]
    sentence: str
    figures: dict[str, float]
    errors: dict[str, Array] = field(default_factory=dict, compare=False)
    detail: str = ""
    findings: tuple[Finding, ...] = ()

    def __repr__(self) -> str:
        return f"Diagnosis({self.kind}: {brief(self.sentence)})"


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
    """
    step = float(np.median(np.diff(record.t))) if len(record.t) > 1 else record.sample_period
    running = PartwiseDiagnosis(law, len(record.t), step, bool(latency(record).any()), axes)
    for part in record.parts(size):
        running.first_pass(part)
    for part in record.parts(size):
        running.second_pass(part, beta)
    return running.result(velocities_measured)


class PartwiseDiagnosis:
    """Diagnosis of a record that is never in memory as a whole: `first_pass` of all parts, then `second_pass` of all.

    Memory does not grow with the record, except by one number for each BLOCK of intervals.
    """

    def __init__(
        self, law: TrackingLaw, states: int, step: float, timed: bool, axes: JointTolerances | None = None
    ) -> None:
        """Start without parts of a record, of which is known what follows.

        states: their number. step [s]: median time between two. timed: whether latencies are known. axes: names, units
        and tolerances of the joints; None: JointTolerances.plain.
        """
        self._law, self._axes = law, axes or JointTolerances.plain(law.robot.n)
        self._step, self._timed, self._stride = step, timed, max(1, states // CONFIGURATIONS)
        self._delay = DelaySums(law.robot.n)
        self._ages = [ActingSums(age, law.robot.n) for age in CANDIDATES]
        self._ends = Ends(MOST_STATES // 2)
        self._visited: list[Array] = []
        self._intervals = self._states = 0
        self._moving = False
        self._parts = _Parts(law)
        self._second: _SecondPass | None = None

    def first_pass(self, part: Record) -> None:
        """Take a part of the record for the first time."""
        with np.errstate(all="ignore"):  # a diverging run overflows; the comparisons below allow for it
            found, begin = self._parts.add(part, None, valued=False), self._parts.begin
            required = needed(found, self._law.robot)
            regular = regular_changes(found, self._step, self._timed, begin)
            self._delay.add(found, required, regular)
            for age in self._ages:
                age.add(found, required, regular, begin)
        self._intervals += len(found) - begin
        self._parts.done(found, len(found) - begin)
        self._ends.add(part)
        self._moving |= bool(np.isfinite(part.velocity).any())
        q_ld = part.jets[part.begin :, 0]  # the reference: a diverging robot may be anywhere else
        rows = q_ld[-self._states % self._stride :: self._stride]
        self._visited.append(rows[np.isfinite(rows).all(axis=1)])
        self._states += len(q_ld)

    def second_pass(self, part: Record, beta: float | None = None, series: CertificateSeries | None = None) -> None:
        """Take a part for the second time, once all had their first pass.

        beta [1/s]: guaranteed rate of V, as of diagnose. series: certificate along the part; None: it is computed here.
        """
        if not self._intervals:
            return
        with np.errstate(all="ignore"):
            if self._second is None:
                visited, age = np.concatenate(self._visited), self._delay.delay()
                acted = next(a for a in self._ages if (a.age.whole, a.age.measured) == (age.whole, age.measured))
                acted.age = age
                beta = self._law.rate(visited).beta if beta is None else beta
                self._second = _SecondPass(self._law, self._axes, beta, self._step, visited, acted, self._intervals)
            self._second.add(part, series)

    def result(self, velocities_measured: bool = True) -> Diagnosis:
        """Return the diagnosis of all parts, with the faults that explain it; velocities_measured: as of diagnose."""
        if not self._moving:
            return unknown("the states hold no velocities")
        with np.errstate(all="ignore"):
            none = unknown("no state with a command is followed by another state")
            diagnosis = self._second.result() if self._second else none
            if not velocities_measured or SAMPLING in diagnosis.causes:
                return diagnosis  # the model needs measured velocities and close samples
            findings = isolate(self._ends.record(), self._law, self._axes.names)
        known = diagnosis.kind in ("degraded", "violated") and "model mismatch" not in diagnosis.causes
        explained = known or diagnosis.kind == "holding"
        findings = tuple(each for each in findings if not (explained and each.kind == UNKNOWN))
        sentence = "; ".join([diagnosis.sentence, *(each.sentence for each in findings)])
        return replace(diagnosis, sentence=sentence, findings=findings)


class _Parts:
    """The latest intervals of a record that comes in parts: `found`, of which the first `begin` are done."""

    def __init__(self, law: TrackingLaw) -> None:
        self._certificate, self._prediction = Certificate(law), Prediction(law)
        self._efforts: Array | None = None
        self.found: Innovations | None = None
        self.begin = 0

    def add(self, part: Record, series: CertificateSeries | None, valued: bool = True) -> Innovations:
        """Add the intervals of the next part; return all that are kept."""
        known = self._efforts is not None and len(self._efforts) > part.begin
        before = self._efforts[-part.begin - 1] if known else None  # type: ignore[index]
        found = innovations(part, self._certificate, self._prediction, series, before, valued)
        self._efforts = held(part.u, before)
        self.found = found if self.found is None else self.found.followed_by(found)
        return self.found

    def done(self, found: Innovations, count: int) -> None:
        """Note that `count` more intervals are done; keep BEFORE of these and the later ones."""
        end = self.begin + count
        self.begin = min(end, BEFORE)
        self.found = found.rows(slice(end - self.begin, None))


class _SecondPass:
    """Second pass over the parts of a record: storage budget, tracking errors by cause and growth of V, by blocks."""

    def __init__(
        self,
        law: TrackingLaw,
        axes: JointTolerances,
        beta: float,
        period: float,
        visited: Array,
        acted: ActingSums,
        total: int,
    ) -> None:
        """visited (m, n): configurations of the reference. total: number of intervals."""
        self._robot, self._beta, self._acting, self._total = law.robot, beta, acted, total
        self._tolerated = axes.storage(law)
        self._radius = float(linearize(law, visited).radii(period).max())
        whole = total // thresholds.BLOCK * thresholds.BLOCK
        self._propagation = CausePropagation(law.robot, closed_loop(law, visited, period), whole)
        self._statistics = BlockStatistics(float(np.exp(-2 * beta * thresholds.BLOCK * period)), axes)
        self._parts, self._done, self._period = _Parts(law), 0, period
        self._rise = (np.inf, np.nan)
        self._highest: Array = np.zeros((2, 0))
        self._V = np.zeros(2)  # largest in the first and in the last third
        self._figures = {"intervals": float(total), "effort age": 0.0, "gaps": 0.0, "unanswered": 0.0}
        self._figures |= {"largest V": -np.inf, "last V": np.nan}

    def add(self, part: Record, series: CertificateSeries | None) -> None:
        """Add a part; the intervals at its end wait for those that follow."""
        found = self._parts.add(part, series)
        self._sample_period, self._limit = part.sample_period, part.effort_limit
        whole = (len(found) - self._parts.begin - AFTER) // thresholds.BLOCK * thresholds.BLOCK
        if whole > 0:
            self._process(found, whole, whole)

    def result(self) -> Diagnosis:
        """Return the diagnosis without findings."""
        if (found := self._parts.found) is not None:
            left = len(found) - self._parts.begin
            self._process(found, left // thresholds.BLOCK * thresholds.BLOCK, left)
        figures = {**self._figures, "spectral radius": self._radius}
        first, last = self._V
        if self._radius >= 1 and not (last < thresholds.FALLEN * first):
            return violated(NO_DECAY, (SAMPLING,), figures)
        return self._statistics.conclude(growth(self._highest, self._statistics.floor(self._tolerated)), figures)

    def _process(self, kept: Innovations, in_blocks: int, count: int) -> None:
        """Process the next `in_blocks` intervals in blocks, and `count` for the growth of V and the figures."""
        robot, period, limit, begin = self._robot, self._sample_period, self._limit, self._parts.begin
        acted = self._acting.acting(kept, needed(kept, robot))
        blocks = slice(begin, begin + in_blocks)
        ahead = slice(begin, begin + in_blocks + 1)  # one more, whose law effort shows what a gap missed
        budget = storage_budget(kept.rows(blocks), acted.rows(blocks), robot, self._beta, period, limit)
        made = self._propagation.errors(kept.rows(ahead), acted.rows(ahead), period, limit)
        self._statistics.add(budget, made)
        self._follow(kept.rows(slice(begin, begin + count)), acted.age)
        self._done += count
        self._parts.done(kept, count)

    def _follow(self, found: Innovations, age: float) -> None:
        """Follow V through the next intervals and count what the figures report."""
        if not len(found):
            return
        risen = rises(found, self._limit, *self._rise)
        foreign_last = bool(foreign(found.rows(slice(-1, None)), self._limit)[0])
        self._rise = (float(risen[1, -1]), np.inf if foreign_last else float(found.V1[-1]))
        self._highest = highest(np.hstack([self._highest, risen]))
        third, places = max(1, self._total // 3), self._done + np.arange(len(found))
        for i, rows in enumerate((places < third, places >= self._total - third)):
            self._V[i] = np.maximum(self._V[i], found.V1[rows].max(initial=0.0))
        figures = self._figures
        figures["effort age"] = age * self._period
        figures["gaps"] += float((found.dt > thresholds.GAP * self._sample_period).sum())
        figures["unanswered"] += float((~found.answered).sum())
        figures["largest V"] = float(np.maximum(figures["largest V"], found.V1.max()))
        figures["last V"] = float(found.V1[-1])


class BlockStatistics:
    """The blocks of a loop that is stable at its sample period, counted."""

    def __init__(self, decay: float, axes: JointTolerances) -> None:
        """decay: guaranteed factor of V in a block."""
        self._decay, self._axes = decay, axes
        self._envelope = np.zeros(len(axes.tolerance))
        self._graded = np.zeros(2, dtype=bool)  # whether any block is judged; of these, any outside a transient
        self._within = np.ones(2, dtype=bool)
        self._errors = np.zeros((2, len(CAUSES), len(axes.tolerance)))
        self._blocks = self._counted = self._above = 0
        self._strongest = np.zeros(len(CAUSES), dtype=int)
        self._hold = self._slack = 0.0
        self._added: list[Array] = []

    def add(self, blocks: StorageBudget, made: CauseErrors) -> None:
        """Add blocks and the tracking errors by cause in them; only those with `judged` can be violated."""
        causes = np.maximum(blocks.causes[blocks.judged], 0.0)
        allowed = (blocks.slack + thresholds.PREDICTED * (blocks.hold + blocks.noise))[blocks.judged]
        above = ~(causes.sum(axis=1) <= allowed)
        self._blocks += len(blocks.judged)
        self._counted += len(above)
        self._above += int(above.sum())
        self._strongest += np.bincount(np.argmax(causes[above], axis=1), minlength=len(CAUSES))
        self._hold += float(blocks.hold.sum())
        self._slack += float(blocks.slack.sum())
        self._added.append(blocks.hold + blocks.noise)
        self._grade(made, blocks.judged)

    def _grade(self, made: CauseErrors, judged: NDArray[np.bool_]) -> None:
        """Keep the largest error (n,) due to each cause in the judged blocks, and in those outside a transient.

        The loop's own error is bounded by an envelope that decays from block to block with the square root of the
        guaranteed factor of V. A block belongs to a transient if that envelope exceeds both the tolerance (n,) and the
        errors due to the causes; if all judged blocks do, all count. Within the tolerance: the errors due to the causes
        are at most the tolerance plus RELATIVE times the envelope.
        """
        total, own, tolerance = made.peaks.sum(axis=1), made.own.copy(), self._axes.tolerance
        for value in own:  # the running maximum, multiplied by the decay from block to block
            np.maximum(value, np.sqrt(self._decay) * self._envelope, out=value)
            self._envelope = value
        settled = judged & ~((own > tolerance) & (own > total)).any(axis=1)
        within = (total <= tolerance + thresholds.RELATIVE * own).all(axis=1)
        for i, rows in enumerate((judged, settled)):
            self._graded[i] |= rows.any()
            self._within[i] &= within[rows].all()
            self._errors[i] = np.maximum(self._errors[i], made.peaks[rows].max(axis=0, initial=0.0))

    def floor(self, tolerated: float) -> float:
        """Return the storage [J] that hold, noise and the tolerated tracking error explain.

        tolerated [J]: storage of the tolerated error. The remainder is the level at which the decay in a block equals
        the lower quartile of what hold and noise add. The quartile keeps a diverging loop from raising its own floor.
        """
        if not self._blocks:
            return tolerated
        added = np.concatenate(self._added)
        explained = np.quantile(np.where(np.isfinite(added), added, np.finfo(float).max), 0.25)
        return tolerated + thresholds.PREDICTED * float(explained) / max(1 - self._decay, np.finfo(float).eps)

    def conclude(self, grown: float, figures: dict[str, float]) -> Diagnosis:
        """Diagnose the blocks; grown: growth of V over its lowest value and its floor. figures: further numbers."""
        share, strongest = self._above / max(1, self._counted), self._strongest / max(1, self._above)
        figures = {**figures, "blocks": float(self._counted), "violated share": share, "growth of V": grown}
        figures |= {f"violated by {cause}": float(strongest[i] * share) for i, cause in enumerate(CAUSES)}
        order = np.argsort(-strongest, kind="stable")
        causes = tuple(CAUSES[i] for i in order if strongest[i] >= thresholds.CAUSE_SHARE)
        if grown > thresholds.DIVERGED:  # the hold is the cause if it added more to V than the decay removed
            causes = causes or ((SAMPLING,) if self._hold > self._slack else ())
            return violated(f"V grew to {grown:.2g} times its floor", causes, figures)
        if self._blocks < thresholds.FEWEST:
            states = int(figures.get("intervals", self._blocks * thresholds.BLOCK))
            fewest = thresholds.FEWEST * thresholds.BLOCK
            return unknown(f"{states} consecutive states with a command; expected {fewest}", figures)
        if self._counted < max(thresholds.FEWEST, thresholds.JUDGED * self._blocks):
            return unknown("most efforts sent are not those of the law", figures)
        which = int(self._graded[1])
        errors = dict(zip(CAUSES, self._errors[which], strict=True)) if self._graded[which] else {}
        often = share >= thresholds.HIGH_SHARE or (share >= thresholds.SHARE and self._above >= thresholds.FEWEST)
        if grown > thresholds.EXCEEDED or often:
            size, why = detail(causes, errors, self._axes), _why(causes)
            if causes and self._within[which] and SATURATION not in causes:
                sentence = f"{size}, within the tolerance: {why}"
                return Diagnosis("degraded", causes, sentence, figures, errors, size)
            sentence = f"{NO_DECAY}: {why}" + (f"; {size}" if size else "")
            return Diagnosis("violated", causes, sentence, figures, errors, size)
        if share > thresholds.SHARE_OF_FEW:
            few = f"V exceeds its floor in {self._above} of {self._counted} blocks; expected more blocks"
            return unknown(few, figures)
        sentence = "V decays as guaranteed, down to the floor that hold and noise predict"
        return Diagnosis("holding", (), sentence, figures, errors)


def unknown(reason: str, figures: dict[str, float] | None = None) -> Diagnosis:
    """Return "unknown" with the reason."""
    return Diagnosis("unknown", (), f"no diagnosis: {reason}", figures or {})


def violated(what: str, causes: tuple[str, ...], figures: dict[str, float]) -> Diagnosis:
    """Return "violated" with what was seen and the causes, the strongest first."""
    return Diagnosis("violated", causes, f"{what}: {_why(causes)}", figures, {}, ", ".join(causes))


def _why(causes: tuple[str, ...]) -> str:
    return "; ".join(_EXPLANATIONS[cause] for cause in causes) or "the cause is unknown"
