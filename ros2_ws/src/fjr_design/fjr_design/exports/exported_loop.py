# SPDX-License-Identifier: Apache-2.0
"""Closed loop to export: controller and ideal plant."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca
import numpy as np

from fjr_core.config.scenario import Scenario
from fjr_core.errors import StateError
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.numerics import integrators
from fjr_core.numerics.checks import Array
from fjr_core.numerics.symbolic import dense_function

from .step_code import Controller, controller_of


@dataclass(frozen=True, eq=False)
class Loop:
    """Sampled closed loop of a controller and a plant with its initial state x0 (4n,).

    inner_steps: steps of the plant per sample. Raises StateError if controller and plant differ in the number of
    joints, and for a plant in Python.
    """

    controller: Controller
    plant: Plant
    x0: Array
    inner_steps: int

    def __post_init__(self) -> None:
        n = [self.controller.n, self.plant.robot.n, np.size(self.x0) / 4]
        if len(set(n)) != 1:
            raise StateError(f"controller, plant and x0 have {n} joints; expected equal numbers")
        if self.plant.in_python:
            raise StateError("the plant is written in Python; expected one made of expressions, to export it to C")

    @property
    def name(self) -> str:
        """Name of the scenario."""
        return self.controller.name

    @property
    def plant_functions(self) -> dict[str, ca.Function]:
        """Return the functions of the plant by their names in C; none of them is compiled."""
        return {
            "plant_measure": self._measurement(),
            "plant_step": integrators.step_as_c(self.plant.integrator, self.plant.dynamics),
        }

    def _measurement(self) -> ca.Function:
        """Build x (4n,) -> position (q_l, q_m), velocity (dq_l, dq_m), each (2n,)."""
        n = self.plant.robot.n
        x = ca.SX.sym("x", 4 * n)
        velocity = ca.vertcat(*self.plant.robot.velocity_expressions(x))
        return dense_function("measure", {"x": x}, {"position": x[: 2 * n], "velocity": velocity}, cse=True)


def loop_of(scenario: Scenario) -> Loop:
    """Return the closed loop of a scenario with its controller and an ideal plant; raises FjrError."""
    steps = int(scenario.plant_values["inner_steps"])  # type: ignore[arg-type]
    return Loop(controller_of(scenario), scenario.plant, scenario.x0, steps)
