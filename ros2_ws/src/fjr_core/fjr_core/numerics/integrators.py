# SPDX-License-Identifier: Apache-2.0
"""Integrator steps x -> x(t + dt) of dx/dt = f(x, u) with u held: Runge-Kutta 4 and implicit midpoint."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from ..errors import ParameterError

INNER_STEP = 2.5e-4  # s; integrator step under a hold
LONGEST_COPIED = 500  # operations of a vector field; a longer one is called by the compiled step, not copied into it

Field = Callable[[ca.SX, ca.SX], ca.SX]
"""Vector field dx/dt = f(x, u) on expressions, for example a CasADi function."""


def rk4(f: ca.Function, kind: type = ca.SX) -> ca.Function:
    """Return the classical Runge-Kutta step of order 4 as a CasADi function (x, u, dt) -> x_next.

    kind: ca.SX makes one function with four copies of f, ca.MX one that calls f four times.
    """
    x, u, dt = _symbols(f, kind)
    return _step("rk4", x, u, dt, rk4_expression(f, x, (u, u, u), dt))


def rk4_expression(f: Field, x: ca.SX, inputs: tuple[ca.SX, ca.SX, ca.SX], dt: ca.SX) -> ca.SX:
    """Return the Runge-Kutta step as an expression; inputs: u at the start, the middle and the end of the step."""
    start, middle, end = inputs
    k1 = f(x, start)
    k2 = f(x + dt / 2 * k1, middle)
    k3 = f(x + dt / 2 * k2, middle)
    k4 = f(x + dt * k3, end)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def implicit_midpoint(f: ca.Function, solver: str = "newton") -> ca.Function:
    """Return the implicit midpoint step (order 2, symplectic) as a CasADi function (x, u, dt) -> x_next.

    Solves dx = dt f(x + dx/2, u) for the increment dx by Newton's method; the tolerance applies to the increment and
    does not depend on the size of x. A numerical evaluation that does not converge raises StateError.
    solver: CasADi's "newton", or "fast_newton", which supports C code generation but has no line search.
    """
    x, u, dt = _symbols(f, ca.SX)
    dx = ca.SX.sym("dx", x.numel())
    problem = {"x": dx, "p": ca.vertcat(x, u, dt), "g": dx - dt * f(x + dx / 2, u)}
    newton = ca.rootfinder("newton", solver, problem, {"abstol": 1e-13, "abstolStep": 1e-15, "max_iter": 50})
    x, u, dt = _symbols(f, ca.MX)
    return _step("implicit_midpoint", x, u, dt, x + newton(dt * f(x, u), ca.vertcat(x, u, dt)))


INTEGRATORS: dict[str, Callable[[ca.Function], ca.Function]] = {"rk4": rk4, "implicit_midpoint": implicit_midpoint}


def step(name: str, f: ca.Function, as_c: bool = False) -> ca.Function:
    """Return the step of the integrator `name` for dx/dt = f(x, u); raise ParameterError if unknown.

    as_c: in a form that supports C code generation.
    """
    if name not in INTEGRATORS:
        raise ParameterError(f"integrator is {name!r}; expected one of {', '.join(INTEGRATORS)}")
    return implicit_midpoint(f, "fast_newton") if as_c and name == "implicit_midpoint" else INTEGRATORS[name](f)


def step_to_compile(name: str, f: ca.Function) -> ca.Function:
    """Return the step of the integrator `name` with little code: rk4 calls a long f and copies a short one."""
    return rk4(f, ca.MX) if name == "rk4" and f.n_instructions() > LONGEST_COPIED else step(name, f)


def step_expression(
    name: str, f: ca.Function, x: ca.MX, inputs: tuple[ca.MX, ca.MX, ca.MX], dt: ca.MX, as_c: bool = False
) -> ca.MX:
    """Return the step of the integrator `name` as an expression; inputs as in rk4_expression, as_c as in step."""
    return rk4_expression(f, x, inputs, dt) if name == "rk4" else step(name, f, as_c)(x, inputs[1], dt)


def _symbols(f: ca.Function, kind: type) -> tuple[ca.SX, ca.SX, ca.SX]:
    return kind.sym("x", f.size1_in(0)), kind.sym("u", f.size1_in(1)), kind.sym("dt")  # type: ignore[attr-defined]


def _step(name: str, x: ca.SX, u: ca.SX, dt: ca.SX, x_next: ca.SX) -> ca.Function:
    return ca.Function(name, [x, u, dt], [ca.densify(x_next)], ["x", "u", "dt"], ["x_next"])
