# SPDX-License-Identifier: Apache-2.0
"""Run the sampled closed loop of one robot, law and reference many times with drawn parameters."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import StateError
from fjr_core.law.interfaces import SampledLaw
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.robot import Robot
from fjr_core.motions.reference import Reference
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import KINDS, STARTS_REFUSED, STOPS
from fjr_core.runtime.measurement_model import Measurement
from fjr_core.runtime.safety_settings import Settings
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_core.simulation.closed_loop import check_joints

from . import parametric_robot
from .draws import PARAMETERS, Draws
from .program import BatchProgram

if TYPE_CHECKING:
    from fjr_core.config.scenario import Scenario

LAST = 1.0  # s; averaging time of Outcomes.final


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of k runs of n joints; errors are q_l - q_ld at the samples, efforts the saturated commands.

    stable (k,): all numbers are finite and no error exceeds ClosedLoop.lost; lost_at (k,) [s]: end of a run that is not
    stable, else inf. rms, peak (k, n) [rad]: of the errors after settle_after. final (k, n) [rad]: mean magnitude of
    the errors over the last second. settling (k,) [s]: instant after which every error stays within ClosedLoop.band;
    inf: never. effort_rms, effort_peak (k, n) [N m]: from the start. effort_noise (k, n) [N m]: RMS of
    (u_k - u_(k-1)) / 2^(1/2) after settle_after, the standard deviation of white noise in the effort. power (k,) [W]:
    mean of |u' dq_m|.
    For a run that is not stable, rms, peak, final and settling are inf and the others cover the run up to lost_at.
    stopped (k,) [s]: time at which a limit stopped the controller, inf: none. cause (k,): of the stop, e.g. "link
    velocity", else empty. A stopped run continues under the stop policy, and its error may exceed ClosedLoop.lost.
    """

    stable: NDArray[np.bool_]
    lost_at: Array
    rms: Array
    peak: Array
    final: Array
    settling: Array
    effort_rms: Array
    effort_peak: Array
    effort_noise: Array
    power: Array
    stopped: Array
    cause: NDArray[np.str_]

    @classmethod
    def of(cls, rows: Array, n: int) -> Outcomes:
        """Return the outcomes from rows (k, row_width(n)) of the engine, which hold the fields in order."""
        ends = np.cumsum([0, *(n if name in PER_JOINT else 1 for name in FIELDS)])
        parts = {
            name: rows[:, start:end] if name in PER_JOINT else rows[:, start]
            for name, start, end in zip(FIELDS, ends, ends[1:], strict=False)
        }
        causes = np.array([_CAUSES.get(int(kind), "") for kind in parts["cause"]], dtype=str)
        return cls(**{**parts, "stable": parts["stable"] != 0, "cause": causes})


FIELDS = tuple(field.name for field in fields(Outcomes))
_CAUSES = {
    k: name.removeprefix(f"{STOPS}: ") for k, name in enumerate(KINDS) if name.startswith((f"{STOPS}:", STARTS_REFUSED))
}
"""Causes of a stop by the number that the control step gives them."""
PER_JOINT = ("rms", "peak", "final", "effort_rms", "effort_peak", "effort_noise")


def row_width(n: int) -> int:
    """Return the length of a row for n joints."""
    return sum(n if name in PER_JOINT else 1 for name in FIELDS)


