# SPDX-License-Identifier: Apache-2.0
"""Build the control step (step.h and the C files beside it), and fill its structures."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from ..law.interfaces import SampledLaw
from ..law.vdpbc import TrackingLaw
from ..model.robot import Robot
from ..numerics.checks import Array
from ..numerics.jit import CFunction, CLibrary, WorkSpace, c_library, compiled, machine_code
from ..numerics.symbolic import dense_function, symbols
from .measurement_model import Measurement
from .safety_settings import GRAVITY_HOLD, REACTIONS, Settings
from .velocity_observer import VelocityObserver

HEADER = "step.h"
SOURCES = (
    "journal.c",
    "stamps.c",
    "measurement.c",
    "reference.c",
    "state_limits.c",
    "effort_limits.c",
    "stop_policy.c",
    "transfer.c",
    "law.c",
    "active_reference.c",
    "supervisor.c",
    "wiring_rows.c",
    "wiring.c",
    "step.c",
    "certificate.c",
    "contact.c",
    "external_torque.c",
    "auxiliary_rate.c",
)
"""The C files in the order of their translation unit."""
_NUMBER = re.compile(r"^#define (\w+) ([\d.e+-]+)", re.MULTILINE)

LIMITED = ("link_velocity", "motor_velocity", "deflection", "tracking_error")
"""Settings that are the largest magnitude of a quantity, in the order of struct fjr_settings."""


@cache
def step_library(n: int, memory: int = 1) -> CLibrary:
    """Return the step for n joints and a law with `memory` numbers as its controller state, compiled and cached.

    Raises CompilerError without a C compiler.
    """
    return c_library("control_step", text(HEADER), c_code(), sizes(n, memory))


def sizes(n: int, memory: int) -> dict[str, int]:
    """Return the macros of the step for n joints and a controller state of `memory` numbers."""
    return {"FJR_N": n, "FJR_MEMORY": max(1, memory)}


def c_code() -> str:
    """Return the text of the C files, to follow that of step.h."""
    return "\n".join(text(name).replace(f'#include "{HEADER}"\n', "") for name in SOURCES)


def c_text(n: int, memory: int) -> str:
    """Return the translation unit of the step for n joints and a controller state of `memory` numbers."""
    return "\n".join([*(f"#define {name} {size}" for name, size in sizes(n, memory).items()), text(HEADER), c_code()])


def text(name: str) -> str:
    """Return the text of a file of this folder."""
    return Path(__file__).with_name(name).read_text(encoding="utf-8")


def constant(name: str) -> float:
    """Return the number of a macro of step.h or of the C files. Raises KeyError."""
    return {found: float(number) for found, number in _NUMBER.findall(c_text(1, 1))}[name]


def settings_struct(library: CLibrary, settings: Settings, law: SampledLaw) -> Any:
    """Return struct fjr_settings: limits and durations of the settings, B_m and K_md of the law's robot."""
    magnitudes = [np.asarray(getattr(settings, name)) for name in LIMITED]
    upper = [settings.link_position_upper, settings.motor_position_upper, *magnitudes]
    lower = [settings.link_position_lower, settings.motor_position_lower, *(-size for size in magnitudes)]
    arrays = {
        "effort": settings.effort,
        "effort_rate": settings.effort_rate,
        "lower": np.concatenate(lower),
        "upper": np.concatenate(upper),
        "start_error": settings.start_error,
        "acceleration": settings.acceleration,
        "B_inverse": np.linalg.inv(law.robot.B_m),
        "hold_damping": law.hold_damping,
    }
    numbers = ("ramp_time", "start_join_time", "recovery_join_time", "recovery_longest_gap", "hold_deceleration")
    values: dict[str, Any] = {name: np.ravel(array).tolist() for name, array in arrays.items()}
    values |= {name: getattr(settings, name) for name in (*numbers, "wiring_check")}
    values["state_timeout"] = round(settings.state_timeout * 1e9)
    values["gravity_hold"] = settings.on_stop == GRAVITY_HOLD
    values["on_contact"] = REACTIONS.index(settings.on_contact)
    return library.ffi.new("struct fjr_settings *", values)


