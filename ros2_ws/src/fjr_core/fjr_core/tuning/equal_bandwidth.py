# SPDX-License-Identifier: Apache-2.0
"""The one rule by which the gains of all laws are chosen, so that they may be compared (docs/baselines.md).

Each law's gains follow from two numbers, a natural frequency and a damping ratio, by its paper's usual choice
(laws.LawKind.standard). With v-dPBC under the scenario's gains as the yardstick (and v-dPBC itself too, if asked for):

1. The natural frequency makes the bandwidth equal.
2. The damping ratio is the law's usual one, unless another in its range makes the peak effort equal.
3. Every command, v-dPBC's too, is cut at the same limit: v-dPBC's peak effort.

What bandwidth and peak effort are: bandwidth.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from ..control.registry import V_DPBC, LawKind, law_kind
from ..control.static_law import StaticLaw
from ..control.vdpbc.gains import Gains
from ..control.vdpbc.law import TrackingLaw
from ..errors import GainsError
from ..numerics.checks import Array
from ..robot.robot import Robot
from ..trajectories.reference import Reference
from .bandwidth import BANDWIDTH_TOLERANCE, PEAK_TOLERANCE, Yardstick, alike

REACH = 0.9  # of the largest bandwidth that a law has, where that is below the yardstick's
SEARCHED = (0.1, 20.0)  # natural frequencies, times the yardstick's bandwidth
STEPS = 16  # of the search


@dataclass(frozen=True, eq=False)
class Tuning:
    """A law under the rule, with what came of it. bandwidth [rad/s] and peak effort beside the yardstick's.

    omega [rad/s], damping: the two numbers, nan for the yardstick. effort_limit (n,) [N m]: where all commands are cut.
    """

    kind: LawKind
    law: StaticLaw
    omega: float
    damping: float
    bandwidth: float
    peak: float
    yardstick_bandwidth: float
    yardstick_peak: float
    effort_limit: Array

    @property
    def same_bandwidth(self) -> bool:
        """Whether the bandwidth is the yardstick's."""
        return alike(self.bandwidth, self.yardstick_bandwidth, BANDWIDTH_TOLERANCE)

    @property
    def same_peak(self) -> bool:
        """Whether the peak effort is the yardstick's."""
        return alike(self.peak, self.yardstick_peak, PEAK_TOLERANCE)

    @property
    def sentence(self) -> str:
        """What came of it, in words."""
        if np.isnan(self.omega):
            return "the yardstick, with the scenario's gains"
        bandwidth = (
            "the same bandwidth" if self.same_bandwidth else f"bandwidth {self._times('bandwidth')}: no more here"
        )
        if self.same_peak:
            return f"{bandwidth}, the same peak effort"
        return f"{bandwidth}, peak effort {self._times('peak')}" + (", cut" if self.peak > self.yardstick_peak else "")

    def _times(self, what: str) -> str:
        return f"{getattr(self, what) / getattr(self, f'yardstick_{what}'):.2g} times the yardstick's"


def tune(name: str, yardstick: Yardstick, compile: bool = False, retune: bool = False) -> Tuning:
    """Tune the law of this name. Raises ParameterError for an unknown name, GainsError where nothing is stable.

    compile: the law as machine code. retune: tune v-dPBC too; else it is the yardstick, with the scenario's gains.
    """
    kind, y = law_kind(name), yardstick
    if kind.name == V_DPBC and not retune:
        law: StaticLaw = TrackingLaw(y.robot, y.gains, compile)
        return Tuning(kind, law, np.nan, np.nan, y.bandwidth, y.peak, y.bandwidth, y.peak, y.effort_limit)
    found = _chosen(_Family(kind, y))
    law = found.law if not compile else kind.make(y.robot, found.gains, compile)
    return Tuning(
        kind, law, found.omega, found.damping, found.bandwidth, found.peak, y.bandwidth, y.peak, y.effort_limit
    )


def tuned(
    name: str,
    robot: Robot,
    reference: Reference,
    gains: Gains,
    start: tuple[Array, Array] | None = None,
    compile: bool = False,
) -> StaticLaw:
    """The law of tune; see Yardstick and tune."""
    return tune(name, Yardstick(robot, reference, gains, start), compile).law


