# SPDX-License-Identifier: Apache-2.0
"""Tune all laws to equal bandwidth and peak effort, so that they can be compared (docs/compare.md).

The gains of a law follow from two numbers, a natural frequency and a damping ratio, by the standard choice of its paper
(registry.LawKind.standard). The targets are bandwidth and peak effort of v-dPBC with the gains of the scenario:

1. The natural frequency is chosen for equal bandwidth.
2. The damping ratio is the usual one of the law, unless another one in its range gives equal peak effort.
3. All commands, also those of v-dPBC, are saturated at the same limit: the peak effort of v-dPBC.

Definitions of bandwidth and peak effort: bandwidth.py.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fjr_core.errors import GainsError
from fjr_core.law.registry import V_DPBC, LawKind, law_kind
from fjr_core.law.static_law import StaticLaw
from fjr_core.law.vdpbc.law import TrackingLaw
from fjr_core.numerics.checks import Array

from .bandwidth import BANDWIDTH_TOLERANCE, PEAK_TOLERANCE, BaselineTarget, alike

REACH = 0.9  # fraction of the largest bandwidth of a law that is used if it cannot reach the target
SEARCHED = (0.1, 20.0)  # natural frequencies searched, relative to the target bandwidth
STEPS = 16  # of the search


@dataclass(frozen=True, eq=False)
class Tuning:
    """Tuned law with its bandwidth [rad/s] and peak effort and the targets of both.

    omega [rad/s], damping: the two numbers, NaN for v-dPBC with given gains. effort_limit (n,) [N m]: common
    saturation.
    """

    kind: LawKind
    law: StaticLaw
    omega: float
    damping: float
    bandwidth: float
    peak: float
    target_bandwidth: float
    target_peak: float
    effort_limit: Array

    @property
    def same_bandwidth(self) -> bool:
        """Return whether the bandwidth equals the target."""
        return alike(self.bandwidth, self.target_bandwidth, BANDWIDTH_TOLERANCE)

    @property
    def same_peak(self) -> bool:
        """Return whether the peak effort equals the target."""
        return alike(self.peak, self.target_peak, PEAK_TOLERANCE)

    @property
    def sentence(self) -> str:
        """Summary of the result of the tuning."""
        if np.isnan(self.omega):
            return "tuning target, with the gains of the scenario"
        times = f"{self.bandwidth / self.target_bandwidth:.2g} times the target"
        bandwidth = "the same bandwidth" if self.same_bandwidth else f"bandwidth {times}, the largest possible"
        if self.same_peak:
            return f"{bandwidth}, the same peak effort"
        saturated = ", saturated" if self.peak > self.target_peak else ""
        return f"{bandwidth}, peak effort {self.peak / self.target_peak:.2g} times the target{saturated}"


def tune(name: str, baseline_target: BaselineTarget, compile: bool = False, retune: bool = False) -> Tuning:
    """Tune the law of this name to the target.

    compile: build the law as machine code. retune: tune v-dPBC too; false: it keeps the gains of the target. Raises
    ParameterError for an unknown name, GainsError if no gains are stable.
    """
    kind, y = law_kind(name), baseline_target
    if kind.name == V_DPBC and not retune:
        law: StaticLaw = TrackingLaw(y.robot, y.gains, compile)
        return Tuning(kind, law, np.nan, np.nan, y.bandwidth, y.peak, y.bandwidth, y.peak, y.effort_limit)
    found = _chosen(_Family(kind, y))
    law = found.law if not compile else kind.make(y.robot, found.gains, compile)
    return Tuning(
        kind, law, found.omega, found.damping, found.bandwidth, found.peak, y.bandwidth, y.peak, y.effort_limit
    )


@dataclass(frozen=True, eq=False)
class _Candidate:
    law: StaticLaw
    gains: Any
    omega: float
    damping: float
    bandwidth: float
    peak: float


class _Family:
    """Laws of one kind as a function of natural frequency and damping ratio."""

    def __init__(self, kind: LawKind, baseline_target: BaselineTarget) -> None:
        self.kind, self.baseline_target = kind, baseline_target
        self._first: StaticLaw | None = None

    def bandwidth(self, omega: float, damping: float) -> float:
        """Return the bandwidth [rad/s]; 0 if the gains violate the condition of the paper or the loop is unstable."""
        try:
            return self.baseline_target.bandwidth_of(self._law(omega, damping))
        except GainsError:
            return 0.0

    def candidate(self, damping: float) -> _Candidate | None:
        """Return the law of this damping ratio with the target bandwidth, or near its largest; None if unstable."""
        target = self.baseline_target.bandwidth
        grid = target * np.geomspace(*SEARCHED, STEPS)
        bandwidths: list[float] = []
        for omega in grid:
            bandwidths.append(self.bandwidth(omega, damping))
            if bandwidths[-1] >= target:
                break
        if max(bandwidths) < target:
            target = REACH * max(bandwidths)
        if not target:
            return None
        i = int(np.flatnonzero(np.array(bandwidths) >= target)[0])
        omega = grid[i] if i == 0 else _root(lambda w: self.bandwidth(w, damping) - target, grid[i - 1], grid[i], 1e-3)
        law, y = self._law(omega, damping), self.baseline_target
        return _Candidate(law, self._gains(omega, damping), omega, damping, y.bandwidth_of(law), y.peak_of(law))

    def _law(self, omega: float, damping: float) -> StaticLaw:
        gains = self._gains(omega, damping)
        if self._first is None:
            self._first = self.kind.make(self.baseline_target.robot, gains)
            return self._first
        return self._first.with_gains(gains)

    def _gains(self, omega: float, damping: float) -> Any:
        y = self.baseline_target
        return self.kind.standard(y.robot, y.q_0, omega, damping, y.sample_period)


def _chosen(family: _Family) -> _Candidate:
    """Return the law of the usual damping ratio, or of the one with equal peak effort; bandwidth has priority."""
    kind, y = family.kind, family.baseline_target
    usual = family.candidate(kind.usual)
    if usual is not None and y.same_bandwidth(usual.bandwidth) and y.same_peak(usual.peak):
        return usual
    tried = [family.candidate(kind.damping[0]), usual, family.candidate(kind.damping[1])]
    known = [candidate for candidate in tried if candidate is not None]
    if not known:
        raise GainsError(
            f"{kind.name} is unstable for all natural frequencies and damping ratios; expected a stable choice"
        )
    equal = [candidate for candidate in known if y.same_bandwidth(candidate.bandwidth)]
    if not equal:
        return max(known, key=lambda candidate: candidate.bandwidth)
    for low, high in zip(equal, equal[1:], strict=False):
        if (low.peak - y.peak) * (high.peak - y.peak) < 0:
            return _between(family, low, high)
    return usual if usual in equal else min(equal, key=lambda candidate: abs(np.log(candidate.damping / kind.usual)))


def _between(family: _Family, low: _Candidate, high: _Candidate) -> _Candidate:
    """Search the damping ratio between two laws of target bandwidth for the target peak effort."""
    found = [low, high]

    def excess(damping: float) -> float:
        candidate = family.candidate(damping)
        if candidate is None:
            return -1.0
        found.append(candidate)
        return candidate.peak / family.baseline_target.peak - 1

    _root(excess, low.damping, high.damping, 0.01)
    equal = [candidate for candidate in found if family.baseline_target.same_bandwidth(candidate.bandwidth)]
    return min(equal, key=lambda candidate: abs(candidate.peak / family.baseline_target.peak - 1))


def _root(f: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Return a root of f between low and high to a relative tolerance."""
    from scipy.optimize import brentq  # loaded on use: see law/vdpbc/gains.py

    return float(np.exp(brentq(lambda log: f(float(np.exp(log))), np.log(low), np.log(high), xtol=tolerance)))
