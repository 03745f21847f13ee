# SPDX-License-Identifier: Apache-2.0
"""From a measured sample to an effort: the reference's clock, the law u(x, x, t) and what keeps it safe; without ROS.

sample -> order of the stamps -> limits of the state -> law -> finite -> ramp or blend -> effort limits -> rate -> u
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from fjr_core import GainsError, Reference, StateError, TrajectoryError
from fjr_core.control.robust import Robust, RobustLaw, sampled_law
from fjr_core.control.safety_settings import Settings
from fjr_core.control.sampled_law import BoundStep
from fjr_core.control.static_law import BoundCommand, StaticLaw
from fjr_core.monitoring.wiring.check import WiringCheck
from fjr_core.numerics.checks import Array
from fjr_core.trajectories.reference import JETS

from .bound_start import Certificate
from .events import ERROR, INFO, WARN, Journal, State
from .law_state import Recollection
from .limits import EffortLimits, StateLimits, StopPolicy
from .stamp_order import Order, Stamps
from .supervisor import Course

if TYPE_CHECKING:
    from fjr_msgs_py.messages.joint_states import JointSample

OBSERVED = 5  # samples that an observer gets when it begins anew before its velocities count


class Observer(Protocol):
    """What the tracker needs of an observer of the velocities."""

    def reset(self) -> None:
        """Begin anew."""

    @property
    def state(self) -> Array:
        """The estimate (4n,): q_l, q_m [rad], dq_l, dq_m [rad/s]."""

    @property
    def fresh(self) -> bool:
        """Whether the last update began anew, so that the velocities are not known yet."""

    def update(self, stamp: int, q_l: Array, q_m: Array, u: Array) -> object:
        """Make the estimate for positions (n,) [rad] measured at the stamp [ns]; u (n,) [N m] acted till then."""


@dataclass(slots=True)
class Command:
    """The answer to a sample; its arrays are good until the next answer.

    u (n,) [N m]: the effort to send, always finite and within its limits. jets (5, n): the reference at the
    sample's stamp. V [J]: the storage, nan where u is not the law's answer (a stop, an effort that was not finite).
    velocity, position (2n,): dq_l, dq_m and q_l, q_m that the law saw. state: what the tracker does now.
    restarted: the stamps jumped back and the reference began again with this sample.
    """

    u: Array
    jets: Array
    V: float
    velocity: Array
    state: State
    restarted: bool
    position: Array


class Tracker:
    """Answers stamped samples with efforts.

    States. waiting: before the first sample. joining: the effort is ramped or blended, or the reference leads
    from the measured state into the wanted one. tracking. stopped: a limit of position, velocity, deflection or
    tracking error was broken, or the start was refused; latched: every sample is answered by the stop policy
    (`Settings.on_stop`; gravity_hold damps the motors by K_md) until resume() or start().

    Wiring. From the first sample on, and again after resume(), measured velocities are compared with the slopes of the
    positions and both equations of each joint with the efforts (fjr_core.monitoring.wiring), until every joint was seen
    to follow. Exchanged joints and wrong signs stop the tracker, without any effort, even where on_stop is
    gravity_hold.
    With an observer there are no measured velocities, and nothing is compared.

    Order of stamps. A sample older than the last one is not answered (None), a repeated stamp is answered again.
    A stamp that jumped back by more than state_timeout, or an older one after nothing newer came for that long,
    is another beginning (a robot that was reset, a bag that loops), as after start(); but a stop stays latched.
    Where time is simulated a pause between arrivals is no silence; where it is not, the first sample of a jump is not
    answered (None): it counts only when the next one confirms it.
    A stamp that jumped forward by more than state_timeout, or a sample after a silence of that length by the
    arrival clock, is a recovery: the reference's clock goes on, the reference is joined from the measured positions
    and velocities over recovery.join_time, and the effort leaves the last one sent without a step, in a twentieth of
    that time: u = u_law + (1 - s) (u_last - u_law(0)) with a C^1 smoothstep s (fading.Fade). The reference's time is
    0 at the first answered stamp.

    With an observer that begins anew, at a break or by itself, velocities count from the OBSERVED-th sample after that
    on: till then the effort stays as it is, at a beginning as after a stop, and then tracking begins or recovers.
    Meanwhile the limits of velocities are not looked at, nor is the tracking error: the reference is joined later.

    Effort. Ramp (from the stop policy's effort) or blend, then the effort limits, then the rate limit against the
    last effort sent, over the difference of the stamps (at most state_timeout; the first effort comes from zero). A
    stop's effort passes both limits too; the single efforts of silence() and stop_effort() pass the first only. Where
    the law's effort is not finite the stop policy's without a sample leaves; the sample leaves no other trace: what
    it was the occasion for waits for the next one. Outside the limits of the state nothing is joined or resumed.

    Robust action (robust): the law then has a memory (docs/robust.md), which moves on once with each sample that the
    law answers, by the effort that really left, over the difference of the stamps. A repeated stamp moves nothing. It
    begins anew where a sample does not follow such a one (a start, a jump, a silence, a stop, an effort that was not
    finite, blind samples); with other gains it goes on. The reference is taken `lead` later, where the state is
    predicted to.

    events: what happened, for the caller to take out. counters, with stable names:
    "states older than the last", "states repeated", "jumps doubted", "reference restarts", "silences",
    "forward jumps", "observer restarts", "recoveries",
    "starts refused", "stops" and of these "stops: wiring", "stops: link position", "stops: motor position",
    "stops: link velocity", "stops: motor velocity", "stops: deflection", "stops: tracking error"; "resumes",
    "efforts not finite",
    "efforts saturated" and of these "efforts saturated: <joint>", "efforts rate limited", "gains changed",
    "settings changed", "references changed", "holds".
    """

    def __init__(
        self,
        law: StaticLaw,
        reference: Reference,
        settings: Settings,
        observer: Observer | None = None,
        simulated_time: bool = False,
        robust: Robust | None = None,
    ) -> None:
        journal = Journal()
        self.events, self.counters = journal.events, journal.counters
        self._law, self._observer, self._settings, self._journal = law, observer, settings, journal
        self._stamps, self._limits = Stamps(settings.state_timeout, simulated_time), StateLimits(settings)
        self._reference, self._course = reference, Course(reference, settings, self._limits, journal)
        self._efforts, self._policy = EffortLimits(settings), StopPolicy(law, settings)
        self._jets = np.zeros((JETS, law.robot.n))
        self._sampled = sampled_law(law, robust)
        self._lead = round(self._sampled.lead * 1e9)
        self._bound, self._memory = self._bind(law)
        self._stopped, self._bad, self._clipped, self._first_stamp = 0, False, False, 0
        checks = settings.wiring_check and observer is None
        self._wiring = WiringCheck(law.robot) if checks else None

    @property
    def state(self) -> State:
        """What the tracker does with samples now."""
        if self._course.reason:
            return State.STOPPED
        if self._stamps.last is None:
            return State.WAITING
        return State.JOINING if self._course.joining else State.TRACKING

    @property
    def reason(self) -> str:
        """Why it is stopped, one sentence; empty otherwise."""
        return self._course.reason

    @property
    def last_stamp(self) -> int | None:
        """Stamp [ns] of the last sample that was answered by the law or a stop; None before the first."""
        return self._stamps.last

    @property
    def end(self) -> float:
        """Stamp [ns] from which on the running reference stands still; inf for never or before the first sample."""
        return self._course.reference.end

    @property
    def certificate(self) -> Certificate | None:
        """Where the bound on V began and where V is; None while the effort sent is not the law's own."""
        return self._course.watch.certificate

    @property
    def seconds(self) -> dict[str, float]:
        """Times by the stamps [s]: "in saturation", "in saturation: <joint>", "stopped"."""
        joints = zip(self._settings.joints, self._efforts.seconds, strict=True)
        each = {f"in saturation: {joint}": float(seconds) for joint, seconds in joints}
        return {"in saturation": self._efforts.seconds_any, **each, "stopped": self._stopped * 1e-9}

    def warm_up(self) -> None:
        """Build everything that is built once, so that the first sample is answered as fast as any other."""
        n = self._law.robot.n
        self._course.reference.jets(0)
        self._policy.moving(np.zeros(n), np.zeros(n))
        if self._observer is not None:
            for stamp in (0, 1_000_000):
                self._observer.update(stamp, *(np.zeros(n),) * 3)
            self._observer.reset()

    def start(self, reference: Reference | None = None) -> None:
        """Begin afresh, as at birth: the next sample is the first, and the rules of the start apply to it.

        reference: to be followed, whose time 0 is there; None: that of the last start. Nothing else that was asked
        for is left, nor a stop. Law, settings, events and counters stay.
        """
        self._reference = self._reference if reference is None else reference
        self._stamps.forget()
        self._course = Course(self._reference, self._settings, self._limits, self._journal)
        self._look_again()

    def answer(self, sample: JointSample, arrival: int) -> Command | None:
        """The command for a sample that arrived at `arrival` [ns, steady clock]; None: too old, nothing is to be sent.

        Raises StateError where the sample has no velocities and there is no observer.
        """
        stamp = sample.stamp
        order = self._stamps.judge(stamp, arrival)
        if order is Order.OLDER:
            self._journal.count("states older than the last")
            return None
        if order is Order.DOUBTED:
            self._journal.count("jumps doubted")
            return None
        if not self._measure(sample, order):
            return self._unanswerable(stamp)
        self._check_wiring(order, stamp)
        course, observed = self._course, self._unknown(order)
        if not course.is_even(order, stamp, observed):
            try:
                course = course.turned(order, stamp, observed)
            except TrajectoryError:  # a state so far out that no motion leads back from it
                return self._unanswerable(stamp)
        jets = course.jets(stamp)
        wanted, V = self._wanted(course, jets, order, stamp)
        if not wanted.dot(wanted) < np.inf:
            return self._unanswerable(stamp)
        if course is not self._course:
            self._course = course.taken(self._journal)
        self._policy.remember(self._limits.q_l)
        u = self._send(wanted, V, stamp)
        if self._memory is not None:
            self._memory.accept()
        if self._wiring is not None and order is not Order.REPEATED:
            self._wiring.sent(u)
        self._accept(stamp, arrival)
        return self._command(u, jets, V, order is Order.BACK)

    def silence(self, now: int) -> Array | None:
        """The stop effort (n,) when nothing came for state_timeout, once; else None.

        now [ns]: of the arrival clock, or of the stamps' where time is simulated.
        """
        if not self._stamps.silent(now):
            return None
        seconds = self._stamps.timeout * 1e-9
        self._journal.say(WARN, "silences", f"no state for more than {seconds:g} s: the stop effort is sent")
        return self.stop_effort()

    def stop_effort(self) -> Array:
        """The stop policy's effort (n,) without a sample, finite and within the limits; it counts as sent.

        zero: zeros. gravity_hold: the weight B_m^-1 grad P_l(q_l) at the last good sample, zeros before the first.
        """
        u = self._efforts.cut(self._policy.standing())
        self._efforts.replace(u)
        if self._memory is not None:
            self._memory.forget()
        self._course.watch.void()
        return u

    def settings(self, settings: Settings) -> None:
        """Other settings from the next sample on; stops stay latched, what is under way stays as it is."""
        self._settings = self._course.settings = settings
        self._stamps.limit(settings.state_timeout)
        self._limits.limit(settings)
        self._efforts.limit(settings)
        self._policy.limit(self._law, settings)
        self._journal.say(INFO, "settings changed", "limits and stop policy changed")

    def use(self, law: StaticLaw) -> None:
        """Another law (other gains) from the next sample on; the certificate begins anew, the memory goes on.

        Raises GainsError where its efforts are not finite; then the law stays.
        """
        before = self._memory
        self._bound, self._memory = self._bind(law)
        if before is not None and isinstance(self._bound, BoundStep):
            self._memory = before.taken_over(self._bound)
        self._law = law
        self._policy.limit(law, self._settings)
        self._course.watch.void()
        self._journal.say(INFO, "gains changed", "gains changed: the certificate begins anew")

    def jets_at(self, stamp: int) -> Array | None:
        """Jets (5, n) that the running reference has at `stamp` [ns]; None before the first sample.

        With these a trajectory that is to follow begins: Spline(..., start=tracker.jets_at(start)).
        """
        return self._course.reference.jets(stamp) if self._course.reference.begun else None

    def follow(self, reference: Reference, start: int | None = None) -> None:
        """Another reference whose time 0 is at the stamp `start` [ns], None: the next sample's.

        Until `start` the running one goes on; with robust action that predicts, the law takes this one over `lead`
        early, where the state is predicted to. Where its jets at time 0 are those of the running one at `start` to
        rounding (1e-6) it takes over as it is, and u has no step; else it is joined from the running one over
        recovery.join_time (with 0 it takes over all the same). Before the first sample it takes the place of the
        reference, with time 0 at that sample. It replaces what was to follow and has not begun, also a hold. While
        stopped it is taken too, and resume() joins it from the measured state.
        """
        self._course.follow(reference, start)

    def hold(self) -> None:
        """Come to rest from the next sample on, C^4 from the running reference, and stand there.

        The speed dq is lost within T = max |dq| / hold.deceleration (0.2 s to 2 s), on dq T / 2. While stopped or
        before the first sample: stand where the links are at the next sample.
        """
        self._course.hold()

    def resume(self) -> None:
        """End a stop: the next sample is answered by the law, the reference joined from the measured state.

        As a recovery does it, over recovery.join_time; with 0 at once. Where that is 0, a refused start begins again
        instead, and is checked again. A sample outside the limits stops again. Nothing happens where nothing is
        stopped.
        """
        if self._course.reason:
            self._look_again()
        self._course.resume()

    def _measure(self, sample: JointSample, order: Order) -> bool:
        """Take the sample's positions and velocities in, or an observer's; False where they are not finite."""
        m = self._limits
        if self._observer is None:
            if sample.dq_l is None or sample.dq_m is None:
                raise StateError("the sample has no velocities; expected them, or an observer")
            m.q_l[...], m.q_m[...] = sample.q_l, sample.q_m
            m.dq_l[...], m.dq_m[...] = sample.dq_l, sample.dq_m
        elif order is not Order.REPEATED:
            if order is not Order.NEXT:
                self._observer.reset()
            self._observer.update(sample.stamp, sample.q_l, sample.q_m, self._efforts.left)
            m.state[...] = self._observer.state
        return bool(m.state.dot(m.state) < np.inf)

    def _look_again(self) -> None:
        """Check the wiring from the next sample on, and let the stop policy give efforts again."""
        self._policy.released = False
        if self._wiring is not None:
            self._wiring.start()

    def _check_wiring(self, order: Order, stamp: int) -> None:
        """Stop where the samples so far show that efforts or sensors are connected wrongly."""
        wiring, m = self._wiring, self._limits
        if wiring is None or wiring.done or order is Order.REPEATED:
            return
        if order is not Order.NEXT:
            wiring.skip()
            self._first_stamp = stamp
        fault = wiring.see((stamp - self._first_stamp) * 1e-9, m.position, m.velocity)
        if fault is not None and not self._policy.released:
            self._policy.released = True
            joints = self._settings.joints
            self._course.refuse_wiring(fault.sentence(joints), joints[fault.joints[0]])

    def _unknown(self, order: Order) -> int:
        """Samples that the velocities need before they count."""
        if self._observer is None or order is Order.REPEATED:
            return 0
        return OBSERVED if self._observer.fresh else 0

    def _wanted(self, course: Course, jets: Array, order: Order, stamp: int) -> tuple[Array, float]:
        """What is to be sent before ramp, blend and limits, with V; the law is not asked while stopped or blind."""
        m = self._limits
        if self._memory is not None and (course.reason or course.blind):
            self._memory.forget()
        if course.reason:
            return self._policy.moving(m.q_l, m.dq_m), math.nan
        if course.blind and course.starting:
            return self._policy.at(m.q_l), math.nan
        if course.blind:
            return self._efforts.sent.copy(), math.nan
        if self._memory is not None:
            return self._remembered(self._memory, course, jets, order, stamp)
        np.copyto(self._jets, jets)
        self._bound.evaluate()
        return self._bound.u.copy(), self._bound.V.item()

    def _remembered(
        self, memory: Recollection, course: Course, jets: Array, order: Order, stamp: int
    ) -> tuple[Array, float]:
        """The same of a law with a memory; not finite where that would not be."""
        np.copyto(self._jets, course.reference.jets(stamp + self._lead) if self._lead else jets)
        last = self._stamps.last
        memory.place(order, 0 if last is None else stamp - last, self._efforts.left)
        self._bound.evaluate()
        return self._bound.u.copy() if memory.finite else np.full(self._law.robot.n, np.nan), self._bound.V.item()

    def _bind(self, law: StaticLaw) -> tuple[BoundCommand | BoundStep, Recollection | None]:
        """The law from the measured state and the jets, evaluated: built, and as fast as any other time.

        With what minds its memory, where it has one. Raises GainsError where its effort is not finite there, or with
        every position and velocity at 1.
        """
        state, arrays = self._limits.state, (self._limits.position, self._limits.velocity, self._jets)
        measured, memory = state.copy(), None
        bound: BoundCommand | BoundStep
        if isinstance(self._sampled, RobustLaw):
            self._sampled = self._sampled.with_law(law)
            bound = step = self._sampled.bound(*arrays)
            memory = Recollection(step)
        else:
            bound = law.bound(*arrays)
        finite = True
        for place in (np.ones_like(state), measured if measured.dot(measured) < np.inf else 0.0):
            state[...] = place
            bound.evaluate()
            finite = finite and bool(bound.u.dot(bound.u) < np.inf)
        state[...] = measured
        if not finite:
            which = "'gains.*'" if memory is None else "'gains.*' and 'robust.*'"
            raise GainsError(f"parameters {which} give an effort that is not finite; expected smaller gains")
        return bound, memory

    def _send(self, wanted: Array, V: float, stamp: int) -> Array:
        """The effort that leaves; the certificate goes on only where it is the law's own."""
        efforts, watch = self._efforts, self._course.watch
        u = efforts.send(self._course.fade.apply(wanted, efforts.sent, self._policy.standing, stamp), stamp)
        if u is wanted and math.isfinite(V):
            watch.see(stamp, V)
        else:
            watch.void()
        if efforts.clipped or self._clipped:
            self._report_saturation()
        if efforts.slowed:
            self._journal.count("efforts rate limited")
        return u

    def _report_saturation(self) -> None:
        """Count each sample and joint; an event where it begins."""
        efforts, began = self._efforts, not self._clipped
        self._clipped = efforts.clipped
        if not efforts.clipped:
            return
        joints = [joint for joint, over in zip(self._settings.joints, efforts.saturated, strict=True) if over]
        for joint in joints:
            self._journal.count(f"efforts saturated: {joint}")
        if began:
            sentence = f"the effort of {', '.join(joints)} is at its limit"
            self._journal.say(WARN, "efforts saturated", sentence, joint=joints[0])
        else:
            self._journal.count("efforts saturated")

    def _accept(self, stamp: int, arrival: int) -> None:
        if self._course.reason and self._stamps.last is not None:
            self._stopped += min(max(stamp - self._stamps.last, 0), self._stamps.timeout)
        self._stamps.accept(stamp, arrival)
        self._bad = False

    def _unanswerable(self, stamp: int) -> Command:
        """The stop policy's effort without a sample, for one that has no finite effort."""
        sentence = "the effort is not finite for a state: the stop effort is sent instead"
        if self._bad:
            self._journal.count("efforts not finite")
        else:
            self._journal.say(ERROR, "efforts not finite", sentence)
        self._bad = True
        if self._observer is not None:
            self._observer.reset()
        if self._memory is not None:
            self._memory.forget()
        u = self._send(self._policy.standing(), math.nan, stamp)
        jets = self._course.reference.jets(stamp)
        return self._command(u, jets, math.nan, False)

    def _command(self, u: Array, jets: Array, V: float, restarted: bool) -> Command:
        return Command(u, jets, V, self._limits.velocity, self.state, restarted, self._limits.position)
