# SPDX-License-Identifier: Apache-2.0
"""Laws and plants that a user writes in Python without CasADi (docs/own_law.md).

Their code becomes a CasADi function: it may be part of other functions, but is never compiled.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np

from ..errors import FjrError, GainsError, ParameterError, UserCodeError
from ..files import importing
from ..files.importing import described
from ..law.interfaces import StaticLaw
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot
from ..motions.reference import JETS
from ..numerics.checks import Array, floats, matrix
from ..numerics.integrators import rk4_expression

Shapes = Mapping[str, tuple[int, ...]]
"""Names of arguments or results with the shapes of their arrays."""
INTEGRATOR = "rk4"
"""The only integrator of a plant in Python: an implicit one needs derivatives."""
ARGUMENTS = ("position", "velocity", "jets")
NEARBY = 0.1  # largest argument of the evaluations that would change a memory


class PythonFunction(ca.Callback):
    """A CasADi function that calls `evaluate` with copies of its arguments, which are read-only.

    evaluate: arrays of the shapes `inputs` -> one result for each of `outputs`. CasADi stores a symbol (n, 5) by
    columns, as an array (5, n). Derivatives are central differences.
    If `evaluate` raises an exception, or a result has another shape, all results are nan and `raise_failure` raises
    UserCodeError. The object must live as long as the functions that contain it.
    """

    def __init__(self, name: str, evaluate: Callable[..., Sequence[Any]], inputs: Shapes, outputs: Shapes) -> None:
        ca.Callback.__init__(self)
        self._evaluate, self._inputs, self._outputs = evaluate, dict(inputs), dict(outputs)
        self._failure: FjrError | None = None
        self.construct(name, {"enable_fd": True, "fd_method": "central"})

    def raise_failure(self) -> None:
        """Raise the first error since the last call, if there is one."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def get_n_in(self) -> int:
        """Return the number of arguments."""
        return len(self._inputs)

    def get_n_out(self) -> int:
        """Return the number of results."""
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        """Return the name of an argument."""
        return list(self._inputs)[i]

    def get_name_out(self, i: int) -> str:
        """Return the name of a result."""
        return list(self._outputs)[i]

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        """Return the shape of an argument, dense."""
        return _dense(list(self._inputs.values())[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        """Return the shape of a result, dense."""
        return _dense(list(self._outputs.values())[i])

    def has_eval_buffer(self) -> bool:
        """Return True: `eval_buffer` is called, which copies less than `eval`."""
        return True

    def eval_buffer(self, arguments: Sequence[Any], results: Sequence[Any]) -> int:
        """Evaluate with memory of CasADi; return 0 for success, also after a failure."""
        given = []
        for memory, shape in zip(arguments, self._inputs.values(), strict=True):
            empty = memory is None or 0 in shape
            given.append(np.zeros(shape) if empty else np.frombuffer(memory).reshape(shape).copy())
            given[-1].setflags(write=False)
        for memory, value in zip(results, self._values(given), strict=True):
            if memory is not None:
                np.frombuffer(memory)[:] = value
        return 0

    def _values(self, given: list[Array]) -> list[Array | float]:
        try:
            found = self._evaluate(*given)
            pairs = zip(self._outputs.items(), found, strict=True)
            return [checked(f"{name} of {self.name()}", value, shape) for (name, shape), value in pairs]
        except FjrError as error:
            self._failure = self._failure or error
        except (Exception, SystemExit) as error:
            self._failure = self._failure or UserCodeError(f"{self.name()} raises {described(error)}; expected a value")
        return [np.nan] * len(self._outputs)


def checked(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return a result as an array of the expected shape; raises UserCodeError for another one. It may be nan."""
    array = floats(name, value, UserCodeError, f" of shape {shape}")
    if array.shape != shape:
        raise UserCodeError(f"{name} has shape {array.shape}; expected {shape}")
    return array


def _check_at_rest(name: str, evaluate: Callable[..., Array], *shapes: int | tuple[int, ...]) -> None:
    """Raise UserCodeError unless the result is finite at rest at 0, and again the same there and nearby."""
    rest, rng = [np.zeros(shape) for shape in shapes], np.random.default_rng(0)
    near = [rng.uniform(0.0, NEARBY, shape) for shape in shapes]
    first = evaluate(*rest)
    if not np.isfinite(first).all():
        raise UserCodeError(f"{name} is {first.tolist()} at rest at 0; expected finite numbers")
    try:
        nearby = evaluate(*near), evaluate(*near)
    except UserCodeError:  # it may stop the arm there
        nearby = first, first
    if not all(np.array_equal(*pair, equal_nan=True) for pair in ((first, evaluate(*rest)), nearby)):
        raise UserCodeError(f"{name} differs in a second evaluation; expected a pure function, without memory")


def _dense(shape: tuple[int, ...]) -> ca.Sparsity:
    """Return the CasADi shape of an array: its transpose, since CasADi stores by columns."""
    rows, columns = (*reversed(shape), 1, 1)[:2]
    return ca.Sparsity.dense(rows, columns)


class PythonPlant(Plant):
    """A plant of the user: dx/dt = own.derivative(x, u) (4n,), with the Runge-Kutta step of order 4; not compiled.

    x (4n,) = (q_l, q_m, p_l, p_m), with the momenta p_l = M_l(q_l) dq_l, p_m = M_m dq_m of `robot`; u (n,) [N m]. The
    arrays are read-only. `derivative` is a pure function: its result depends on the arguments only. own may have
    hamiltonian(x) [J], an energy with dH/dt <= u' B_m' dq_m: the plant creates no energy.
    A state after a failed evaluation is nan; `raise_failure` then raises UserCodeError. gradient and structure are
    those of the robot, eq. (36). Raises ParameterError if `own` has no such method and for another integrator, and
    UserCodeError if it fails, is not finite at rest at 0, or has a memory.
    """

    in_python = True

    def __init__(self, own: Any, robot: Robot, integrator: str = INTEGRATOR) -> None:
        self.own, self.title = own, type(own).__name__
        if integrator != INTEGRATOR:
            raise ParameterError(f"integrator is {integrator!r}; expected {INTEGRATOR!r} for the plant {self.title}")
        importing.check_method(own, "derivative", ("x", "u"))
        super().__init__(robot, integrator)
        _check_at_rest(f"dx of {self.title}", self.derivative, 4 * robot.n, robot.n)

    def __repr__(self) -> str:
        return f"PythonPlant({self.title}, {self.robot!r})"

    def raise_failure(self) -> None:
        """Raise the first UserCodeError since the last call, if there is one."""
        for function in (self.dynamics, self.step_function):
            function.raise_failure()

    @cached_property
    def dynamics(self) -> PythonFunction:
        """The CasADi function (x, u) -> dx, with derivatives by differences."""
        n = self.robot.n
        return PythonFunction(
            self.title, lambda x, u: (self.own.derivative(x, u),), {"x": (4 * n,), "u": (n,)}, {"dx": (4 * n,)}
        )

    @cached_property
    def step_function(self) -> PythonFunction:
        """The CasADi function (x, u, dt) -> x_next, one call for the four evaluations of a step."""
        n = self.robot.n
        inputs = {"x": (4 * n,), "u": (n,), "dt": ()}
        return PythonFunction(self.title, self._rk4, inputs, {"x_next": (4 * n,)})

    def _rk4(self, x: Array, u: Array, dt: Array) -> tuple[Array]:
        def slope(x: Array, u: Array) -> Array:
            return checked(f"dx of {self.title}", self.own.derivative(x, u), x.shape)

        return (rk4_expression(slope, x, (u, u, u), dt),)


def own_plant(name: str, robot: Robot, options: Mapping[str, Any], integrator: str = INTEGRATOR) -> PythonPlant:
    """Return the plant of the class `module:Class`, built for the robot with these options; raises as PythonPlant."""
    return PythonPlant(importing.build(name, robot, options), robot, integrator)


class PythonLaw(StaticLaw):
    """A law of the user: u = own.effort(position, velocity, jets) (n,) [N m]; not compiled.

    position (q_l, q_m) [rad], velocity (dq_l, dq_m) [rad/s]: (2n,) each, measured. jets (5, n): q_ld .. d4q_ld. The
    arrays are read-only. `effort` is a pure function: its result depends on the arguments only.
    own may have storage(position, velocity, jets) -> V [J], 0 or more, without which V is nan; rate [1/s], the claim
    dV/dt <= -2 rate V along the closed loop with `robot`; hold_damping (n, n) [N m s/rad], the motor damping of the
    stop policy gravity_hold.
    An effort of a failed evaluation is nan; `raise_failure` then raises UserCodeError. Raises ParameterError if `own`
    has no such method, and UserCodeError if it fails, is not finite at rest at 0, or has a memory.
    """

    in_python = True

    def __init__(self, own: Any, robot: Robot) -> None:
        super().__init__(robot, SimpleNamespace(arrays=lambda _robot: {}))  # its options are in the object itself
        self.own, self.title = own, type(own).__name__
        importing.check_method(own, "effort", ARGUMENTS)
        if hasattr(own, "storage"):
            importing.check_method(own, "storage", ARGUMENTS)
        shapes = 2 * robot.n, 2 * robot.n, (JETS, robot.n)
        _check_at_rest(f"u of {self.title}", lambda *given: self.measured_command(*given)[0], *shapes)

    def __repr__(self) -> str:
        return f"PythonLaw({self.title}, {self.robot.n} joints)"

    @property
    def has_storage(self) -> bool:
        """Return whether the law has a storage V."""
        return hasattr(self.own, "storage")

    @cached_property
    def hold_damping(self) -> Array:
        """Motor damping (n, n) [N m s/rad] of the law, else sqrt(K M_m) of each joint."""
        n, own = self.robot.n, getattr(self.own, "hold_damping", None)
        if own is None:
            return np.diag(np.sqrt(np.diag(self.robot.K) * np.diag(self.robot.M_m)))
        return matrix(f"{self.title}.hold_damping", own, n, ParameterError)

    def with_gains(self, gains: Any) -> PythonLaw:
        """Raise GainsError: a law in Python has options instead of gains."""
        raise GainsError(f"gains are given to {self.title}; expected none: a law in Python has law.options.*")

    def raise_failure(self) -> None:
        """Raise the first UserCodeError since the last call, if there is one."""
        self.measured_expression.raise_failure()

    def measured_expressions(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """Raise UserCodeError: there are no expressions of a law in Python."""
        raise UserCodeError(f"{self.title} is written in Python; expected a law of expressions here")

    @cached_property
    def measured_expression(self) -> PythonFunction:
        """The law as a CasADi function, with derivatives by differences; see StaticLaw.function."""
        n = self.robot.n
        inputs = {"position": (2 * n,), "velocity": (2 * n,), "jets": (JETS, n), "gains": (0,)}
        return PythonFunction(self.title, self._evaluate, inputs, {"u": (n,), "V": ()})

    def _evaluate(self, position: Array, velocity: Array, jets: Array, _gains: Array) -> tuple[Any, Any]:
        u = self.own.effort(position, velocity, jets)
        return u, self.own.storage(position, velocity, jets) if self.has_storage else np.nan


def own_law(name: str, robot: Robot, options: Mapping[str, Any], compile: bool = False) -> StaticLaw:
    """Return the law of the class `module:Class`, built for the robot with these options.

    An object that is a StaticLaw itself is made of expressions and compiled on request. Raises as PythonLaw does.
    """
    own = importing.build(name, robot, options)
    if not isinstance(own, StaticLaw):
        return PythonLaw(own, robot)
    own.compiles = compile and not own.in_python
    return own
