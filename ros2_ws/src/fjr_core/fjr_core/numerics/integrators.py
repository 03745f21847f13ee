# SPDX-License-Identifier: Apache-2.0
"""Integrator steps x -> x(t + dt) of dx/dt = f(x, u) with u held: Runge-Kutta 4 and implicit midpoint."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca

from .symbolic import dense_function, symbols

INNER_STEP = 2.5e-4  # s; integrator step under a hold
LONGEST_COPIED = 500  # operations of a vector field; a longer one is called by the compiled step, not copied into it
RK4 = "rk4"
INTEGRATORS = (RK4, "implicit_midpoint")

Field = Callable[[ca.SX, ca.SX], ca.SX]
"""Vector field dx/dt = f(x, u) on expressions, for example a CasADi function."""


def step(name: str, f: ca.Function, as_c: bool = False, copied: bool = True) -> ca.Function:
    """Return the step of the integrator `name` as a CasADi function (x, u, dt) -> x_next.

    as_c: in a form that supports C code generation. copied: rk4 has four copies of f; else it calls f four times.
    """
    kind = ca.SX if name == RK4 and copied else ca.MX
    s = symbols(kind, x=f.size1_in(0), u=f.size1_in(1), dt=1)
    return dense_function(name, s, {"x_next": step_expression(name, f, s["x"], (s["u"],) * 3, s["dt"], as_c)})


def step_expression(
    name: str, f: ca.Function, x: ca.MX, inputs: tuple[ca.MX, ca.MX, ca.MX], dt: ca.MX, as_c: bool = False
) -> ca.MX:
    """Return the step of the integrator `name` as an expression; inputs as in rk4_expression, as_c as in step."""
    if name == RK4:
        return rk4_expression(f, x, inputs, dt)
    return x + _midpoint_increment(f, "fast_newton" if as_c else "newton")(dt * f(x, inputs[1]), x, inputs[1], dt)


def rk4_expression(f: Field, x: ca.SX, inputs: tuple[ca.SX, ca.SX, ca.SX], dt: ca.SX) -> ca.SX:
    """Return the Runge-Kutta step as an expression; inputs: u at the start, the middle and the end of the step."""
    start, middle, end = inputs
    k1 = f(x, start)
    k2 = f(x + dt / 2 * k1, middle)
    k3 = f(x + dt / 2 * k2, middle)
    k4 = f(x + dt * k3, end)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def _midpoint_increment(f: ca.Function, solver: str) -> Callable[..., ca.MX]:
    """Return (first guess, x, u, dt) -> dx of the implicit midpoint step (order 2, symplectic): dx = dt f(x + dx/2, u).

    Newton's method solves for the increment, so that the tolerance does not depend on the size of x. A numerical
    evaluation that does not converge raises StateError. solver: CasADi's "newton", or "fast_newton", which supports C
    code generation but has no line search.
    """
    x, u, dt = symbols(ca.SX, x=f.size1_in(0), u=f.size1_in(1), dt=1).values()
    dx = ca.SX.sym("dx", x.numel())
    problem = {"x": dx, "p": ca.vertcat(x, u, dt), "g": dx - dt * f(x + dx / 2, u)}
    newton = ca.rootfinder("newton", solver, problem, {"abstol": 1e-13, "abstolStep": 1e-15, "max_iter": 50})
    return lambda guess, *given: newton(guess, ca.vertcat(*given))
