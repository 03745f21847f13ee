# SPDX-License-Identifier: Apache-2.0
"""The seven-joint arm of the scenario `arm7`, as this project's and as Pinocchio's model."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from fjr_core import Plant, TrackingLaw
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.model.robot import Robot
from fjr_core.numerics import symbolic
from fjr_core.numerics.checks import Array

ROOT = Path(__file__).resolve().parents[1]
BRINGUP = ROOT / "ros2_ws" / "src" / "fjr_bringup"
SCENARIO = BRINGUP / "scenarios" / "arm7.yaml"
URDF = BRINGUP / "robots" / "arm7.urdf"


@dataclass(frozen=True)
class Arm:
    """The arm of a scenario with compiled law and plant; model: Pinocchio's, of the same URDF."""

    scenario: Scenario
    model: Any

    @property
    def robot(self) -> Robot:
        """The flexible-joint robot."""
        return self.scenario.robot

    @cached_property
    def law(self) -> TrackingLaw:
        """The compiled law of the scenario."""
        return TrackingLaw(self.robot, self.scenario.gains, compile=True)

    @cached_property
    def plant(self) -> Plant:
        """The compiled plant of the scenario."""
        return Plant(self.robot, "rk4", compile=True)

    @cached_property
    def forward_dynamics(self) -> ca.Function:
        """Rigid forward dynamics (q, dq, tau) -> ddq = M^-1 (tau - C dq - grad P)."""
        links = self.robot.links
        q, dq, tau = (ca.SX.sym(name, links.n) for name in ("q", "dq", "tau"))
        ddq = symbolic.solve(links.M_l(q), tau - links.C(q, dq, dq) - links.grad_P_l(q))
        return ca.Function("forward_dynamics", [q, dq, tau], [ca.densify(ddq)], {"cse": True})


@cache
def arm7() -> Arm:
    """Return the arm of the scenario `arm7`; its joints are those of its URDF, in the same order."""
    return Arm(load_scenario(SCENARIO), pin.buildModelFromUrdf(str(URDF)))


def random_motion(n: int, seed: int) -> tuple[Array, Array, Array]:
    """Return random positions [rad], velocities [rad/s] and torques [N m], each (n,)."""
    random = np.random.default_rng(seed)
    return random.uniform(-1.5, 1.5, n), random.uniform(-1.0, 1.0, n), random.uniform(-20.0, 20.0, n)
