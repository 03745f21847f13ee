# SPDX-License-Identifier: Apache-2.0
"""Run the sampled closed loop of one robot, law and reference many times with drawn parameters.

The loop is compiled: loop.c around the control step of the node, which call law, observer and plant.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fjr_core.errors import StateError
from fjr_core.files.importing import source_digest
from fjr_core.law.interfaces import SampledLaw
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.robot import Robot
from fjr_core.motions.reference import Reference
from fjr_core.numerics import checks, jit
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import CFunction, CLibrary, c_library, program_digest
from fjr_core.runtime.events import KINDS, STARTS_REFUSED, STOPS
from fjr_core.runtime.library import HEADER, Model, c_code, model_functions, settings_struct, sizes, text
from fjr_core.runtime.measurement_model import Measurement
from fjr_core.runtime.reference import ReferenceStruct
from fjr_core.runtime.safety_settings import Settings
from fjr_core.runtime.velocity_observer import VelocityObserver
from fjr_core.simulation.closed_loop import check_joints

from . import parametric_robot
from .draws import PARAMETERS, Draws

if TYPE_CHECKING:
    from fjr_core.config.scenario import Scenario

LAST = 1.0  # s; averaging time of Outcomes.final
BAND, LOST = (0.01, 0.002), (float(np.pi / 2), 0.3)
"""Default of ClosedLoop.band and lost for a revolute [rad] and for a prismatic joint [m]."""
LANES = 4  # number of interleaved runs
SOURCES = ("loop.h", "noise.c", "loop.c")


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Outcomes of k runs of n joints; errors are q_l - q_ld at the samples, efforts the saturated commands.

    stable (k,): all numbers are finite and no error exceeds ClosedLoop.lost; lost_at (k,) [s]: end of a run that is not
    stable, else inf. rms, peak (k, n) [rad]: of the errors after settle_after. final (k, n) [rad]: mean magnitude of
    the errors over the last second. settling (k,) [s]: instant after which every error stays within ClosedLoop.band;
    inf: never. effort_rms, effort_peak (k, n) [N m]: from the start. effort_noise (k, n) [N m]: RMS of
    (u_k - u_(k-1)) / 2^(1/2) after settle_after, the standard deviation of white noise in the effort. power (k,) [W]:
    mean of |u' B_m' dq_m|.
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
    settle_after [s], band (n,) [rad]: see Outcomes. lost (n,) [rad]: a run ends as not stable if a link error exceeds
    it or a number is not finite. plant: a plant in Python that replaces the equations of motion of the robot. settings:
    limits, start and stop policy; by default none but the effort limit of the draws, and in any case the tighter of
    both effort limits. observer, measurement: of the controller; by default velocities are measured.
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
    band: ArrayLike | None = None
    lost: ArrayLike | None = None
    plant: Plant | None = None
    settings: Settings | None = None
    observer: VelocityObserver | None = None
    measurement: Measurement | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "x0", checks.vector("x0", self.x0, 4 * self.robot.n, StateError))
        check_joints(self.robot, self.law.robot, self.reference)
        for name in ("duration", "sample_period"):
            checks.positive(name, getattr(self, name), StateError)
        for name, given, usual in (("band", self.band, BAND), ("lost", self.lost, LOST)):
            sizes = [usual[unit.position == "m"] for unit in self.robot.units] if given is None else given
            object.__setattr__(self, name, checks.positive_vector(name, sizes, self.robot.n, StateError))
        if not checks.positive("settle_after", self.settle_after, StateError, zero=True) < self.duration:
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

    @property
    def in_python(self) -> bool:
        """Return whether law or plant are evaluated in Python."""
        return self.law.in_python or self._plant_in_python

    @property
    def _plant_in_python(self) -> bool:
        return self.plant is not None and self.plant.in_python

    @cached_property
    def library(self) -> CLibrary:
        """Return loop and control step in C; raises CompilerError."""
        return batch_library(self.robot.n, len(self.law.memory))

    @cached_property
    def model_functions(self) -> Mapping[str, ca.Function]:
        """Return law, gravity and observer by their names in struct fjr_model, as machine code if possible."""
        return model_functions(self.law, self.observer, compile=True)

    @cached_property
    def plant_functions(self) -> Mapping[str, ca.Function]:
        """Return the functions of the plants, as machine code unless the plant is in Python."""
        functions = self._plant_expressions
        if self._plant_in_python:
            return functions
        return dict(zip(functions, jit.compiled_together("simulated_plant", functions.values()), strict=True))

    @cached_property
    def _plant_expressions(self) -> dict[str, ca.Function]:
        """Return the functions of the plants, named as the members of struct fjr_plant, not compiled."""
        own = self.plant if self._plant_in_python else None
        kinds = (parametric_robot.PLAIN, parametric_robot.WHOLE)
        plain, whole = (parametric_robot.ParametricPlant(self.robot, kind, own).functions_as_c for kind in kinds)
        return {**plain, **whole}

    @cached_property
    def fingerprint(self) -> str:
        """Return a hash that differs for programs whose results may differ."""
        functions = [self.law.step_function, *self._plant_expressions.values()]
        parts = [program_digest(), *(function.serialize() for function in functions)]
        owners = (getattr(part, "own", None) for part in (self.law.static, self.plant))
        parts += [source_digest(type(own)) for own in owners if own is not None]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def build(self) -> None:
        """Compile everything that a run needs; raises CompilerError without a C compiler."""
        _ = self.library, self.model_functions, self.plant_functions

    def with_law(self, law: SampledLaw, observer: VelocityObserver | None = None) -> ClosedLoop:
        """Return the loop with another law of the same form, whose gains differ; nothing is compiled again.

        The law has the same class, robot model, options and number of gains as that of this loop. observer: replaces
        that of this loop, with another bandwidth. Raises StateError.
        """
        mine, others = _form(self.law), _form(law)
        if mine != others:
            raise StateError(f"the law is {others}; expected {mine}, with other gains")
        other = replace(self, law=law, observer=observer or self.observer)
        for name in ("library", "model_functions", "plant_functions"):
            other.__dict__[name] = getattr(self, name)
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
        """Return the rows of the draws and fill `trace`, if any; raise the error of an evaluation in Python."""
        ffi, rows = self.library.ffi, np.empty((draws.runs, row_width(self.robot.n)))
        values = {**self._values(draws), "rows": rows, "trace": trace}
        given = self.library, self.law, self.model_functions, self.observer, self.measurement
        model = Model(*given, simulated=True, sharing=list(self.plant_functions.values()))
        followed = ReferenceStruct(ffi, self.reference)
        plants = {name: CFunction(ffi, function) for name, function in self.plant_functions.items()}
        settings = settings_struct(self.library, self.settings or plain_settings(self.robot.n), self.law)
        batch = ffi.new("struct fjr_batch *", {"settings": settings, "reference": followed.pointer})
        for name, function in plants.items():
            kind, _, what = name.partition("_")
            setattr(getattr(batch, kind), what, function.pointer)
        _fill(ffi, batch, values)
        self._simulate(batch, draws.runs, model, followed, settings, plants, values)
        followed.raise_failure()
        self.law.raise_failure()
        if self.plant is not None:
            self.plant.raise_failure()
        return rows

    def _simulate(self, batch: Any, runs: int, model: Model, *owners: Any) -> None:
        """Run the batch in another thread, so that Ctrl-C ends it here and is not raised in a callback.

        owners: of the memory that the batch points to; the thread keeps them until it ends, after Ctrl-C too.
        """
        ffi, lib, _ = self.library
        rings = ffi.new("double[]", LANES * batch.ring * self.robot.n)

        def simulate(*_: Any) -> None:
            lib.fjr_run_batch(model.pointer, batch, 0, runs, rings)

        pool = ThreadPoolExecutor(1)
        try:
            pool.submit(simulate, *owners).result()
        except BaseException:
            batch.cancelled = 1
            raise
        finally:
            pool.shutdown(wait=False)

    def _values(self, draws: Draws) -> dict[str, Any]:
        """Return numbers and arrays of struct fjr_batch: of all runs, and of each."""
        n = self.robot.n
        parts = {name: draws.columns(name, n) for name in parametric_robot.NAMES}
        parametric_robot.refuse(self.robot, self._plant_in_python, parts)
        full = np.hstack([parts[name] != PARAMETERS[name].nominal for name in parametric_robot.FULL]).any(axis=1)
        sensing = [draws.columns(name, n) for name in ("position_noise", "velocity_noise", "resolution")]
        segments, dt = _segments(draws.columns("delay", n)[:, 0], self.sample_period, self.inner_steps)
        return {
            "samples": self._samples,
            "first": self._first,
            "last_second": max(0, self._samples - round(LAST / self.sample_period)),
            "period": self.sample_period,
            "lost": self.lost,
            "band": self.band,
            "gains": np.ascontiguousarray(self.law.gain_values, dtype=float),
            "position": np.array(self.x0)[: 2 * n],
            "B_m": np.ascontiguousarray(self.robot.B_m),
            "velocity": np.hstack(self.robot.velocities(self.x0)),
            "parameters": (parameters := parametric_robot.vector(parts)),
            "width": parameters.shape[1],
            "sensing": np.ascontiguousarray(np.hstack(sensing)),
            "limit": draws.columns("effort_limit", n),
            "is_full": np.asarray(full, dtype=np.uint8),
            "segments": segments,
            "ring": int(segments[:, :, 0].max(initial=0)) + 1,
            "dt": dt,
            "seeds": draws.seed,
        }

    @property
    def _samples(self) -> int:
        return int(self.duration / self.sample_period + 1e-9)

    @property
    def _first(self) -> int:
        """Return the first sample whose error counts."""
        return int(np.ceil(self.settle_after / self.sample_period - 1e-9))


@cache
def batch_library(n: int, memory: int) -> CLibrary:
    """Return the compiled loop for n joints and a law with `memory` numbers as its controller state.

    Raises CompilerError without a C compiler.
    """
    header, *code = (Path(__file__).with_name(name).read_text(encoding="utf-8") for name in SOURCES)
    values = {**sizes(n, memory), "LANES": LANES}
    return c_library("simulation_loop", text(HEADER) + header, "\n".join([c_code(), *code]), values)


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


def _form(law: SampledLaw) -> str:
    """Return what laws share that differ in the values of their gains only: classes, sizes, prediction."""
    sizes = f"{len(law.gain_values)} gains and a controller state of {len(law.memory)}"
    return f"a {type(law.static).__name__} with {sizes}, evaluated {law.lead:g} s ahead"


def plain_settings(n: int) -> Settings:
    """Return settings without limits, checks, ramp and transitions for n joints, at any sample period."""
    return Settings(tuple(f"joint{i + 1}" for i in range(n)), state_timeout=1e9, wiring_check=False)


def _fill(ffi: Any, struct: Any, values: Mapping[str, Any]) -> None:
    """Write numbers and contiguous arrays, which must outlive the structure, to its fields; None: no array."""
    types = dict(ffi.typeof(struct).item.fields)
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            value = ffi.cast(types[name].type, value.ctypes.data)
        if value is not None:
            setattr(struct, name, value)
