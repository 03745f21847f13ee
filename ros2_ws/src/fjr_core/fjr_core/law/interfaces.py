# SPDX-License-Identifier: Apache-2.0
"""Base classes of laws: sampled laws, which may have a controller state, and static laws u(x, x, t) without one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property
from typing import Any, TypeVar

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainsError, StateError
from ..model.robot import Robot, check_robot
from ..motions.reference import JETS
from ..numerics.checks import Array, instance, is_diagonal
from ..numerics.jit import compiled
from ..numerics.one_line import joints, one_line
from ..numerics.symbolic import dense_function, evaluate
from .lie_derivative import Flow

Law = TypeVar("Law", bound="StaticLaw")
ARGUMENTS = ("position", "velocity", "jets", "gains", "memory", "sent", "dt")
"""Arguments of SampledLaw.step_function, in order."""


class SampledLaw(ABC):
    """A law evaluated once per sample with its effort held; the reference is evaluated `lead` [s] after the stamp.

    robot: its model. in_python: True for a law that is evaluated in Python and cannot be compiled.
    """

    robot: Robot
    in_python = False
    lead = 0.0
    """Time [s] from the sample's stamp to the evaluation of the reference, 0 or more."""

    @property
    @abstractmethod
    def gain_values(self) -> Array:
        """The argument `gains` (g,) of step_function."""

    @property
    def memory(self) -> Array:
        """Initial controller state (m,), the argument `memory` of the first step; (0,) for a static law."""
        return np.zeros(0)

    @property
    @abstractmethod
    def step_function(self) -> ca.Function:
        """The CasADi function of one sample; not compiled, so that it can be part of another function.

        (position (2n,), velocity (2n,), jets (n, 5), gains (g,), memory (m,), sent (n,), dt) -> u (n,), V, next (m,).
        position (q_l, q_m) [rad], velocity (dq_l, dq_m) [rad/s]. memory, next: controller state before and after.
        sent [N m]: effort sent at the last sample, after saturation, zero at the first sample. dt [s]: time since
        the last sample, 0 at the first.
        """

    @property
    def function(self) -> ca.Function:
        """The CasADi function that C and a simulation call: step_function, compiled if the law is.

        That of a static law has no memory, sent, dt and next.
        """
        return self.step_function

    @property
    def static(self) -> SampledLaw:
        """The static law inside a law with a controller state, such as robust action; otherwise the law itself."""
        return self

    @property
    def hold_damping(self) -> Array:
        """Motor damping (n, n) [N m s/rad] of the stop policy that holds the weight only; none by default."""
        return np.zeros((self.robot.n, self.robot.n))

    def raise_failure(self) -> None:
        """Raise the error of an evaluation since the last call; only a law in Python fails."""
        return

    def step_symbols(self) -> dict[str, ca.MX]:
        """Return symbols for ARGUMENTS."""
        n = self.robot.n
        sizes = ((2 * n,), (2 * n,), (n, JETS), (len(self.gain_values),), (len(self.memory),), (n,), ())
        return {name: ca.MX.sym(name, *size) for name, size in zip(ARGUMENTS, sizes, strict=True)}


