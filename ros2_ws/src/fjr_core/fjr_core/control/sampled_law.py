# SPDX-License-Identifier: Apache-2.0
"""What a control law is once it runs: a pure function of a sample, the gains, a memory and the effort sent before."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np

from ..numerics.casadi_function import bind, dense_function
from ..numerics.checks import Array
from ..robot.robot import Robot
from ..trajectories.reference import JETS


class MeasuredLaw(Protocol):
    """A static law u(x, x, t) of what is measured, with a storage V, nan where it has none."""

    @property
    def robot(self) -> Robot:
        """The robot that the law believes in."""

    @property
    def gain_values(self) -> Array:
        """The argument `gains` (g,) of measured_expression."""

    @property
    def measured_expression(self) -> ca.Function:
        """(position (2n,), velocity (2n,), jets (n, 5), gains (g,)) -> u (n,), V; never machine code."""


class SampledLaw(Protocol):
    """A law evaluated once a sample, its effort held; `lead` [s] after the stamp is the reference taken."""

    @property
    def robot(self) -> Robot:
        """The robot that the law believes in."""

    @property
    def lead(self) -> float:
        """How long after the sample's stamp the reference is taken [s], 0 or more."""

    @property
    def gain_values(self) -> Array:
        """The argument `gains` (g,) of step_function."""

    @property
    def memory(self) -> Array:
        """The argument `memory` (m,) of the first step; (0,) for a law without one."""

    @property
    def step_function(self) -> ca.Function:
        """The CasADi function of one sample; never machine code, so that it may be part of another: see compiled.

        (position (2n,), velocity (2n,), jets (n, 5), gains (g,), memory (m,), sent (n,), dt) -> u (n,), V, next (m,).
        position (q_l, q_m) [rad], velocity (dq_l, dq_m) [rad/s]; sent [N m]: the effort that was sent for the last
        sample (what its u became under limits), zeros at the first; without a delay it acted since then. dt [s]: time
        since the last sample, 0 at the first.
        """


@dataclass(frozen=True, eq=False)
class Static:
    """A law without memory as a SampledLaw."""

    law: MeasuredLaw
    lead: float = 0.0

    @property
    def robot(self) -> Robot:
        """The robot that the law believes in."""
        return self.law.robot

    @property
    def gain_values(self) -> Array:
        """Gains (g,) as step_function takes them."""
        return self.law.gain_values

    @property
    def memory(self) -> Array:
        """Nothing, (0,)."""
        return np.zeros(0)

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function, which reads neither memory, nor sent, nor dt."""
        n, g = self.robot.n, len(self.gain_values)
        sizes = {"position": 2 * n, "velocity": 2 * n, "gains": g, "memory": 0, "sent": n, "dt": 1}
        s = {name: ca.MX.sym(name, rows) for name, rows in sizes.items()}
        jets = ca.MX.sym("jets", n, JETS)
        u, V = self.law.measured_expression(s["position"], s["velocity"], jets, s["gains"])
        inputs = {name: jets if name == "jets" else s[name] for name in ARGUMENTS}
        return dense_function("sampled_law", inputs, {"u": u, "V": V, "next": s["memory"]})


@dataclass(frozen=True, eq=False)
class BoundStep:
    """One sample of a law from and into its own arrays: `evaluate` writes u (n,), V (1,) and next (m,).

    It reads the arrays given, memory (m,), sent (n,) and dt (1,); `keep` makes next the memory.
    """

    evaluate: Callable[[], None]
    initial: Array
    memory: Array
    sent: Array
    dt: Array
    u: Array
    V: Array
    next: Array

    def keep(self) -> None:
        """The sample counts: the next one goes on from here."""
        np.copyto(self.memory, self.next)

    def forget(self) -> None:
        """The next sample is the first."""
        np.copyto(self.memory, self.initial)
        self.dt[0] = 0.0


def bound_step(
    law: SampledLaw, position: Array, velocity: Array, jets: Array, function: ca.Function | None = None
) -> BoundStep:
    """A law bound to contiguous arrays (2n,), (2n,), (5, n); function: its step_function as machine code."""
    n, initial = law.robot.n, law.memory
    memory, sent, dt, u, V, after = initial.copy(), np.zeros(n), np.zeros(1), np.zeros(n), np.zeros(1), initial.copy()
    arguments = (position, velocity, jets, law.gain_values, memory, sent, dt)
    evaluate = bind(function or law.step_function, arguments, (u, V, after))
    return BoundStep(evaluate, initial, memory, sent, dt, u, V, after)


ARGUMENTS = ("position", "velocity", "jets", "gains", "memory", "sent", "dt")
"""The arguments of SampledLaw.step_function."""
