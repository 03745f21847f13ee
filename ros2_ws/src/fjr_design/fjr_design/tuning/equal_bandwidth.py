# SPDX-License-Identifier: Apache-2.0
"""Tune all laws to equal bandwidth and peak effort, so that they can be compared (docs/compare.md).

The gains of a law follow from two numbers, a natural frequency and a damping ratio, by the standard choice of its paper
(LawKind.tuning_rule). The targets are bandwidth and peak effort of v-dPBC with the gains of the scenario:

1. The natural frequency is chosen for equal bandwidth.
2. The damping ratio is the usual one of the law, unless another one in its range gives equal peak effort.
3. All commands, also those of v-dPBC, are saturated at the same limit: the peak effort of v-dPBC.

Bandwidth [rad/s]: T(s), T(0) = 1, is the linearised loop from the reference position to the links, at rest at the start
of the reference. The bandwidth is the lowest frequency at which the smallest singular value of M_l^1/2 T M_l^-1/2, the
gain for link motions of unit kinetic energy, is below 2^-1/2. Peak effort: the larger of the first command at the start
and the effort of the reference motion itself, as the largest share of the effort limits of the joints, or in N m if the
robot has none.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from fjr_core.config import law, robot_file
from fjr_core.config.law import START_ERROR, sample_period
from fjr_core.config.law import gains as build_gains
from fjr_core.config.parameter import Values, names, vector
from fjr_core.config.reference import reference as build_reference
from fjr_core.config.robot import robot as build_robot
from fjr_core.config.scenario import Scenario
from fjr_core.errors import GainsError
from fjr_core.extensions.law_registry import V_DPBC, LawKind, law_kind
from fjr_core.law.gains import Gains
from fjr_core.law.interfaces import StaticLaw
from fjr_core.law.linearized import equilibria_at, rest_position, slope_at_rest
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import inverse_dynamics
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.stability.linear_controller import plant_in_velocities

BANDWIDTH_TOLERANCE = 0.01  # relative, of equal bandwidths
PEAK_TOLERANCE = 0.1  # relative, of equal peak efforts
GRID: Array = np.geomspace(0.02, 4.0, 100, dtype=float)  # frequencies of the search of a bandwidth / the target
HORIZON = 10.0  # s of the reference whose effort is evaluated
REACH = 0.9  # fraction of the largest bandwidth of a law that is used if it cannot reach the target
SEARCHED = (0.1, 20.0)  # natural frequencies searched, relative to the target bandwidth
STEPS = 16  # of the search


class BaselineTarget:
    """Tuning target: bandwidth and peak effort of v-dPBC with given gains on a robot along a reference.

    start: (positions (2n,) [rad], velocities (2n,) [rad/s]) of links and motors; None: at rest with a position error of
    START_ERROR at every joint. sample_period [s]: of the loop. Raises GainsError for wrong gains, StateError for wrong
    shapes.
    """

    def __init__(
        self,
        robot: Robot,
        reference: Reference,
        gains: Gains,
        start: tuple[Array, Array] | None = None,
        sample_period: float = 1e-3,
    ) -> None:
        self.robot, self.reference, self.sample_period = robot, reference, sample_period
        self._jets = np.asarray(reference.jets(0.0))
        self.q_0 = np.array(self._jets[0])
        self.start = start or (rest_position(robot, self.q_0) + START_ERROR, np.zeros(2 * robot.n))
        (self._A,), (self._B,) = plant_in_velocities(equilibria_at(robot, self.q_0[None]))
        self._root = np.linalg.cholesky(robot.M_l(self.q_0)).T
        limits = robot.limits
        known = limits is not None and np.isfinite(limits.effort).all()
        self._scale = limits.effort if limits is not None and known else np.ones(robot.n)
        self.gains, self.law = gains, TrackingLaw(robot, gains)
        self.peak = self.peak_of(self.law)
        near = self._crossing(*self.loop(self.law), np.asarray(np.geomspace(1e-2, 1e4, 1200)))
        self.bandwidth = self._crossing(*self.loop(self.law), GRID * near)

    @cached_property
    def effort_limit(self) -> Array:
        """Common effort limit (n,) [N m]: peak effort of v-dPBC, at least 1.2 times that of the reference motion."""
        return np.asarray(self._scale * max(self.peak, 1.2 * self.reference_effort))

    @cached_property
    def reference_effort(self) -> float:
        """Largest share of the effort limits that the reference motion requires within HORIZON."""
        motions = self.reference.jets(np.linspace(0.0, min(self.reference.end, HORIZON), 200)).transpose(1, 2, 0)
        u = np.linalg.solve(self.robot.B_m, inverse_dynamics(self.robot)(*motions)[-1].full())
        return float(np.max(np.abs(u) / self._scale[:, None]))

    def peak_of(self, law: StaticLaw) -> float:
        """Return the peak effort of a law; see the module."""
        u, _ = law.measured_command(*self.start, self._jets)
        return max(float(np.max(np.abs(u) / self._scale)), self.reference_effort)

    def loop(self, law: StaticLaw) -> tuple[Array, Array]:
        """Return A, B of the closed loop dx/dt = A x + B dq_ld, linearised at rest at q_0."""
        F, G = slope_at_rest(law, self.q_0)
        return self._A + self._B @ F, self._B @ G

    def bandwidth_of(self, law: StaticLaw) -> float:
        """Return the bandwidth [rad/s], see the module; 0 if the loop is unstable, at most 4 times the target."""
        A, B = self.loop(law)
        if not np.linalg.eigvals(A).real.max() < 0:
            return 0.0
        return self._crossing(A, B, GRID * self.bandwidth)

    def _crossing(self, A: Array, B: Array, frequencies: Array) -> float:
        """Return the first crossing of 2^-1/2 among the frequencies [rad/s], interpolated."""
        n = self.robot.n
        s = 1j * frequencies[:, None, None]
        T = np.linalg.solve(s * np.eye(4 * n) - A, (B @ np.linalg.inv(self._root))[None].astype(complex))
        gain = np.linalg.svd(self._root @ T[:, :n], compute_uv=False)[:, -1] * 2**0.5
        below = np.flatnonzero(gain < 1)
        if not len(below) or not below[0]:
            return float(frequencies[0 if len(below) else -1])
        i = int(below[0])
        logs = np.log(gain[[i, i - 1]]), np.log(frequencies[[i, i - 1]])
        return float(np.exp(np.interp(0.0, *logs)))


@dataclass(frozen=True, eq=False)
class Tuning:
    """A law of a kind for a target, with its bandwidth [rad/s] and peak effort.

    omega [rad/s], damping: the two numbers of the tuning rule, NaN for v-dPBC with given gains.
    """

    kind: LawKind
    target: BaselineTarget
    law: StaticLaw
    omega: float
    damping: float
    bandwidth: float
    peak: float

    @property
    def same_bandwidth(self) -> bool:
        """Return whether the bandwidth equals the target."""
        return abs(self.bandwidth - self.target.bandwidth) <= BANDWIDTH_TOLERANCE * self.target.bandwidth

    @property
    def same_peak(self) -> bool:
        """Return whether the peak effort equals the target."""
        return abs(self.peak - self.target.peak) <= PEAK_TOLERANCE * self.target.peak

    @property
    def sentence(self) -> str:
        """Summary of the result of the tuning."""
        if np.isnan(self.omega):
            return "tuning target, with the gains of the scenario"
        times = f"{self.bandwidth / self.target.bandwidth:.2g} times the target"
        bandwidth = "the same bandwidth" if self.same_bandwidth else f"bandwidth {times}, the largest possible"
        if self.same_peak:
            return f"{bandwidth}, the same peak effort"
        saturated = ", saturated" if self.peak > self.target.peak else ""
        return f"{bandwidth}, peak effort {self.peak / self.target.peak:.2g} times the target{saturated}"


def tune(name: str, baseline_target: BaselineTarget, retune: bool = False) -> Tuning:
    """Tune the law of this name to the target.

    retune: tune v-dPBC too; false: it keeps the gains of the target. Raises ParameterError for an unknown name,
    GainsError if no gains are stable.
    """
    kind, y = law_kind(name), baseline_target
    if kind.name == V_DPBC and not retune:
        return Tuning(kind, y, y.law, np.nan, np.nan, y.bandwidth, y.peak)
    return _Family(kind, y).chosen()


class _Family:
    """Laws of one kind as a function of natural frequency and damping ratio."""

    def __init__(self, kind: LawKind, target: BaselineTarget) -> None:
        self.kind, self.target = kind, target
        self._first: StaticLaw | None = None

    def chosen(self) -> Tuning:
        """Return the law of the usual damping ratio, or of the one with equal peak effort; bandwidth has priority."""
        kind, peak = self.kind, self.target.peak
        usual = self._of_bandwidth(kind.default_damping)
        if usual is not None and usual.same_bandwidth and usual.same_peak:
            return usual
        tried = (self._of_bandwidth(kind.damping_range[0]), usual, self._of_bandwidth(kind.damping_range[1]))
        known = [each for each in tried if each is not None]
        if not known:
            raise GainsError(
                f"{kind.name} is unstable for all natural frequencies and damping ratios; expected a stable choice"
            )
        equal = [each for each in known if each.same_bandwidth]
        if not equal:
            return max(known, key=lambda each: each.bandwidth)
        for low, high in zip(equal, equal[1:], strict=False):
            if (low.peak - peak) * (high.peak - peak) < 0:
                return self._of_peak(low, high)
        return min(equal, key=lambda each: abs(np.log(each.damping / kind.default_damping)))

    def _of_bandwidth(self, damping: float) -> Tuning | None:
        """Return the law of this damping ratio with the target bandwidth, or near its largest; None if unstable."""
        target = self.target.bandwidth
        grid = target * np.geomspace(*SEARCHED, STEPS)
        bandwidths: list[float] = []
        for omega in grid:
            bandwidths.append(self._bandwidth(omega, damping))
            if bandwidths[-1] >= target:
                break
        if max(bandwidths) < target:
            target = REACH * max(bandwidths)
        if not target:
            return None
        i = int(np.flatnonzero(np.array(bandwidths) >= target)[0])
        omega = grid[i]
        if i > 0:
            omega = _root(lambda w: self._bandwidth(w, damping) - target, grid[i - 1], grid[i], 1e-3)
        law, y = self._law(omega, damping), self.target
        return Tuning(self.kind, y, law, omega, damping, y.bandwidth_of(law), y.peak_of(law))

    def _of_peak(self, low: Tuning, high: Tuning) -> Tuning:
        """Search the damping ratio between two laws of target bandwidth for the target peak effort."""
        found = [low, high]

        def excess(damping: float) -> float:
            made = self._of_bandwidth(damping)
            if made is None:
                return -1.0
            found.append(made)
            return made.peak / self.target.peak - 1

        _root(excess, low.damping, high.damping, 0.01)
        equal = [each for each in found if each.same_bandwidth]
        return min(equal, key=lambda each: abs(each.peak / self.target.peak - 1))

    def _bandwidth(self, omega: float, damping: float) -> float:
        """Return the bandwidth [rad/s]; 0 if the gains violate the condition of the paper or the loop is unstable."""
        try:
            return self.target.bandwidth_of(self._law(omega, damping))
        except GainsError:
            return 0.0

    def _law(self, omega: float, damping: float) -> StaticLaw:
        """Return the law; the functions of the first one serve all."""
        y = self.target
        gains = self.kind.tuning_rule(y.robot, y.q_0, omega, damping, y.sample_period)
        self._first = self._first or self.kind.make(y.robot, gains)
        return self._first.with_gains(gains)


def _root(f: Callable[[float], float], low: float, high: float, tolerance: float) -> float:
    """Return a root of f between low and high to a relative tolerance."""
    from scipy.optimize import brentq  # loaded on use: see law/gains.py

    return float(np.exp(brentq(lambda log: f(float(np.exp(log))), np.log(low), np.log(high), xtol=tolerance)))


def baseline_target(scenario: Scenario) -> BaselineTarget:
    """Return the target of the rule of equal bandwidth for robot, reference, gains and start of a scenario."""
    robot, n = scenario.robot, scenario.robot.n
    start = scenario.x0[: 2 * n], np.hstack(robot.velocities(scenario.x0))
    return BaselineTarget(robot, scenario.reference, scenario.gains, start, scenario.sample_period)


def tuning(values: Values) -> Tuning:
    """Return the law of parameter values tuned to equal bandwidth, and the result of tuning.

    The target is v-dPBC with gains.* along the reference, starting at rest with law.start_error. Raises ParameterError
    or GainsError.
    """
    relevant = ("robot.", "gains.", "reference.", law.TYPE.name, law.INITIAL_ERROR.name, law.SAMPLE_RATE.name, "joints")
    alone = robot_file.motion_inlined(robot_file.inlined(values), names(values, "joints"))  # files may change
    return _tuned(tuple(sorted((name, value) for name, value in alone.items() if name.startswith(relevant))))


@lru_cache(maxsize=8)
def _tuned(items: tuple[tuple[str, Any], ...]) -> Tuning:
    values = dict(items)
    arm = build_robot(values)
    motion = build_reference(values, arm.n)
    error = np.tile(vector(values, law.INITIAL_ERROR.name, arm.n), 2)
    start = rest_position(arm, np.asarray(motion.jets(0.0))[0]) + error, np.zeros(2 * arm.n)
    target = BaselineTarget(arm, motion, build_gains(values, arm.n), start, sample_period(values))
    return tune(str(values[law.TYPE.name]), target)
