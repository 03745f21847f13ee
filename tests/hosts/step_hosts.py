# SPDX-License-Identifier: Apache-2.0
"""Efforts of a recorded sequence from the control step in Python, in a study, in exported C and in ros2_control."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from design.exports.c_program import C99, built
from design.exports.ros2_control import exported_package
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.jit import CLibrary
from fjr_core.runtime.events import KINDS
from fjr_core.runtime.library import Model, settings_struct, step_library
from fjr_core.runtime.reference import ReferenceStruct
from fjr_design.batch.program import BatchProgram
from fjr_design.exports.project import export, write
from hosts.inputs import Kind, Sequence
from time_limits import HANG

Efforts = NDArray[np.float64]
HERE = Path(__file__).parent
CONTROLLER = tuple(name for name in exported_package.SOURCES if name != "elastic_arm")
SAMPLES = 2  # of the recorded case, which is not used here


class Replay(NamedTuple):
    """Efforts (k, n) that were sent, their number after each input, and the counters of the controller by name."""

    efforts: Efforts
    counts: list[int]
    counters: dict[str, int]


def reference_replay(sequence: Sequence, repeats: bool = True) -> Replay:
    """Replay the inputs in the control step in Python; repeats: states with the stamp of the last one arrive."""
    step = sequence.scenario.control_step(sequence.simulated)
    first = bytes(step.ffi.buffer(step.controller))

    def restart() -> None:
        step.ffi.memmove(step.controller, first, len(first))

    host = _Host(step.ffi, step.lib, step.model, step.controller, restart, changes(step.library, sequence))
    return host.replay(sequence, repeats)


def campaign_efforts(sequence: Sequence) -> Efforts:
    """Return all efforts (k, n) that the step of the compiled loop of a study sends."""
    s = sequence.scenario
    law, settings, measured, seen = s.sampled_law, s.settings, s.measurement, s.observer
    program = BatchProgram(s.plant.robot, law, s.plant, settings, seen, measured)
    ffi, lib, _ = program.library
    model = Model(program.library, law, program.model_functions, seen, measured, sequence.simulated)
    reference, gains = ReferenceStruct(ffi, s.reference), np.ascontiguousarray(law.gain_values, dtype=float)
    written = settings_struct(program.library, settings, law)
    controller = ffi.new("struct fjr_controller *")

    def restart() -> None:
        lib.fjr_init(controller, written, ffi.cast("double *", gains.ctypes.data), reference.pointer)

    restart()
    changed = changes(program.library, sequence)
    return _Host(ffi, lib, model.pointer, controller, restart, changed).replay(sequence).efforts


class Changes(NamedTuple):
    """What a CHANGE sets: struct fjr_settings, gains, and K_md by rows [N m s/rad]."""

    settings: Any
    gains: Efforts
    hold_damping: Efforts


def changes(library: CLibrary, sequence: Sequence) -> Changes:
    """Return settings and gains of the changed scenario."""
    s = sequence.changed_scenario
    settings = settings_struct(library, s.settings, s.law)
    numbers = (np.ascontiguousarray(each, dtype=float) for each in (s.sampled_law.gain_values, s.law.hold_damping))
    return Changes(settings, *numbers)


class _Host:
    """Call the functions of step.h for all inputs, as a node does, and keep the efforts that they send."""

    def __init__(
        self, ffi: Any, lib: Any, model: Any, controller: Any, restart: Callable[[], None], changed: Changes
    ) -> None:
        self._ffi, self._lib, self._model, self._controller = ffi, lib, model, controller
        self._command = ffi.new("struct fjr_command *")
        self._sent: list[bytes] = []
        self._changed = changed
        self._other: dict[int, Callable[[], None]] = {
            Kind.HOLD: lambda: lib.fjr_hold(controller),
            Kind.RESUME: lambda: lib.fjr_resume(controller),
            Kind.CHANGE: self._change,
            Kind.RESTART: restart,
        }

    def replay(self, sequence: Sequence, repeats: bool = True) -> Replay:
        """Give all inputs to the step; repeats: see reference_replay."""
        counts, last = [], None
        for number in range(sequence.rounds):
            table = sequence.table_of(number)
            samples = table.ctypes.data + table.dtype.fields["stamp"][1]
            for k, (kind, time, stamp) in enumerate(table[["kind", "time", "stamp"]].tolist()):
                if kind == Kind.STATE and (repeats or stamp != last):
                    self._take_state(stamp if sequence.simulated else None, time, samples + k * table.itemsize)
                    last = stamp
                elif kind == Kind.TICK:
                    self._check_silence(time)
                elif kind in self._other:
                    self._other[kind]()
                counts.append(len(self._sent))
        counters = dict(zip(KINDS, self._controller.journal.count, strict=True))
        n = len(sequence.scenario.joints)
        return Replay(np.frombuffer(b"".join(self._sent)).reshape(-1, n), counts, counters)

    def _take_state(self, now: int | None, time: int, address: int) -> None:
        """Compute the command for a sample; now: simulated time, in which a silence ends with it."""
        if now is not None:
            self._check_silence(now)
        sample = self._ffi.cast("struct fjr_sample *", address)
        if self._lib.fjr_step(self._model, self._controller, sample, time, self._command):
            self._sent.append(bytes(self._ffi.buffer(self._command.u)))

    def _check_silence(self, now: int) -> None:
        u = self._command.u
        if self._lib.fjr_silence(self._model, self._controller, now, u):
            self._sent.append(bytes(self._ffi.buffer(u)))

    def _change(self) -> None:
        settings, *numbers = self._changed
        gains, damping = (self._ffi.cast("double *", each.ctypes.data) for each in numbers)
        self._lib.fjr_use_gains(self._controller, gains, damping)
        self._lib.fjr_apply(self._controller, settings)


def c_program(scenario: Scenario, folder: Path) -> Path:
    """Export a scenario as C, compile it with the host replay.c and return the program."""
    write(export(scenario, "fjr", SAMPLES), folder)
    sources = [*folder.glob("fjr*.c"), HERE / "replay.c"]
    return built([*C99, "-O2"], sources, folder / "replay", f"-I{folder}", f"-I{HERE}")


def controller_program(scenario: Scenario, folder: Path) -> Path:
    """Export a scenario for ros2_control, compile its controller with the host replay.cpp and return the program."""
    package = exported_package.package_name_of(scenario.name)
    exported_package.exported(scenario, folder, SAMPLES)
    return exported_package.linked(folder, package, CONTROLLER, HERE / "replay.cpp")


def program_efforts(program: Path, sequence: Sequence) -> Efforts:
    """Return all efforts (k, n) that a program sends."""
    inputs, changed = (program.with_name(name) for name in ("inputs", "changed"))
    inputs.write_bytes(sequence.table.tobytes())
    changed.write_bytes(_changed(sequence))
    numbers = map(str, (sequence.rounds, sequence.shift, int(sequence.simulated)))
    words = [str(program), str(inputs), *numbers, str(changed)]
    done = subprocess.run(words, stdout=subprocess.PIPE, timeout=HANG, check=True)
    return np.frombuffer(done.stdout).reshape(-1, len(sequence.scenario.joints))


def _changed(sequence: Sequence) -> bytes:
    """Return what a CHANGE sets, as replay.c reads it."""
    law = sequence.scenario.sampled_law
    library = step_library(law.robot.n, len(law.memory))
    settings, *numbers = changes(library, sequence)
    return b"".join([bytes(library.ffi.buffer(settings)), *(each.tobytes() for each in numbers)])
