# SPDX-License-Identifier: Apache-2.0
"""A plant of the user, written in Python without CasADi, as a Plant (docs/own_law.md)."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from ..errors import ParameterError, UserCodeError
from ..files import python_class
from ..numerics.checks import Array
from ..numerics.python_function import PythonFunction, checked
from .port_hamiltonian import Plant
from .robot import Robot

INTEGRATOR = "rk4"
"""The only integrator of a plant in Python: an implicit one needs derivatives."""


class OwnPlant(Protocol):
    """What a class of the user offers; its constructor takes (robot, **options), options with defaults.

    x (4n,) = (q_l, q_m, p_l, p_m), with the momenta p_l = M_l(q_l) dq_l, p_m = M_m dq_m of `robot`; u (n,) [N m]. The
    arrays are read-only. `derivative` is a pure function: its result depends on the arguments only.
    Optional: hamiltonian(x) [J], an energy with dH/dt <= u' B_m' dq_m: the plant creates no energy.
    """

    def derivative(self, x: Array, u: Array) -> Array:
        """Return dx/dt (4n,)."""


class PythonPlant(Plant):
    """An OwnPlant as a Plant: dx/dt = own.derivative(x, u), with the Runge-Kutta step of order 4; not compiled.

    A state after a failed evaluation is nan; `raise_failure` then raises UserCodeError. gradient and structure are
    those of the robot, eq. (36). Raises ParameterError if `own` is no OwnPlant and for another integrator, and
    UserCodeError if it fails or is not finite at rest at 0.
    """

    in_python = True

    def __init__(self, own: Any, robot: Robot, integrator: str = INTEGRATOR) -> None:
        self.own, self.title = own, type(own).__name__
        if integrator != INTEGRATOR:
            raise ParameterError(f"integrator is {integrator!r}; expected {INTEGRATOR!r} for the plant {self.title}")
        python_class.check_method(own, "derivative", ("x", "u"))
        super().__init__(robot, integrator)
        dx = self.derivative(np.zeros(4 * robot.n), np.zeros(robot.n))
        if not np.isfinite(dx).all():
            raise UserCodeError(f"dx of {self.title} is {dx.tolist()} at rest at 0; expected finite numbers")

    def __repr__(self) -> str:
        return f"PythonPlant({self.title}, {self.robot!r})"

    def raise_failure(self) -> None:
        """Raise the first UserCodeError since the last call, if there is one."""
        for function in (self.dynamics, self.step_function):
            function.raise_failure()

    def derivative(self, x: Any, u: Any) -> Array:
        """Return dx/dt (4n,) as Plant does; raises UserCodeError."""
        found = super().derivative(x, u)
        self.raise_failure()
        return found

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
        """Return the Runge-Kutta step of order 4 with u held, as integrators.rk4_expression."""
        k1 = self._slope(x, u)
        k2 = self._slope(x + dt / 2 * k1, u)
        k3 = self._slope(x + dt / 2 * k2, u)
        k4 = self._slope(x + dt * k3, u)
        return (x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4),)

    def _slope(self, x: Array, u: Array) -> Array:
        return checked(f"dx of {self.title}", self.own.derivative(x, u), x.shape)


def own_plant(name: str, robot: Robot, options: Mapping[str, Any], integrator: str = INTEGRATOR) -> PythonPlant:
    """Return the plant of the class `module:Class`, built for the robot with these options; raises as PythonPlant."""
    return PythonPlant(python_class.build(name, robot, options), robot, integrator)
