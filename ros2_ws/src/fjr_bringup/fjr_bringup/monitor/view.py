# SPDX-License-Identifier: Apache-2.0
"""What `fjr watch` shows, as values: no ROS, no terminal."""

from __future__ import annotations

from dataclasses import dataclass

LEVELS = ("ok", "warn", "error", "stale")  # of a diagnostic_msgs/DiagnosticStatus, by number


@dataclass(frozen=True)
class JointLine:
    """A joint; None where nothing was heard of it.

    position, error [rad], velocity [rad/s], deflection q_m - q_l [rad]; effort as commanded, its limit and the largest
    one seen [N m]. prismatic: the joint slides, in m and N in place of rad and N m.
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
class Timing:
    """Of the last seconds: rate of states [1/s]; 50 %, 99 % and largest period and latency (state to command) [s]."""

    rate: float
    period: tuple[float, float, float]
    latency: tuple[float, float, float] | None = None
    unanswered: int = 0


@dataclass(frozen=True)
class Health:
    """The newest status of a node or of a part of it: level 0 (ok) to 3 (stale)."""

    name: str
    level: int
    message: str
    state: str = ""


@dataclass(frozen=True)
class Happening:
    """An event, `age` [s] ago."""

    age: float
    level: int
    kind: str
    sentence: str


@dataclass(frozen=True)
class View:
    """Everything at one instant.

    silence: seconds since the last state, None before the first. certificate: by label, as published; history: V of
    the last displays, oldest first. missing: topics that nobody publishes.
    """

    title: str
    joints: tuple[JointLine, ...] = ()
    silence: float | None = None
    timing: Timing | None = None
    certificate: dict[str, float] | None = None
    history: tuple[float, ...] = ()
    health: tuple[Health, ...] = ()
    happenings: tuple[Happening, ...] = ()
    missing: tuple[str, ...] = ()
