# SPDX-License-Identifier: Apache-2.0
"""Simulators in place of the plant's own integrator: what they offer and take, and how one is found by its name.

The state x of eq. (36) stays in struct fjr_robot between two samples, so that sensors, channels, reset and both hosts
do not know which simulator moved it.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import entry_points
from typing import Any, ClassVar, Protocol

from fjr_core.config.parameter import Values
from fjr_core.config.plant import ENGINE, OWN, Obstacle
from fjr_core.errors import PIP, ParameterError, RobotError
from fjr_core.model.rigid_arm import Body
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array, is_diagonal
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant

GROUP = "fjr.engines"
PACKAGE = "fjr_engines"


class Engine(Protocol):
    """A simulator; advance, handle: the members engine_advance and engine of struct fjr_robot, in its `ffi`.

    advance may run on any thread, one at a time. in_python: it calls Python at each step, in lock-step only.
    """

    in_python: ClassVar[bool]
    advance: Any
    handle: Any

    def __init__(
        self, plant: NonidealPlant, joints: Sequence[str], inner_step: int, ffi: Any, obstacle: Obstacle | None
    ) -> None:
        """inner_step [ns], ffi: cffi's FFI of robot.h, obstacle: None for a simulator without contact.

        Raises ParameterError or RobotError for a robot that the simulator cannot express.
        """

    def use(self, imperfections: Imperfections) -> None:
        """Use other imperfections from now on; raise ParameterError for what the simulator cannot express."""

    def forget(self) -> None:
        """Forget what is kept between two steps, because the robot is back at its initial state."""

    def obstruct(self, present: bool, position: Array) -> None:
        """Put the obstacle to its place or take it away; raise ParameterError if the arm at q_l, q_m (2n,) is there."""


def chain(robot: Robot) -> list[tuple[int, Body]]:
    """Return the bodies from base to tip, each with its joint of the robot."""
    return [(robot.links.order.index(i), body) for i, body in enumerate(robot.links.bodies)]


def gravity_and_chain(robot: Robot, engine: str) -> tuple[Array, list[tuple[int, Body]]]:
    """Return gravity (3,) [m/s^2] and the `chain`; raise RobotError for a robot that the engine cannot express."""
    links = robot.links
    if len(links.bodies) != robot.n or links.end_effector is None:
        raise RobotError(f"the bodies of the {robot.n} links are not known; expected a serial chain, as from a URDF")
    if not is_diagonal(robot.M_m):
        raise RobotError(f"M_m is {robot.M_m.tolist()}; expected a diagonal matrix: {engine} couples no rotors")
    return links.end_effector.gravity, chain(robot)


def check_equations(plant: NonidealPlant, engine: str) -> None:
    """Raise ParameterError unless an engine can replace the integrator of a plant: eq. (36), integrated explicitly."""
    if plant.plant.in_python or plant.plant.integrator != "rk4":
        raise ParameterError(f"engine is '{engine}'; expected plant.type: flexible_joint and integrator: rk4 with it")


def engine_kind(values: Values) -> type[Engine] | None:
    """Return the class of the simulator that the parameters of the plant name, None for the plant's own.

    Raises ParameterError for one that is not installed, and in real time for one that calls Python.
    """
    name = str(values[ENGINE.name])
    if name == OWN:
        return None
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        raise ParameterError(f"parameter '{ENGINE.name}' is '{name}'; expected the package {PACKAGE} beside fjr_plant")
    try:
        kind: type[Engine] = found[name].load()
    except ModuleNotFoundError as error:
        raise ParameterError(
            f"parameter '{ENGINE.name}' is '{name}', but {error.name} is not installed; expected it from: {PIP} {name}"
        ) from None
    if kind.in_python and not values["lockstep"]:
        raise ParameterError(f"parameter '{ENGINE.name}' is '{name}' in real time; expected lockstep: true")
    return kind
