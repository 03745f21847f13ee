# SPDX-License-Identifier: Apache-2.0
"""A control law of the user, written in Python without CasADi, as a StaticLaw (docs/own_law.md)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Protocol

import casadi as ca
import numpy as np

from ..errors import GainsError, ParameterError, UserCodeError
from ..files import python_class
from ..model.coordinates import Coordinates
from ..model.robot import Robot
from ..motions.reference import JETS
from ..numerics.casadi_function import dense_function
from ..numerics.checks import Array, floats
from ..numerics.python_function import PythonFunction
from .static_law import StaticLaw

ARGUMENTS = ("position", "velocity", "jets")


class OwnLaw(Protocol):
    """What a class of the user offers; its constructor takes (robot, **options), options with defaults.

    position (q_l, q_m) [rad], velocity (dq_l, dq_m) [rad/s]: (2n,) each, measured. jets (5, n): q_ld .. d4q_ld. The
    arrays are read-only. `effort` is a pure function: its result depends on the arguments only.
    Optional members: storage(position, velocity, jets) -> V [J], 0 or more. rate [1/s]: the claim
    dV/dt <= -2 rate V along the closed loop with `robot`. hold_damping (n, n) [N m s/rad]: motor damping of the stop
    policy gravity_hold.
    """

    def effort(self, position: Array, velocity: Array, jets: Array) -> Array:
        """Return the effort u (n,) [N m]."""


class _NoGains:
    """The gains of a law in Python: its options are in the object itself."""

    def arrays(self, _robot: Robot) -> dict[str, Array]:
        """Return no arrays."""
        return {}

    def __repr__(self) -> str:
        return "in Python"


class PythonLaw(StaticLaw):
    """An OwnLaw as a StaticLaw; V is nan if it has no storage. It is not compiled.

    An effort of a failed evaluation is nan; `raise_failure` then raises UserCodeError. Raises ParameterError if `own`
    is no OwnLaw, and UserCodeError if it fails or is not finite at rest at 0.
    """

    in_python = True

    def __init__(self, own: Any, robot: Robot) -> None:
        super().__init__(robot, _NoGains())
        self.own, self.title = own, type(own).__name__
        python_class.check_method(own, "effort", ARGUMENTS)
        if hasattr(own, "storage"):
            python_class.check_method(own, "storage", ARGUMENTS)
        u, _ = self.measured_command(np.zeros(2 * robot.n), np.zeros(2 * robot.n), np.zeros((JETS, robot.n)))
        if not np.isfinite(u).all():
            raise UserCodeError(f"u of {self.title} is {u.tolist()} at rest at 0; expected finite numbers")

    def __repr__(self) -> str:
        return f"PythonLaw({self.title}, {self.robot.n} joints)"

    @property
    def has_storage(self) -> bool:
        """Return whether the law has a storage V."""
        return hasattr(self.own, "storage")

    @property
    def gain_values(self) -> Array:
        """No gains (0,)."""
        return np.zeros(0)

    @cached_property
    def hold_damping(self) -> Array:
        """Motor damping (n, n) [N m s/rad] of the law, else sqrt(K M_m) of each joint."""
        n, own = self.robot.n, getattr(self.own, "hold_damping", None)
        if own is None:
            return np.diag(np.sqrt(np.diag(self.robot.K) * np.diag(self.robot.M_m)))
        array = floats(f"{self.title}.hold_damping", own, ParameterError)
        if array.shape != (n, n) or not np.isfinite(array).all():
            raise ParameterError(
                f"{self.title}.hold_damping has shape {array.shape}; expected {(n, n)}, finite numbers"
            )
        return array

    def with_gains(self, gains: Any) -> PythonLaw:
        """Raise GainsError: a law in Python has options instead of gains."""
        raise GainsError(f"gains are given to {self.title}; expected none: a law in Python has law.options.*")

    def raise_failure(self) -> None:
        """Raise the first UserCodeError since the last call, if there is one."""
        self.measured_expression.raise_failure()

    def measured_expressions(self) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """Raise UserCodeError: there are no expressions of a law in Python."""
        raise UserCodeError(f"{self.title} is written in Python; expected a law of expressions here")

    def measured_command(self, position: Any, velocity: Any, jets: Any) -> tuple[Array, float]:
        """Return u (n,) and V as StaticLaw does; raises UserCodeError."""
        found = super().measured_command(position, velocity, jets)
        self.raise_failure()
        return found

    @cached_property
    def measured_expression(self) -> PythonFunction:
        """The law as a CasADi function, with derivatives by differences; see StaticLaw.measured_function."""
        n = self.robot.n
        inputs = {"position": (2 * n,), "velocity": (2 * n,), "jets": (JETS, n), "gains": (0,)}
        return PythonFunction(self.title, self._evaluate, inputs, {"u": (n,), "V": ()})

    @cached_property
    def command_function(self) -> ca.Function:
        """The CasADi function (x, jets (n, 5)) -> u(x, x, t), V."""
        n = self.robot.n
        x, jets = ca.MX.sym("x", 4 * n), ca.MX.sym("jets", n, JETS)
        velocity = Coordinates(self.robot).to_velocities(x)
        u, V = self.measured_expression(x[: 2 * n], velocity, jets, ca.MX.zeros(0, 1))
        return dense_function("command", {"x": x, "jets": jets}, {"u": u, "V": V})

    def _evaluate(self, position: Array, velocity: Array, jets: Array, _gains: Array) -> tuple[Any, Any]:
        u = self.own.effort(position, velocity, jets)
        return u, self.own.storage(position, velocity, jets) if self.has_storage else np.nan


def own_law(name: str, robot: Robot, options: Mapping[str, Any], compile: bool = False) -> StaticLaw:
    """Return the law of the class `module:Class`, built for the robot with these options.

    An object that is a StaticLaw itself is made of expressions and compiled on request. Raises ParameterError, and
    UserCodeError if the law fails or is not finite at rest at 0.
    """
    own = python_class.build(name, robot, options)
    if not isinstance(own, StaticLaw):
        return PythonLaw(own, robot)
    own.compiles = compile and not own.in_python
    return own
