# SPDX-License-Identifier: Apache-2.0
"""Collect the data of `fjr watch` and build its View; no ROS, no clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from xml.etree import ElementTree

import numpy as np

from fjr_monitor.recording.signals import END, clock_difference
from fjr_msgs_py.names import motor_name

LEVELS = ("ok", "warn", "error", "stale")  # of a diagnostic_msgs/DiagnosticStatus, by number
WINDOW = 2_000_000_000  # ns; window of the timing statistics
HISTORY = 120  # values of V
EVENTS = 6  # shown
STALE = 5.0  # s without a diagnostic message
NANO = 1e-9
Values = Mapping[str, float]


@dataclass(frozen=True)
class JointLine:
    """One joint; None where a value is unknown.

    position, error [rad], velocity [rad/s], deflection q_m - q_l [rad]; commanded effort, its limit and its peak
    [N m]. prismatic: units are m and N instead of rad and N m.
    """

    name: str
    position: float | None = None
    velocity: float | None = None
    deflection: float | None = None
    error: float | None = None
    effort: float | None = None
    limit: float | None = None
    peak: float = 0.0
    prismatic: bool = False


@dataclass(frozen=True)
class LoopTiming:
    """Timing over the last 2 s: state rate [1/s]; median, 99th percentile and maximum of period and latency [s]."""

    rate: float
    period: tuple[float, float, float]
    latency: tuple[float, float, float] | None = None
    unanswered: int = 0


@dataclass(frozen=True)
class NodeHealth:
    """Latest diagnostic status of a node or component: level 0 (ok) to 3 (stale)."""

    name: str
    level: int
    message: str
    state: str = ""


@dataclass(frozen=True)
class LoopEvent:
    """An event of the controller, `age` [s] ago."""

    age: float
    level: int
    kind: str
    sentence: str


@dataclass(frozen=True)
class View:
    """Content of the display at one instant.

    silence [s]: since the last state, None before the first. certificate: by label, as published; history: latest
    values of V, oldest first. missing: topics without a publisher.
    """

    title: str
    joints: tuple[JointLine, ...] = ()
    silence: float | None = None
    timing: LoopTiming | None = None
    certificate: dict[str, float] | None = None
    history: tuple[float, ...] = ()
    health: tuple[NodeHealth, ...] = ()
    events: tuple[LoopEvent, ...] = ()
    missing: tuple[str, ...] = ()


class Watched:
    """Collect messages; `view` returns the content to display. Times `now` [s] are of one monotonic clock."""

    def __init__(self, title: str, effort_limits: Values | None = None) -> None:
        """effort_limits [N m] by joint: take precedence over those of the robot description."""
        self.title = title
        self.urdf = ""  # as last received
        self._given_limits = dict(effort_limits or {})
        self._limits: dict[str, float] = {}
        self._prismatic: set[str] = set()
        self._position: Values = {}
        self._velocity: Values = {}
        self._error: Values = {}
        self._effort: Values = {}
        self._peak: dict[str, float] = {}
        self._last_state: float | None = None
        self._sent: deque[tuple[int, int]] = deque()  # stamp, send time [ns] of states
        self._answered: dict[int, int] = {}  # send time [ns] of the command by the stamp of its state
        self._heard = END  # stamp of the first answered state: commands before it may have gone unheard
        self._ahead = [-END, -END]  # largest send minus receive times [ns] of states, commands
        self._certificate: dict[str, float] | None = None
        self._history: deque[float] = deque(maxlen=HISTORY)
        self._health: dict[str, tuple[float, NodeHealth]] = {}
        self._events: deque[tuple[float, LoopEvent]] = deque(maxlen=EVENTS)

    def state(self, now: float, position: Values, velocity: Values) -> None:
        """Store measured positions [rad] and velocities [rad/s] by name."""
        self._last_state, self._position, self._velocity = now, position, velocity

    def error(self, position: Values) -> None:
        """Store tracking errors [rad] by joint."""
        self._error = position

    def effort(self, effort: Values) -> None:
        """Store commanded efforts [N m] by joint."""
        self._effort = effort
        for joint, value in effort.items():
            self._peak[joint] = max(self._peak.get(joint, 0.0), abs(value))

    def sent(self, times: Sequence[tuple[int, int, int]]) -> None:
        """Store stamps, send and receive times [ns] of states; duplicates of a stamp are ignored."""
        for stamp, time, received in times:
            self._ahead[0] = max(self._ahead[0], time - received)
            if self._sent and (stamp < self._sent[-1][0] or time < self._sent[-1][1]):  # a reset, or of the clock
                self._sent.clear()
                self._answered.clear()
                self._ahead = [time - received, -END]
            if not self._sent or stamp > self._sent[-1][0]:
                self._sent.append((stamp, time))
        while self._sent and self._sent[-1][1] - self._sent[0][1] > WINDOW:
            self._answered.pop(self._sent.popleft()[0], None)

    def answered(self, times: Sequence[tuple[int, int, int]]) -> None:
        """Store state stamps, send and receive times [ns] of commands, also of states that never come."""
        for stamp, time, received in times:
            self._ahead[1] = max(self._ahead[1], time - received)
            self._answered.setdefault(stamp, time)
            self._heard = min(self._heard, stamp)
        oldest, late = self._sent[0][0] if self._sent else 0, max(self._answered.values(), default=0) - 2 * WINDOW
        for stamp in [stamp for stamp, time in self._answered.items() if stamp < oldest or time < late]:
            del self._answered[stamp]

    def certificate(self, values: dict[str, float]) -> None:
        """Store the latest certificate, by label."""
        self._certificate = values
        if "V" in values:
            self._history.append(values["V"])

    def health(self, now: float, status: NodeHealth) -> None:
        """Store the latest status of a node."""
        self._health[status.name] = now, status

    def event(self, now: float, level: int, kind: str, sentence: str) -> None:
        """Store an event."""
        self._events.appendleft((now, LoopEvent(0.0, level, kind, sentence)))

    def description(self, urdf: str) -> None:
        """Store a URDF, and read effort limits and prismatic joints from it; in an invalid one none is found."""
        self.urdf = urdf
        try:
            joints = list(ElementTree.fromstring(urdf).iter("joint"))
        except ElementTree.ParseError:
            joints = []
        self._prismatic = {joint.get("name", "") for joint in joints if joint.get("type") == "prismatic"}
        limits = ((joint.get("name", ""), joint.find("limit")) for joint in joints)
        given = ((name, _number(limit.get("effort"))) for name, limit in limits if limit is not None)
        self._limits = {name: effort for name, effort in given if effort > 0}

    def view(self, now: float, missing: Sequence[str] = ()) -> View:
        """Return the content to display."""
        seen = list(self._position) or list(self._effort)
        motors = {motor_name(name) for name in seen}
        health = []
        for name in sorted(self._health):
            then, status = self._health[name]
            if now - then > STALE:
                said = f"no diagnostics for {now - then:.0f} s; the last: {status.message}"
                status = replace(status, level=3, message=said)
            health.append(status)
        return View(
            title=self.title,
            joints=tuple(self._line(name) for name in seen if name not in motors),
            silence=None if self._last_state is None else max(0.0, now - self._last_state),
            timing=self._timing(),
            certificate=self._certificate,
            history=tuple(self._history),
            health=tuple(health),
            events=tuple(replace(event, age=now - then) for then, event in self._events),
            missing=tuple(missing),
        )

    def _line(self, name: str) -> JointLine:
        q_l, q_m = self._position.get(name), self._position.get(motor_name(name))
        return JointLine(
            name=name,
            position=q_l,
            velocity=self._velocity.get(name),
            deflection=None if q_l is None or q_m is None else q_m - q_l,
            error=self._error.get(name),
            effort=self._effort.get(name),
            limit=self._given_limits.get(name, self._limits.get(name)),
            peak=self._peak.get(name, 0.0),
            prismatic=name in self._prismatic,
        )

    def _timing(self) -> LoopTiming | None:
        if len(self._sent) < 2:
            return None
        sent = np.array([time for _, time in self._sent], dtype=float) * NANO
        clocks = clock_difference(*self._ahead)
        latencies = [self._answered[stamp] - clocks - time for stamp, time in self._sent if stamp in self._answered]
        due = [stamp for stamp, _ in self._sent if stamp >= self._heard][:-1]  # the last command may be on its way
        unanswered = sum(stamp not in self._answered for stamp in due)
        latency = _percentiles(np.array(latencies) * NANO) if latencies else None
        rate = (len(sent) - 1) / max(sent[-1] - sent[0], NANO)
        return LoopTiming(float(rate), _percentiles(np.diff(sent)), latency, unanswered)


def _percentiles(values: np.ndarray) -> tuple[float, float, float]:
    p50, p99 = np.percentile(values, (50, 99))
    return float(p50), float(p99), float(values.max())


def _number(text: str | None) -> float:
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0