@dataclass(frozen=True)
class Recorded:
    """Samples of k runs: t (s,) [s], x (k, s, 4n), u (k, s, n) [N m] as sent; NaN after the end of a run.

    measured (k, s, 4n): what the controller received, q_l, q_m, dq_l, dq_m before gear and compliance.
    """

    t: Array
    x: Array
    u: Array
    measured: Array


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """Plant `robot` under a SampledLaw with its own model, along a reference, by the control step of the node.

    x0 (4n,): initial state of the nominal plant; every run starts at its positions and velocities. duration,
    sample_period [s]. inner_steps: Runge-Kutta steps of order 4 per sample (more if a delay divides the sample).
    settle_after [s], band [rad]: see Outcomes. lost [rad]: a run ends as not stable if a link error exceeds it or a
    number is not finite. plant: a plant in Python that replaces the equations of motion of the robot.
    settings: limits, start and stop policy; by default none but the effort limit of the draws, and in any case the
    tighter of both effort limits. observer, measurement: of the controller; by default velocities are measured.
    The loop is compiled once and cached; a law or plant in Python is called from it, some thousand times slower. The
    results of a run depend only on its own draws, to the last bit. Raises StateError and ParameterError, CompilerError
    without a C compiler, and UserCodeError for a failure of a law or plant in Python.
    """

    robot: Robot
    law: SampledLaw
    reference: Reference
    x0: ArrayLike
    duration: float
    sample_period: float
    inner_steps: int = 4
    settle_after: float = 1.0
    band: float = 0.01
    lost: float = np.pi / 2
    plant: Plant | None = None
    settings: Settings | None = None
    observer: VelocityObserver | None = None
    measurement: Measurement | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "x0", checks.vector("x0", self.x0, 4 * self.robot.n, StateError))
        check_joints(self.robot, self.law.robot, self.reference)
        for name in ("duration", "sample_period", "lost", "band"):
            if not 0 < getattr(self, name) < np.inf:
                raise StateError(f"{name} is {getattr(self, name)}; expected a positive finite number")
        if not 0 <= self.settle_after < self.duration:
            raise StateError(f"settle_after is {self.settle_after} s; expected less than --duration, {self.duration} s")
        if self._first > self._samples:
            raise StateError(
                f"no sample of {self.sample_period:g} s lies between settle_after, {self.settle_after:g} s, and the "
                f"end, {self.duration:g} s; expected at least one"
            )
        if self.inner_steps < 1:
            raise StateError(f"inner_steps is {self.inner_steps}; expected 1 or more")
        self._check_control()

    def _check_control(self) -> None:
        """Raise StateError unless settings, observer and measurement are of this robot and fit each other."""
        parts: dict[str, Any] = {"settings": self.settings, "measurement": self.measurement}
        parts["observer"] = None if self.observer is None else self.observer.robot
        for name, part in parts.items():
            if part is not None and part.n != self.robot.n:
                raise StateError(f"{name} has {part.n} joints; expected {self.robot.n}")
        if self.measurement is not None and self.measurement.observed and self.observer is None:
            raise StateError("observer is None with a measurement without velocities; expected an observer")

    def with_law(self, law: SampledLaw, observer: VelocityObserver | None = None) -> ClosedLoop:
        """Return the loop with another law of the same form, whose gains differ; nothing is compiled again.

        The law has the same class, robot model, options and number of gains as that of this loop. observer: replaces
        that of this loop, with another bandwidth. Raises StateError.
        """
        other = replace(self, law=law, observer=observer or self.observer)
        other.__dict__["program"] = self.program.with_law(law, other.observer)
        return other

    def run(self, draws: Draws) -> Outcomes:
        """Run all draws on the calling core; other threads are not blocked."""
        return Outcomes.of(self._run(draws, None), self.robot.n)

    def recorded(self, draws: Draws) -> tuple[Outcomes, Recorded]:
        """Run all draws and also return every sample; meant for few runs."""
        n, samples = self.robot.n, self._samples
        trace = np.full((draws.runs, samples + 1, 9 * n), np.nan)
        outcomes = Outcomes.of(self._run(draws, trace), n)
        t = self.sample_period * np.arange(samples + 1)
        return outcomes, Recorded(np.asarray(t), *np.split(trace, [4 * n, 5 * n], axis=2))

    def _run(self, draws: Draws, trace: Array | None) -> Array:
        rows = np.empty((draws.runs, row_width(self.robot.n)))
        values: dict[str, Any] = {**self._constants, **self._drawn(draws), "rows": rows, "trace": trace}
        values["ring"] = int(values["segments"][:, :, 0].max(initial=0)) + 1
        self.program.run(self.reference, values)
        return rows

    def _drawn(self, draws: Draws) -> dict[str, Any]:
        n = self.robot.n
        parts = {name: draws.columns(name, n) for name in parametric_robot.NAMES}
        parametric_robot.refuse(self.robot, self.plant is not None and self.plant.in_python, parts)
        full = np.hstack([parts[name] != PARAMETERS[name].nominal for name in parametric_robot.FULL]).any(axis=1)
        sensing = [draws.columns(name, n) for name in ("position_noise", "velocity_noise", "resolution")]
        segments, dt = _segments(draws.columns("delay", n)[:, 0], self.sample_period, self.inner_steps)
        return {
            "parameters": (parameters := parametric_robot.vector(parts)),
            "width": parameters.shape[1],
            "sensing": np.ascontiguousarray(np.hstack(sensing)),
            "limit": draws.columns("effort_limit", n),
            "is_full": np.asarray(full, dtype=np.uint8),
            "segments": segments,
            "dt": dt,
            "seeds": np.asarray(draws.seed, dtype=np.uint64),
        }

    @property
    def _samples(self) -> int:
        return int(self.duration / self.sample_period + 1e-9)

    @property
    def _first(self) -> int:
        """Return the first sample whose error counts."""
        return int(np.ceil(self.settle_after / self.sample_period - 1e-9))

    @cached_property
    def _constants(self) -> dict[str, Any]:
        """Return the values common to all runs."""
        positions, velocities = np.split(np.asarray(self.x0), 2)[0], np.hstack(self.robot.velocities(self.x0))
        return {
            "samples": self._samples,
            "first": self._first,
            "last_second": max(0, self._samples - round(LAST / self.sample_period)),
            "period": self.sample_period,
            "lost": self.lost,
            "band": self.band,
            "gains": np.ascontiguousarray(self.law.gain_values, dtype=float),
            "position": np.ascontiguousarray(positions),
            "velocity": velocities,
        }

    @cached_property
    def program(self) -> BatchProgram:
        """The functions of the loop, compiled by the first run or by its `build`."""
        return BatchProgram(self.robot, self.law, self.plant, self.settings, self.observer, self.measurement)


def scenario_loop(scenario: Scenario, law: SampledLaw, duration: float, **options: Any) -> ClosedLoop:
    """Return the closed loop of a scenario under a law, with its limits, start, stop policy, observer and measurement.

    options: of ClosedLoop.
    """
    return ClosedLoop(
        scenario.plant.robot,
        law,
        scenario.reference,
        scenario.x0,
        duration,
        scenario.sample_period,
        inner_steps=scenario.inner_steps,
        plant=scenario.plant,
        settings=scenario.settings,
        observer=scenario.observer,
        measurement=scenario.measurement,
        **options,
    )


def _segments(delay: Array, period: float, inner_steps: int) -> tuple[NDArray[np.int64], Array]:
    """Split the sample period where the effort changes: (k, 2, 2) age of the effort and steps, (k, 2) their dt [s]."""
    whole, late = np.divmod(delay, period)
    lengths = np.stack([late, period - late], axis=1)
    steps = np.ceil(lengths / (period / inner_steps) - 1e-9).astype(np.int64)
    ages = np.stack([whole + 1, whole], axis=1).astype(np.int64)
    return np.ascontiguousarray(np.stack([ages, steps], axis=2)), lengths / np.maximum(steps, 1)
