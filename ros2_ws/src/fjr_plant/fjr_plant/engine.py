# SPDX-License-Identifier: Apache-2.0
"""Simulators in place of the plant's own integrator: what they offer, and how one is found by its name.

The state x of eq. (36) stays in struct fjr_robot between two samples, so that sensors, channels, reset and both hosts
do not know which simulator moved it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from typing import Any, Protocol

from fjr_core.config.parameter import Values
from fjr_core.config.plant import ENGINE, OWN
from fjr_core.errors import ParameterError
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant

GROUP = "fjr.engines"
PACKAGE = "fjr_engines"


class Engine(Protocol):
    """A simulator; advance, handle: the members engine_advance and engine of struct fjr_robot, in its `ffi`.

    advance may run on any thread, one at a time.
    """

    advance: Any
    handle: Any

    def use(self, imperfections: Imperfections) -> None:
        """Use other imperfections from now on; raise ParameterError for what the simulator cannot express."""

    def forget(self) -> None:
        """Forget what is kept between two steps, because the robot is back at its initial state."""


EngineKind = Callable[[NonidealPlant, Sequence[str], int, Any], Engine]
"""Constructor of a simulator: (plant, names of the joints, inner step [ns], cffi's FFI of robot.h) -> Engine.

It raises ParameterError or RobotError for a robot that the simulator cannot express.
"""


def engine_kind(values: Values) -> EngineKind | None:
    """Return the constructor of the simulator that the parameters of the plant name, None for the plant's own.

    Raises ParameterError for one that is not installed, and for what no other simulator has.
    """
    name = str(values[ENGINE.name])
    if name == OWN:
        return None
    found = {point.name: point for point in entry_points(group=GROUP)}
    if name not in found:
        raise ParameterError(f"parameter '{ENGINE.name}' is '{name}'; expected the package {PACKAGE} beside fjr_plant")
    try:
        kind: EngineKind = found[name].load()
        return kind
    except ModuleNotFoundError as error:
        raise ParameterError(
            f"parameter '{ENGINE.name}' is '{name}', but {error.name} is not installed; expected it from: "
            f"pip install {name}"
        ) from None
