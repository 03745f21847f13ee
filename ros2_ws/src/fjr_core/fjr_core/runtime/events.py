# SPDX-License-Identifier: Apache-2.0
"""Names, levels and sentences of the events and counters of the control step."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from .safety_settings import Settings

NEVER = -(2**63)  # FJR_NEVER: no stamp

STOPS, STARTS_REFUSED = "stops", "starts refused"
"""Kinds of the events that end tracking."""
CONTACTS, POSITION_JUMP, NO_MOTION, SILENCE = "contacts", "position jump", "no motion", "silence"
LIMITED = {
    "link position": ("q_l", "position"),
    "motor position": ("q_m", "position"),
    "link velocity": ("dq_l", "velocity"),
    "motor velocity": ("dq_m", "velocity"),
    "deflection": ("q_m - q_l", "position"),
    "tracking error": ("q_l - q_ld", "position"),
    POSITION_JUMP: ("change of q_l", "position"),
    "contact": ("external torque", "effort"),
    NO_MOTION: ("change of q_m that its effort must have made", "position"),
}
"""Limited quantities, in the order of their stops: symbol, and field of Units."""
KINDS = (
    "states older than the last",
    "states stale",
    "states late",
    "states repeated",
    "states frozen",
    "jumps doubted",
    "reference restarts",
    "silences",
    "forward jumps",
    "observer restarts",
    "recoveries",
    STARTS_REFUSED,
    STOPS,
    *(f"stops: {cause}" for cause in ("wiring", *LIMITED, SILENCE, "law")),
    "resumes",
    "efforts not finite",
    "efforts saturated",
    "efforts rate limited",
    "gains changed",
    "settings changed",
    "references changed",
    "holds",
    CONTACTS,
)
"""Names of the counters, in the order of enum fjr_kind in step.h."""
ERRORS = (STARTS_REFUSED, STOPS, "states frozen", "efforts not finite")
WARNINGS = (
    *("states late", "reference restarts", "silences", "forward jumps", "observer restarts", "efforts saturated"),
    CONTACTS,
)
"""Kinds of events by level; all others inform."""


def level_of(kind: str) -> str:
    """Return the level of an event: info, warn or error."""
    return "error" if kind in ERRORS else "warn" if kind in WARNINGS else "info"


SENTENCES = {
    "effort sign": "the effort of {joints} acts with the wrong sign",
    "efforts exchanged": "the efforts of {joints} are exchanged",
    "encoder sign": "the {side} encoder of {joints} has the wrong sign",
    "encoders exchanged": "the {side} encoders of {joints} are exchanged",
    "velocity sign": "the {side} velocity of {joints} has the sign opposite to its position's slope",
    "velocity of another joint": "the {side} velocity of {first} is that of {last}, or hums with the mains",
}
"""Sentence of each kind of wiring fault, in the order of enum fjr_wiring_kind in step.h."""


@dataclass(frozen=True)
class Finding:
    """Fault of a robot, its signals or a record of them.

    kind: of SENTENCES (wiring), or e.g. "Coulomb friction" (diagnosis), "gear_ratio" (record); "a or b": these fit
    equally well, size is that of a. joint: its name, "a and b" if two are exchanged, "": unknown or all. side: "link",
    "motor", "joint" (the spring between the two) or empty. size, unit: magnitude, NaN: not known. share: part of the
    residual torque that it explains. sentence: what was seen. since [s]: when it began, 0: it acts all the time. sizes:
    by kind, if it consists of several kinds or is at all joints in their order; as "gravity" [m/s^2] that of the base.
    """

    kind: str
    joint: str
    side: str = ""
    size: float = math.nan
    unit: str = ""
    share: float = 1.0
    sentence: str = ""
    since: float = 0.0
    sizes: dict[str, tuple[float, ...]] = field(default_factory=dict, hash=False)

    @classmethod
    def of_wiring(cls, found: Any, names: Sequence[str]) -> Finding | None:
        """Return a struct fjr_wiring_fault as a finding, None if it is none; names (n,): of the joints."""
        joints = [names[j] for j in found.joint[0 : found.count]]
        if not joints:
            return None
        kind, side, both = list(SENTENCES)[found.kind], ("link", "motor")[found.side], " and ".join(joints)
        sentence = SENTENCES[kind].format(joints=both, side=side, first=joints[0], last=joints[-1])
        return cls(kind, joints[0] if kind == "velocity of another joint" else both, side, sentence=sentence)


SIMPLE = {
    "states frozen": "states frozen: the values of {joints} repeat at a non-zero velocity: the stop effort is sent",
    "states late": "states come later than at first by more than state_timeout: a queue, or a slow simulation",
    "reference restarts": "the time of the states jumped back: the reference starts again, a requested motion ends",
    "forward jumps": "the time of the states jumped forward",
    "observer restarts": "the velocity observer was reset: a gap, or a state without an effort",
    "efforts not finite": "the effort is not finite for a state: the stop effort is sent instead",
    "gains changed": "gains changed: the certificate starts again",
    "settings changed": "limits and stop policy changed",
    "holds": "hold: the motion comes to a standstill",
}
"""Sentence of the events without values."""
AFTER_GAP = 5_000_000_000  # ns; a stop within this time after a gap of the states names the gap
STILL = 100_000_000  # ns; a tracking error of a joint whose values have not changed for longer says so


class State(str, Enum):
    """Operating state of the tracker, in the order of enum fjr_state."""

    WAITING = "waiting"  # for the first sample
    JOINING = "joining"  # transition from the measured state to the reference, or bumpless transfer of the effort
    TRACKING = "tracking"
    STOPPED = "stopped"  # the stop policy acts until resume()


STATES = tuple(State)


@dataclass(frozen=True)
class Event:
    """One event: level info, warn or error; kind: name of its counter; stamp [ns]: of its sample, if it has one."""

    level: str
    kind: str
    sentence: str
    values: Mapping[str, float | str] = field(default_factory=dict)
    stamp: int | None = None


class Journal:
    """Events of a ControlStep as sentences: the newest hundred unread ones, and the reason of the last stop.

    followed: names of the references requested, in order.
    """

    def __init__(self, step: Any) -> None:
        self._step, self._read = step, 0
        self.events: deque[Event] = deque(maxlen=100)
        self.reason = ""
        self.followed: deque[str] = deque()

    def update(self) -> None:
        """Read the events since the last call."""
        journal = self._step.controller.journal
        size = len(journal.event)
        for k in range(max(self._read, journal.events - size), journal.events):
            found = journal.event[k % size]
            kind, stamp = KINDS[found.kind], None if found.stamp == NEVER else found.stamp
            sentence, values = self._said(kind, found)
            if kind in (STOPS, STARTS_REFUSED):
                self.reason = sentence
            self.events.append(Event(level_of(kind), kind, sentence, values, stamp))
        self._read = journal.events

    @property
    def counters(self) -> Counter[str]:
        """Return how often each kind was counted; kinds that never were are absent."""
        journal, joints = self._step.controller.journal, self._step.settings.joints
        counts = dict(zip(KINDS, journal.count, strict=True))
        counts |= {f"efforts saturated: {joint}": k for joint, k in zip(joints, journal.saturated, strict=True)}
        return Counter({kind: k for kind, k in counts.items() if k})

    def _said(self, kind: str, found: Any) -> tuple[str, dict[str, float | str]]:
        """Return the sentence and the values of an event."""
        settings = self._step.settings
        joints = joints_of(found.detail, settings.joints)  # of a kind whose detail is joints
        if kind in SIMPLE:
            return SIMPLE[kind].format(joints=", ".join(joints)), {}
        if kind == "silences":
            return f"no new valid state for more than {found.value:g} s: the stop effort is sent", {}
        if kind == "recoveries":
            what = f"transition to the reference within {found.value:.3g} s" if found.value else "tracking at once"
            return f"recovery: {what}{self._after_gap(found.stamp)}", {}
        if kind == "references changed":
            return f"another reference: {self.followed.popleft()}", {}
        if kind == "efforts saturated":
            return f"the effort of {', '.join(joints)} is at its limit", {"joint": joints[0]}
        joint = settings.joints[found.joint] if found.joint >= 0 else ""
        if kind == CONTACTS:
            alone = f" together; {joint} alone" if len(joints) > 1 else ""
            torque = f"{found.value:.3g} {settings.units[found.joint].effort} (threshold {found.limit:.3g})"
            return f"contact: external torque on {', '.join(joints)}{alone}: {torque}", {}
        values: dict[str, float | str] = {"joint": joint} if joint else {}
        if not math.isnan(found.value):
            values |= {"value": found.value, "limit": found.limit}
        if kind == STARTS_REFUSED:
            unit = settings.units[found.joint].position
            return (
                f"start refused: |q_l - q_ld| of {joint} is {found.value:.6g} {unit}; "
                f"expected at most {found.limit:.6g} {unit}, or a start.join_time above 0"
            ), values
        cause = KINDS[found.detail].removeprefix("stops: ")
        if cause == SILENCE:
            expected = f"expected at most {found.limit:g} s (recovery.longest_gap), or ~/resume"
            return f"stopped: no new valid state for {found.value:.3g} s; {expected}", values
        if cause == "wiring":
            fault = Finding.of_wiring(self._step.controller.journal.wiring, settings.joints)
            sentence = fault.sentence if fault is not None else cause
        else:
            sentence = self._step.law_failure if cause == "law" else _violation(found, settings)
        still = found.stamp - self._step.controller.changed[max(found.joint, 0)]
        if cause == NO_MOTION or (cause == "tracking error" and still > STILL):
            sentence += f"; its values have not changed for {still * 1e-9:.2g} s (driver, brake, drive or network?)"
        return f"stopped: {sentence}{self._after_gap(found.stamp)}", values

    def _after_gap(self, stamp: int) -> str:
        """Return that the event follows a gap of the states, or nothing."""
        stamps = self._step.controller.stamps
        since = stamp - stamps.gap_end
        if stamps.gap_end == NEVER or not 0 <= since <= AFTER_GAP:
            return ""
        before = f"{since * 1e-9:.2g} s before, " if since else ""
        return f"; {before}a gap of {stamps.gap * 1e-9:.2g} s without states had ended"

    def outside(self) -> str:
        """Return which limit the last state violates, "" if none."""
        found = self._step.ffi.new("struct fjr_event*")
        outside = self._step.lib.fjr_is_outside(self._step.controller, found)
        return _violation(found, self._step.settings) if outside else ""


def joints_of(bits: int, joints: Sequence[str]) -> list[str]:
    """Return the joints whose bits are set; from the 32nd on they share bits."""
    return [joint for i, joint in enumerate(joints) if bits >> i % 31 & 1]


def _violation(found: Any, settings: Settings) -> str:
    cause, joint = KINDS[found.detail].removeprefix("stops: "), settings.joints[found.joint]
    symbol, quantity = LIMITED[cause]
    unit, side = getattr(settings.units[found.joint], quantity), "at least" if found.below else "at most"
    return f"{cause} of {joint}: {symbol} = {found.value:.6g} {unit}; expected {side} {found.limit:.6g} {unit}"