@dataclass(frozen=True, eq=False)
class _Candidate:
    law: StaticLaw
    gains: Any
    omega: float
    damping: float
    bandwidth: float
    peak: float


class _Family:
    """The laws of a kind, by natural frequency and damping ratio."""

    def __init__(self, kind: LawKind, yardstick: Yardstick) -> None:
        self.kind, self.yardstick = kind, yardstick
        self._first: StaticLaw | None = None

    def bandwidth(self, omega: float, damping: float) -> float:
        """Bandwidth [rad/s]; 0 where these gains break the paper's condition or the loop is unstable."""
        try:
            return self.yardstick.bandwidth_of(self._law(omega, damping))
        except GainsError:
            return 0.0

    def candidate(self, damping: float) -> _Candidate | None:
        """The law of this damping ratio with that bandwidth, or one near its own largest; None: no stable one."""
        wanted = self.yardstick.bandwidth
        grid = wanted * np.geomspace(*SEARCHED, STEPS)
        seen: list[float] = []
        for omega in grid:
            seen.append(self.bandwidth(omega, damping))
            if seen[-1] >= wanted:
                break
        if max(seen) < wanted:
            wanted = REACH * max(seen)
        if not wanted:
            return None
        i = int(np.flatnonzero(np.array(seen) >= wanted)[0])
        omega = grid[i] if i == 0 else _root(lambda w: self.bandwidth(w, damping) - wanted, grid[i - 1], grid[i], 1e-3)
        law = self._law(omega, damping)
        return _Candidate(
            law,
            self._gains(omega, damping),
            omega,
            damping,
            self.yardstick.bandwidth_of(law),
            self.yardstick.peak_of(law),
        )

    def _law(self, omega: float, damping: float) -> StaticLaw:
        gains = self._gains(omega, damping)
        if self._first is None:
            self._first = self.kind.make(self.yardstick.robot, gains)
            return self._first
        return self._first.with_gains(gains)

    def _gains(self, omega: float, damping: float) -> Any:
        y = self.yardstick
        return self.kind.standard(y.robot, y.q_0, omega, damping, y.sample_period)


def _chosen(family: _Family) -> _Candidate:
    """The usual damping ratio, or the one in the range that makes the peak efforts equal; bandwidth comes first."""
    kind, y = family.kind, family.yardstick
    usual = family.candidate(kind.usual)
    if usual is not None and y.same_bandwidth(usual.bandwidth) and y.same_peak(usual.peak):
        return usual
    tried = [family.candidate(kind.damping[0]), usual, family.candidate(kind.damping[1])]
    known = [candidate for candidate in tried if candidate is not None]
    if not known:
        raise GainsError(f"no natural frequency and damping ratio make {kind.name} stable; expected some to do")
    equal = [candidate for candidate in known if y.same_bandwidth(candidate.bandwidth)]
    if not equal:
        return max(known, key=lambda candidate: candidate.bandwidth)
    for low, high in zip(equal, equal[1:], strict=False):
        if (low.peak - y.peak) * (high.peak - y.peak) < 0:
            return _between(family, low, high)
    return usual if usual in equal else min(equal, key=lambda candidate: abs(np.log(candidate.damping / kind.usual)))


def _between(family: _Family, low: _Candidate, high: _Candidate) -> _Candidate:
    """A damping ratio between the two whose peak effort is the yardstick's; both have its bandwidth."""
    found = [low, high]

    def excess(damping: float) -> float:
        candidate = family.candidate(damping)
        if candidate is None:
            return -1.0
        found.append(candidate)
        return candidate.peak / family.yardstick.peak - 1

    _root(excess, low.damping, high.damping, 0.01)
    equal = [candidate for candidate in found if family.yardstick.same_bandwidth(candidate.bandwidth)]
    return min(equal, key=lambda candidate: abs(candidate.peak / family.yardstick.peak - 1))


def _root(f: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Where f changes its sign between low and high, to a relative tolerance."""
    return float(np.exp(brentq(lambda log: f(float(np.exp(log))), np.log(low), np.log(high), xtol=tolerance)))
