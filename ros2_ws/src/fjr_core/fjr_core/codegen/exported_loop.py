# SPDX-License-Identifier: Apache-2.0
"""Closed loop to export, with its parts as CasADi functions from which C can be generated."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from ..config.scenario import Scenario
from ..control.sampled_law import SampledLaw, in_python
from ..errors import StateError
from ..numerics import integrators
from ..numerics.casadi_function import dense_function
from ..numerics.checks import Array
from ..robot.port_hamiltonian import Plant
from ..trajectories.reference import Reference
from .reference_function import jets_function


@dataclass(frozen=True, eq=False)
class Loop:
    """Sampled closed loop: names of n joints, initial state x0 (4n,) of the plant, times in seconds.

    Raises StateError if law, reference, plant and names differ in the number of joints, and for a law or plant in
    Python.
    """

    name: str
    joints: tuple[str, ...]
    law: SampledLaw
    reference: Reference
    plant: Plant
    x0: Array
    sample_period: float
    inner_steps: int

    def __post_init__(self) -> None:
        n = [self.law.robot.n, self.reference.n, self.plant.robot.n, len(self.joints), np.size(self.x0) / 4]
        if len(set(n)) != 1:
            raise StateError(f"law, reference, plant, names and x0 have {n} joints; expected equal numbers")
        for what, there in (("law", in_python(self.law)), ("plant", self.plant.in_python)):
            if there:
                raise StateError(
                    f"the {what} is written in Python; expected one made of expressions, to export it to C"
                )

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    @property
    def inner_step(self) -> float:
        """Step of the integrator [s]."""
        return self.sample_period / self.inner_steps

    @cached_property
    def functions(self) -> dict[str, ca.Function]:
        """Return the functions by their names in C; none of them is compiled."""
        return {
            "reference": jets_function(self.reference),
            "law": self.law.step_function,
            "plant_measure": self._measurement(),
            "plant_step": integrators.step_as_c(self.plant.integrator, self.plant.dynamics),
        }

    def _measurement(self) -> ca.Function:
        """Build x (4n,) -> position (q_l, q_m), velocity (dq_l, dq_m), each (2n,)."""
        x = ca.SX.sym("x", 4 * self.n)
        velocity = ca.vertcat(*self.plant.robot.velocity_expressions(x))
        return dense_function("measure", {"x": x}, {"position": x[: 2 * self.n], "velocity": velocity}, cse=True)


def loop_of(scenario: Scenario) -> Loop:
    """Return the closed loop of a scenario with the options of the law and an ideal plant."""
    steps = int(scenario.plant_values["inner_steps"])  # type: ignore[arg-type]
    s = scenario
    return Loop(s.name, s.joints, s.sampled_law, s.reference, s.plant, s.x0, s.sample_period, steps)
