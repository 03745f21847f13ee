# SPDX-License-Identifier: Apache-2.0
"""Where engineers' words meet the paper's symbols: the parameters of both nodes, and what is built from them.

The words for robots are in robot_parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from ..control.vdpbc.gains import PAPER_GAINS, Gains
from ..numerics.checks import Array
from ..numerics.integrators import INTEGRATORS
from ..robot.robot import Robot
from .diagnosis import verdict_parameters
from .law import law_parameters, robust, robust_parameters
from .measurement import measurement_parameters
from .nonidealities import imperfection_parameters
from .parameter import Parameter, Values, matrix, named, vector
from .plant_timing import plant_timing_parameters
from .process import process_parameters
from .reference import motion_parameters, reference, reference_parameters
from .robot import joints_of, robot, robot_parameters
from .safety import safety_parameters

__all__ = [
    "OwnParameters",
    "all_parameters",
    "controller_parameters",
    "gain_values",
    "gains",
    "initial_state",
    "names_of_others",
    "plant_parameters",
    "reference",
    "robot",
    "robust",
]

OwnParameters = Callable[[int], Sequence[Parameter]]
"""Makes a node's own parameters for n joints: plant_parameters or controller_parameters."""

_GAIN_CONSTRAINTS = {
    "Lambda_l": "condition (32): Pi_l Lambda_l + Lambda_l' Pi_l positive definite",
    "Lambda_m": "condition (41): Pi_m Lambda_m + Lambda_m' Pi_m positive definite",
    "Gamma_l": "condition (32): Pi_l Gamma_l diagonal and nonnegative",
    "Gamma_m": "condition (41): Pi_m Gamma_m diagonal and nonnegative",
}
_GAIN_WORDS = {
    "Lambda_l": ("1/s", "Linear part of phi_l, eq. (31)"),
    "Pi_l": ("N m/rad", "Position metric of the links, eq. (32)"),
    "K_ld": ("N m s/rad", "Damping injected at the links, eq. (33)"),
    "Lambda_m": ("1/s", "Linear part of phi_m, eq. (40)"),
    "Pi_m": ("N m/rad", "Position metric of the motors, eq. (41)"),
    "K_md": ("N m s/rad", "Damping injected at the motors, eq. (42)"),
    "Gamma_l": ("1/(s rad^2)", "Cubic part of phi_l"),
    "Gamma_m": ("1/(s rad^2)", "Cubic part of phi_m"),
}


def plant_parameters(n: int) -> list[Parameter]:
    """The plant node's own parameters for n joints."""
    return [
        Parameter("publish_rate", 1000.0, "Rate of /joint_states", "Hz", minimum=1.0, maximum=10000.0),
        Parameter("inner_steps", 4, "Integrator steps per published state", minimum=1, maximum=1000),
        Parameter("integrator", "rk4", "Integrator", choices=tuple(INTEGRATORS)),
        Parameter("initial_link_position", (0.5,) * n, "q_l at the start and after a reset", "rad"),
        Parameter("initial_motor_position", (0.5,) * n, "q_m at the start and after a reset", "rad"),
        Parameter("initial_link_velocity", (0.0,) * n, "dq_l at the start and after a reset", "rad/s"),
        Parameter("initial_motor_velocity", (0.0,) * n, "dq_m at the start and after a reset", "rad/s"),
        Parameter("wait_for_command", True, "Hold the initial state until the first command comes"),
        Parameter("command_timeout", 0.1, "Zero effort when commands stop for longer", "s", minimum=1e-3, maximum=1e3),
        Parameter("lockstep", False, "Advance one sample per stamped /joint_commands instead of with the clock"),
        Parameter("start_paused", False, "Publish nothing until ~/pause is called with false"),
        Parameter("publish_description", True, "Publish the robot as a URDF on robot_description, for viewers"),
        *plant_timing_parameters(),
        *imperfection_parameters(n),
        *process_parameters(),
    ]


def controller_parameters(n: int) -> list[Parameter]:
    """The controller node's own parameters for n joints."""
    gains = [
        Parameter(
            f"gains.{name}",
            _spread(getattr(PAPER_GAINS, name), n),
            f"{text}, n entries or n*n by rows",
            unit,
            constraint=_GAIN_CONSTRAINTS.get(name, "symmetric positive definite"),
            dynamic=True,
        )
        for name, (unit, text) in _GAIN_WORDS.items()
    ]
    return [
        *gains,
        *law_parameters(n),
        *robust_parameters(n),
        *reference_parameters(n),
        *measurement_parameters(n),
        *safety_parameters(n),
        *motion_parameters(n),
        Parameter("autostart", True, "Configure and activate at the start, without waiting to be asked"),
        *verdict_parameters(n),
        *process_parameters(),
    ]


def gains(values: Values, n: int) -> Gains:
    """The gains of the values for n joints, with their conditions checked; raises ParameterError."""
    found = Gains(**{name: matrix(values, f"gains.{name}", n) for name in _GAIN_WORDS})
    named(lambda symbol: f"gains.{symbol}" if symbol in _GAIN_WORDS else "gains", lambda: found.checked(n))
    return found


def gain_values(gains: Gains, n: int) -> dict[str, list[float]]:
    """Values of the parameters that give these gains: n entries where diagonal, else n*n by rows; zeros left out."""
    values = {}
    for name, array in ((name, getattr(gains.checked(n), name)) for name in _GAIN_WORDS):
        diagonal = np.array_equal(array, np.diag(np.diag(array)))
        if np.any(array):
            values[f"gains.{name}"] = [float(v) for v in (np.diag(array) if diagonal else array.ravel())]
    return values


def initial_state(values: Values, robot: Robot) -> Array:
    """The plant's initial state (4n,) of the values; raises ParameterError."""
    names = [f"initial_{side}_{what}" for what in ("position", "velocity") for side in ("link", "motor")]
    return robot.state(*(vector(values, name, robot.n) for name in names))


def all_parameters(own: OwnParameters, given: Mapping[str, object]) -> list[Parameter]:
    """All parameters of a node for the given model and joints: `own` is plant_parameters or controller_parameters."""
    return [*robot_parameters(given), *own(joints_of(given))]


@cache
def names_of_others(own: OwnParameters) -> frozenset[str]:
    """Names that parameters of the other nodes have and those of `own` do not: a shared file may hold them."""
    others = {parameter.name for node in (plant_parameters, controller_parameters) for parameter in node(1)}
    return frozenset(others - {parameter.name for parameter in own(1)})


def _spread(value: object, n: int) -> tuple[float, ...]:
    return tuple(float(v) for v in np.broadcast_to(np.asarray(value, dtype=float), n))