class Model:
    """struct fjr_model of a law with or without robust action; `pointer` is valid as long as this object lives.

    functions: model_functions. law_failed: called after each evaluation of a law in Python; True if it failed.
    sharing: further functions that use the same work space.
    """

    def __init__(
        self,
        library: CLibrary,
        law: SampledLaw,
        functions: Mapping[str, ca.Function],
        observer: VelocityObserver | None = None,
        measurement: Measurement | None = None,
        simulated: bool = False,
        law_failed: Callable[[], bool] | None = None,
        sharing: Sequence[ca.Function] = (),
    ) -> None:
        self._ffi, self._law_failed, n = library.ffi, law_failed, law.robot.n
        self._functions = dict(functions)
        self._sharing = list(sharing)
        self.pointer = library.ffi.new("struct fjr_model *")
        self._point()
        self.pointer.has_memory = len(law.memory) > 0
        self.pointer.memory = law.memory.tolist() or [0.0]
        self.pointer.lead, self.pointer.simulated = round(law.lead * 1e9), simulated
        self.pointer.bandwidth = observer.bandwidth if observer is not None else 0.0
        write_robot(self.pointer, law.robot)
        measured = measurement or Measurement(n)
        self.pointer.torque = measured.by_torque
        self.pointer.gear_ratio = np.broadcast_to(measured.gear_ratio, (n,)).tolist()
        if measured.K is not None:
            self.pointer.compliance = np.linalg.inv(measured.K).ravel().tolist()

    @property
    def in_c(self) -> bool:
        """True if no function is evaluated in Python."""
        return all(machine_code(function) is not None for function in self._functions.values())

    def use(self, law: SampledLaw) -> None:
        """Replace the law by one of the same robot and a controller state of the same length."""
        if law.function is not self._functions["law"]:
            self._functions["law"] = law.function
            self._point()

    def _point(self) -> None:
        """Let the structure point to the functions and to memory for their temporary values."""
        failed = {"law": self._law_failed}
        self._held = [CFunction(self._ffi, f, failed.get(name)) for name, f in self._functions.items()]
        for name, each in zip(self._functions, self._held, strict=True):
            setattr(self.pointer, name, each.pointer)
        self._work = WorkSpace(self._ffi, [*self._functions.values(), *self._sharing])
        self._work.lend(self.pointer)


def model_functions(
    law: SampledLaw, observer: VelocityObserver | None = None, compile: bool = False
) -> dict[str, ca.Function]:
    """Return the functions of struct fjr_model by their names; the wiring is checked where velocities are measured.

    Those of the rigid arm are compiled if the law is. compile: compile all but a law in Python.
    """
    functions = {"law": law.function, **rigid_arm_functions(law.robot)}
    names = [] if machine_code(functions["law"]) is None else ["gravity", "dynamics"]
    if observer is not None:
        functions["observer"] = observer.function
        del functions["dynamics"]
    if compile:
        names = [name for name in functions if name != "law" or not law.in_python]
    return {name: compiled(f) if name in names and machine_code(f) is None else f for name, f in functions.items()}


def rigid_arm_functions(robot: Robot) -> dict[str, ca.Function]:
    """Return gravity: q_l -> grad P_l (n,), and dynamics: (q_l, dq_l) -> M_l (n, n), C(q_l, dq_l) dq_l (n,)."""
    s, links = symbols(q_l=robot.n, dq_l=robot.n), robot.links
    q_l, dq_l = s.values()
    weight, moving = {"grad_P_l": links.grad_P_l(q_l)}, {"M_l": links.M_l(q_l), "coriolis": links.C(q_l, dq_l, dq_l)}
    gravity = dense_function("gravity", {"q_l": q_l}, weight, cse=True)
    return {"gravity": gravity, "dynamics": dense_function("dynamics", s, moving, cse=True)}


def write_robot(model: Any, robot: Robot) -> None:
    """Write the constant matrices of a robot to a struct fjr_model, by rows."""
    for name in ("K", "M_m", "B_m", "D_l", "D_m"):
        setattr(model, name, np.ravel(getattr(robot, name)).tolist())
    model.slides = robot.prismatic or (False,) * robot.n
    model.cubic = [0.0] * robot.n if robot.cubic is None else robot.cubic.tolist()
    if robot.torsion is not None:
        model.pieces = len(robot.curves[0].edge)
        for name, field in (("edge", "edge"), ("torsion", "torque"), ("tangent", "stiffness"), ("bend", "slope")):
            values = np.column_stack([getattr(of, field) for of in robot.curves]).ravel()
            getattr(model, name)[0 : len(values)] = values.tolist()


class CertificateStruct:
    """The certificate of a law; `pointer` is a struct fjr_certificate*, valid as long as this object lives.

    ffi: with the types of step.h. functions: certify, predict and law, machine code or not. longest [s]: between two
    samples that are compared.
    """

    def __init__(self, ffi: Any, functions: Mapping[str, ca.Function], law: TrackingLaw, longest: float) -> None:
        self._held = {name: CFunction(ffi, function) for name, function in functions.items()}
        self._work, self._ffi = WorkSpace(ffi, list(functions.values())), ffi
        self.pointer = ffi.new("struct fjr_certificate *")
        for name, function in self._held.items():
            setattr(self.pointer, name, function.pointer)
        self._work.lend(self.pointer)
        self.pointer.B_m = np.ravel(law.robot.B_m).tolist()
        self.pointer.longest, self.pointer.bounded = longest, True
        self._gains: Array | None = None

    def keep(self, law: TrackingLaw) -> Any:
        """Return the gains of a law for C; those before are released by the next call."""
        self._before, self._gains = self._gains, np.ascontiguousarray(law.gain_values, dtype=float)
        return self._ffi.from_buffer("double[]", self._gains)