class StaticLaw(SampledLaw):
    """A static law u(x, x, t) of a robot as a pure function, with a storage V (nan if it has none).

    Subclasses define `measured_expressions` and `hold_damping`. Gains are arguments of the function, so that
    with_gains builds and compiles nothing. Efforts are neither saturated nor checked for finite values.
    gains: named as in the paper; `arrays(robot)` returns the arrays of the law's equations by name, and raises
    GainsError if the paper's conditions are violated.
    observes: what an observer of its own estimates, "" if it has none.
    """

    observes = ""

    def __repr__(self) -> str:
        return f"{type(self).__name__}({joints(self.robot.n)}, {one_line(self.gains)})"

    def __init__(self, robot: Robot, gains: Any, compile: bool = False) -> None:
        check_robot(robot)
        self.robot = robot
        self.gains = gains
        self.arrays: dict[str, Array] = gains.arrays(robot)
        self.compiles = compile

    def with_gains(self: Law, gains: Any) -> Law:
        """Return the law with other gains; nothing is built or compiled.

        Raises GainsError as the constructor does, and for a full matrix where the gain of this law is diagonal.
        """
        other = type(self)(self.robot, gains, self.compiles)
        other.symbols = self.symbols
        other.function = self.function
        built = ("measured_expression", "step_function")  # unless the compiled function came from the cache
        vars(other).update({name: vars(self)[name] for name in built if name in vars(self)})
        other.gain_values = self.symbols.values(other.arrays)
        return other

    @abstractmethod
    def measured_expressions(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """Return the arguments of `function`, and expressions of u (n,), V and further outputs."""

    @property
    @abstractmethod
    def hold_damping(self) -> Array:
        """Motor damping (n, n) [N m s/rad] of the stop policy that holds the weight only."""

    @cached_property
    def symbols(self) -> ArraySymbols:
        """Symbols of the gains, of which law and certificate are functions."""
        return ArraySymbols(self.arrays)

    @cached_property
    def gain_values(self) -> Array:
        """The argument `gains` (g,) of `function`."""
        return self.symbols.values(self.arrays)

    @property
    def sampled(self) -> SampledLaw:
        """The law as it is run: itself, unless it has an observer of its own (`observes`)."""
        return self

    def at_measured(self, f: Flow, outputs: dict[str, ca.SX]) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """Return the arguments of `function`, and outputs in the symbols of f as expressions of them."""
        n = self.robot.n
        position, velocity = ca.SX.sym("position", 2 * n), ca.SX.sym("velocity", 2 * n)
        values = f.at_velocities([ca.vertcat(position, velocity)], *outputs.values())
        inputs = {"position": position, "velocity": velocity, "jets": f.jets, "gains": self.symbols.vector}
        return inputs, dict(zip(outputs, values, strict=True))

    def measured_command(self, position: ArrayLike, velocity: ArrayLike, jets: ArrayLike) -> tuple[Array, float]:
        """Return u(x, x, t) (n,) [N m] and V [J] for a measured position and velocity.

        position (q_l, q_m) [rad] and velocity (dq_l, dq_m) [rad/s], (2n,) each; jets (5, n): q_ld .. d4q_ld.
        V is nan if the law has no storage. Raises StateError for wrong shapes, UserCodeError.
        """
        u, V = evaluate(self.function, position, velocity, jets, self.gain_values)
        self.raise_failure()
        return u, float(V[0])

    def command(self, x: ArrayLike, jets: ArrayLike) -> Array:
        """Return u(x, x, t) (n,) [N m] at a state x (4n,) with momenta; jets (5, n). Raises UserCodeError."""
        u = evaluate(self.command_function, x, jets)[0]
        self.raise_failure()
        return u

    @cached_property
    def command_function(self) -> ca.Function:
        """The CasADi function (x, jets (n, 5)) -> u(x, x, t), V; compiled if requested."""
        n = self.robot.n
        kind = ca.MX if self.in_python else ca.SX
        x, jets = kind.sym("x", 4 * n), kind.sym("jets", n, JETS)
        u, V = self.measured_expression(x[: 2 * n], self.robot.to_velocity(x), jets, ca.DM(self.gain_values))
        return self.ready(dense_function("command", {"x": x, "jets": jets}, {"u": u, "V": V}, cse=True))

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (position (2n,), velocity (2n,), jets (n, 5), gains) -> u, V; compiled if requested."""
        return self.ready(self.measured_expression)

    @cached_property
    def measured_expression(self) -> ca.Function:
        """`function`, not compiled, so that it can be part of another function."""
        inputs, outputs = self.measured_expressions()
        return dense_function("measured_command", inputs, {key: outputs[key] for key in ("u", "V")}, cse=True)

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function; it does not depend on memory, sent and dt."""
        s = self.step_symbols()
        u, V = self.measured_expression(s["position"], s["velocity"], s["jets"], s["gains"])
        return dense_function("sampled_law", s, {"u": u, "V": V, "next": s["memory"]})

    def ready(self, function: ca.Function) -> ca.Function:
        """Return the function, compiled if this law is compiled."""
        return compiled(function) if self.compiles else function


def check_law(law: object) -> None:
    """Raise StateError unless `law` is a SampledLaw."""
    expected = "a law of fjr_core, e.g. fjr.TrackingLaw(robot, gains), fjr.PythonLaw(own, robot), "
    expected += "or an object of a subclass of fjr_core.law.interfaces.SampledLaw"
    instance("law", law, SampledLaw, StateError, expected)


class ArraySymbols:
    """Symbols for named arrays, so that one function serves all values with this sparsity pattern.

    A square matrix that is diagonal on construction must stay diagonal.
    """

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self._shapes = {name: _shape(array) for name, array in arrays.items()}
        self.by_name = {name: ca.SX.sym(name, shape) for name, shape in self._shapes.items()}
        self.vector = ca.vertcat(*(ca.vertcat(*symbol.nonzeros()) for symbol in self.by_name.values()))

    @property
    def pattern(self) -> str:
        """Description of which arrays are diagonal."""
        return str({name: shape.is_diag() for name, shape in self._shapes.items()})

    def values(self, arrays: Mapping[str, Array]) -> Array:
        """Return the values of the symbols in `vector`; raise GainsError for another sparsity pattern."""
        parts: list[float] = []
        for name, shape in self._shapes.items():
            if shape.is_square() and shape.is_diag() and not is_diagonal(arrays[name]):
                raise GainsError(
                    f"{name.removesuffix('_inverse')} has entries off the diagonal; expected a diagonal matrix, "
                    "as when the law was built"
                )
            parts += ca.project(ca.DM(arrays[name]), shape).nonzeros()
        return np.array(parts, dtype=float)


def _shape(array: Array) -> ca.Sparsity:
    if array.ndim == 2 and array.shape[0] == array.shape[1] and is_diagonal(array):
        return ca.Sparsity.diag(len(array))
    return ca.Sparsity.dense(*(array.shape if array.ndim == 2 else (len(array), 1)))
