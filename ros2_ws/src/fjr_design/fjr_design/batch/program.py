# SPDX-License-Identifier: Apache-2.0
"""Build the closed loop of many runs: the control step and loop.c in C, which call law, observer and plant."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.errors import StateError
from fjr_core.files.importing import source_digest
from fjr_core.law.interfaces import SampledLaw, in_python, raise_failure, static_part
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.robot import Robot
from fjr_core.motions.reference import Reference
from fjr_core.numerics import jit
from fjr_core.numerics.jit import CLibrary, c_library, program_digest
from fjr_core.runtime.library import HEADER, CFunction, Model, c_code, model_functions, settings_struct, sizes, text
from fjr_core.runtime.measurement_model import Measurement
from fjr_core.runtime.reference import ReferenceStruct
from fjr_core.runtime.safety_settings import Settings
from fjr_core.runtime.velocity_observer import VelocityObserver

from .parametric_robot import PLAIN, WHOLE, ParametricPlant

LANES = 4
"""Number of interleaved runs."""
SOURCES = ("loop.h", "noise.c", "loop.c")


@cache
def batch_library(n: int, memory: int) -> CLibrary:
    """Return the compiled loop for n joints and a law with `memory` numbers as its controller state.

    Raises CompilerError without a C compiler.
    """
    header, *code = (Path(__file__).with_name(name).read_text(encoding="utf-8") for name in SOURCES)
    values = {**sizes(n, memory), "LANES": LANES}
    return c_library("simulation_loop", text(HEADER) + header, "\n".join([c_code(), *code]), values)


@dataclass(frozen=True, eq=False)
class BatchProgram:
    """The loop with the functions that it calls: machine code, or callbacks for a law or a plant in Python.

    plant: replaces the equations of motion of the robot if it is in Python.
    """

    robot: Robot
    law: SampledLaw
    plant: Plant | None = None
    settings: Settings | None = None
    observer: VelocityObserver | None = None
    measurement: Measurement | None = None

    @property
    def in_python(self) -> bool:
        """Return whether law or plant are evaluated in Python."""
        return in_python(self.law) or self._plant_in_python

    @property
    def _plant_in_python(self) -> bool:
        return self.plant is not None and self.plant.in_python

    @cached_property
    def library(self) -> CLibrary:
        """Return the compiled loop; raises CompilerError."""
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
    def fingerprint(self) -> str:
        """Return a hash that differs for programs whose results may differ."""
        functions = [self.law.step_function, *self._plant_expressions.values()]
        parts = [program_digest(), *(function.serialize() for function in functions)]
        owners = (getattr(part, "own", None) for part in (static_part(self.law), self.plant))
        parts += [source_digest(type(own)) for own in owners if own is not None]
        return hashlib.sha256("\n".join(parts).encode()).hexdigest()

    def with_law(self, law: SampledLaw, observer: VelocityObserver | None) -> BatchProgram:
        """Return the program of a law of the same form, whose gains differ, with all functions of this one.

        Raises StateError if the law has another form.
        """
        mine, others = _form(self.law), _form(law)
        if mine != others:
            raise StateError(f"the law is {others}; expected {mine}, with other gains")
        other = replace(self, law=law, observer=observer)
        for name in ("library", "model_functions", "plant_functions"):
            other.__dict__[name] = getattr(self, name)
        return other

    def build(self) -> None:
        """Compile everything that `run` needs; raises CompilerError without a C compiler."""
        _ = self.library, self.model_functions, self.plant_functions

    def run(self, reference: Reference, values: Mapping[str, Any]) -> None:
        """Fill values["rows"] and, if present, values["trace"]; values: the fields of struct fjr_batch in loop.h.

        Raise the error of an evaluation in Python.
        """
        ffi = self.library.ffi
        sharing = list(self.plant_functions.values())
        given = self.library, self.law, self.model_functions, self.observer, self.measurement
        model = Model(*given, simulated=True, sharing=sharing)
        followed = ReferenceStruct(ffi, reference)
        plants = {name: CFunction(ffi, function) for name, function in self.plant_functions.items()}
        settings = settings_struct(self.library, self.settings or plain_settings(self.robot.n), self.law)
        batch = ffi.new("struct fjr_batch *", {"settings": settings, "reference": followed.pointer})
        for name, function in plants.items():
            kind, _, what = name.partition("_")
            setattr(getattr(batch, kind), what, function.pointer)
        _fill(ffi, batch, values)
        self._run(batch, len(values["rows"]), model, followed, settings, plants, values)
        followed.raise_failure()
        raise_failure(self.law)
        if self.plant is not None:
            self.plant.raise_failure()

    def _run(self, batch: Any, runs: int, model: Model, *owners: Any) -> None:
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

    @cached_property
    def _plant_expressions(self) -> dict[str, ca.Function]:
        """Return the functions of the plants, named as the members of struct fjr_plant, not compiled."""
        own = self.plant if self._plant_in_python else None
        plain, whole = (ParametricPlant(self.robot, kind, own).functions_as_c for kind in (PLAIN, WHOLE))
        return {**plain, **whole}


def _form(law: SampledLaw) -> str:
    """Return what laws share that differ in the values of their gains only: classes, sizes, prediction."""
    sizes = f"{len(law.gain_values)} gains and a controller state of {len(law.memory)}"
    return f"a {type(static_part(law)).__name__} with {sizes}, evaluated {law.lead:g} s ahead"


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
