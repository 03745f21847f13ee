# SPDX-License-Identifier: Apache-2.0
"""What a control law is once it runs: a pure function of a sample, the gains, a memory and the effort sent before."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np

from .checks import Array
from .numeric import dense_function
from .reference import JETS
from .robot import Robot


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
        position (q_l, q_m) [rad], velocity (dq_l, dq_m) [rad/s]; sent [N m]: the effort that acted since the last
        sample, zeros at the first; dt [s]: time since the last sample, 0 at the first.
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


ARGUMENTS = ("position", "velocity", "jets", "gains", "memory", "sent", "dt")
"""The arguments of SampledLaw.step_function."""
