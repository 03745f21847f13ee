# SPDX-License-Identifier: Apache-2.0
"""Define sampled-data laws: pure functions of the sample, the gains, the controller state and the last effort."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import casadi as ca
import numpy as np

from ..errors import StateError
from ..model.robot import Robot
from ..motions.reference import JETS
from ..numerics.casadi_function import dense_function
from ..numerics.checks import Array, kind_of
from ..numerics.one_line import one_line
from .static_law import StaticLaw


class SampledLaw(Protocol):
    """A law evaluated once per sample with its effort held; the reference is evaluated `lead` [s] after the stamp."""

    @property
    def robot(self) -> Robot:
        """The robot model of the law."""

    @property
    def lead(self) -> float:
        """Time [s] from the sample's stamp to the evaluation of the reference, 0 or more."""

    @property
    def gain_values(self) -> Array:
        """The argument `gains` (g,) of step_function."""

    @property
    def memory(self) -> Array:
        """Initial controller state (m,), the argument `memory` of the first step; (0,) for a static law."""

    @property
    def step_function(self) -> ca.Function:
        """The CasADi function of one sample; not compiled, so that it can be part of another function.

        (position (2n,), velocity (2n,), jets (n, 5), gains (g,), memory (m,), sent (n,), dt) -> u (n,), V, next (m,).
        position (q_l, q_m) [rad], velocity (dq_l, dq_m) [rad/s]. memory, next: controller state before and after.
        sent [N m]: effort sent at the last sample, after saturation, zero at the first sample. dt [s]: time since
        the last sample, 0 at the first.
        """


ARGUMENTS = ("position", "velocity", "jets", "gains", "memory", "sent", "dt")
"""Arguments of SampledLaw.step_function, in order."""


def step_symbols(law: SampledLaw) -> dict[str, ca.MX]:
    """Return symbols for ARGUMENTS."""
    n = law.robot.n
    sizes = ((2 * n,), (2 * n,), (n, JETS), (len(law.gain_values),), (len(law.memory),), (n,), ())
    return {name: ca.MX.sym(name, *size) for name, size in zip(ARGUMENTS, sizes, strict=True)}


@dataclass(frozen=True, eq=False)
class AsSampledLaw:
    """Adapt a static law to the interface SampledLaw."""

    law: StaticLaw
    lead: float = 0.0

    __repr__ = one_line

    @property
    def robot(self) -> Robot:
        """The robot model of the law."""
        return self.law.robot

    @property
    def gain_values(self) -> Array:
        """The argument `gains` (g,) of step_function."""
        return self.law.gain_values

    @property
    def memory(self) -> Array:
        """Empty controller state (0,)."""
        return np.zeros(0)

    @cached_property
    def step_function(self) -> ca.Function:
        """SampledLaw.step_function; it does not depend on memory, sent and dt."""
        s = step_symbols(self)
        u, V = self.law.measured_expression(s["position"], s["velocity"], s["jets"], s["gains"])
        return dense_function("sampled_law", s, {"u": u, "V": V, "next": s["memory"]})


def check_law(law: object) -> None:
    """Raise StateError unless `law` is a StaticLaw or has the members of a SampledLaw; a function has not."""
    if isinstance(law, StaticLaw) or all(hasattr(law, name) for name in ("robot", "step_function", "gain_values")):
        return
    raise StateError(
        f"law is {kind_of(law)}; expected a law of fjr_core, e.g. fjr.TrackingLaw(robot, gains), "
        "fjr.PythonLaw(own, robot), or an object with the members of control.sampled_law.SampledLaw"
    )


def raise_failure(law: StaticLaw | SampledLaw) -> None:
    """Raise the error of an evaluation since the last call; only a law in Python fails (StaticLaw.raise_failure)."""
    static = getattr(law, "law", law)
    if isinstance(static, StaticLaw):
        static.raise_failure()


def in_python(law: StaticLaw | SampledLaw) -> bool:
    """Return whether the law is evaluated in Python, so that nothing that contains it can be compiled."""
    return bool(getattr(getattr(law, "law", law), "in_python", False))
