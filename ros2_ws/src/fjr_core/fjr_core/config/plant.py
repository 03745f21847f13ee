# SPDX-License-Identifier: Apache-2.0
"""Parameters of the plant node: sampling, integration, initial state, lock-step, obstacle.* and imperfections.*.

The obstacle is what the arm may touch, at rest in the frame of its base. The imperfections, of which every one is off
by default, are those of the robot, its sensors and its message channels (docs/measurements.md).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FjrError, ParameterError, prefixed
from ..files.text_file import is_xml
from ..numerics.checks import Array
from ..numerics.parameter_field import POINT, declared, parameter_field
from ..simulation.imperfections import ChannelErrors, Imperfections, SensorErrors
from .parameter import VECTOR, Parameter, Values, number, options, read, table
from .process import process_parameters
from .robot import description, locked_positions

if TYPE_CHECKING:
    from ..model.port_hamiltonian import Plant
    from ..model.robot import Robot

FLEXIBLE_JOINT = "flexible_joint"
INTEGRATORS = ("rk4", "implicit_midpoint")
"""Those of numerics.integrators."""
ENGINES = ("mujoco", "drake")
"""Simulators of others, of the package fjr_engines."""
_INITIAL_STATE = {
    "q_l": Parameter("initial_link_position", 0.5, "q_l at the start and after a reset", "rad", shape=VECTOR),
    "q_m": Parameter("initial_motor_position", 0.5, "q_m at the start and after a reset", "rad", shape=VECTOR),
    "dq_l": Parameter("initial_link_velocity", 0.0, "dq_l at the start and after a reset", "rad/s", shape=VECTOR),
    "dq_m": Parameter("initial_motor_velocity", 0.0, "dq_m at the start and after a reset", "rad/s", shape=VECTOR),
}
TYPE = Parameter(
    "plant.type",
    FLEXIBLE_JOINT,
    "Equations of motion: eq. (36) with robot.*, or a class module:Class with the options plant.options.*",
    choices=(FLEXIBLE_JOINT,),
    options="plant.options.",
)
OWN = "own"
ENGINE = Parameter("engine", OWN, "Simulator that moves the robot (docs/tables/engines.md)", choices=(OWN, *ENGINES))
_OWN = (
    TYPE,
    Parameter("publish_rate", 1000.0, "Rate of /joint_states", "Hz", minimum=1.0, maximum=10000.0),
    Parameter("inner_steps", 4, "Integrator steps per published state", minimum=1, maximum=1000),
    Parameter("integrator", "rk4", "Integrator", choices=INTEGRATORS),
    ENGINE,
    *_INITIAL_STATE.values(),
    Parameter("wait_for_command", True, "Hold the initial state until the first command arrives"),
    Parameter(
        "command_timeout",
        0.1,
        "Longest time without a command before the effort becomes zero",
        "s",
        minimum=1e-3,
        maximum=1e3,
    ),
    Parameter("lockstep", False, "Advance one sample per stamped /joint_commands instead of with the clock"),
    Parameter("start_paused", False, "Publish nothing until ~/pause is called with false"),
    Parameter("publish_description", True, "Publish the robot as a URDF on robot_description, for viewers"),
    Parameter(
        "lockstep_timeout",
        10.0,
        "In lock-step: exit if a state is not answered for longer, after the first command; 0: wait forever",
        "s",
        minimum=0.0,
        maximum=1e6,
    ),
    Parameter(
        "restart_silence",
        1.0,
        "Time without states after a reset or a pause, longer than the controller's state_timeout; not in lock-step",
        "s",
        minimum=0.0,
        maximum=1e3,
    ),
    Parameter(
        "advance_samples",
        1,
        "Samples by which ~/advance moves a paused robot",
        minimum=1,
        maximum=1_000_000,
        dynamic=True,
    ),
)


def plant_parameters(n: int) -> list[Parameter]:
    """Return the plant node's own parameters for n joints."""
    own = [parameter.for_joints(n) for parameter in _OWN]
    return [*own, *table(_OBSTACLE, 0), *imperfection_parameters(n), *process_parameters()]


def plant(values: Values, robot: Robot) -> Plant:
    """Return the simulated robot of the values; raises ParameterError."""
    name, integrator = str(values[TYPE.name]), str(values["integrator"])
    if name == FLEXIBLE_JOINT:
        from ..model.port_hamiltonian import Plant

        return Plant(robot, integrator, compile=bool(values["compile"]))
    from ..extensions.python_code import own_plant

    with prefixed(f"parameter '{TYPE.name}' is {name!r}: ", FjrError):
        return own_plant(name, robot, options(TYPE, values), integrator)


def initial_state(values: Values, robot: Robot) -> Array:
    """Return the plant's initial state (4n,) of the values; raises ParameterError."""
    return robot.state(**read(_INITIAL_STATE, values, robot.n))


NONE, BOX, WALL, TABLE, MJCF = "none", "box", "wall", "table", "mjcf"
UP = (0.0, 0.0, 1.0)
ENGINE_OF_CONTACT = "mujoco"
"""The engine that has contact."""


@dataclass(frozen=True)
class Obstacle:
    """A body that the arm may touch; the fields declare units and descriptions.

    A box is aligned with the base. Wall and table are plates: `position` is the centre of the face out of which
    `normal` points, which is up for a table; the last entry of `size` is the thickness behind it. mjcf: path, or text.
    urdf: text with the shapes of the arm; locked: positions [rad, m] of its joints that do not move.
    """

    kind: str = parameter_field(
        NONE, "What the arm may touch; expects engine: mujoco", name="type", choices=(NONE, BOX, WALL, TABLE, MJCF)
    )
    position: Array = parameter_field(
        0.0, "Centre of the box, or of the face of wall or table, in the base frame", "m", shape=POINT
    )
    size: Array = parameter_field(
        (1.0, 1.0, 0.1), "Lengths of the edges, of wall and table the thickness last", "m", minimum=1e-3, shape=POINT
    )
    normal: Array = parameter_field(UP, "Direction out of the face of a wall", shape=POINT, constraint="not zero")
    mjcf: str = parameter_field("", "MJCF of bodies that do not move: a path, package:// or the XML text itself")
    present: bool = parameter_field(True, "Whether the obstacle is there", dynamic=True)
    urdf: str = ""
    locked: Mapping[str, float] = field(default_factory=dict)


_OBSTACLE = declared(Obstacle, "obstacle.")
OBSTACLE_TYPE, OBSTACLE_PRESENT = (_OBSTACLE[each].name for each in ("kind", "present"))


def obstacle(values: Values) -> Obstacle | None:
    """Return the obstacle of the plant's values, None for none; raise ParameterError."""
    found = Obstacle(**read(_OBSTACLE, values, 0), locked=locked_positions(values))
    if found.kind == NONE:
        return None
    if values["engine"] != ENGINE_OF_CONTACT:
        raise ParameterError(
            f"parameter '{OBSTACLE_TYPE}' is '{found.kind}' with engine '{values['engine']}'; "
            f"expected engine: {ENGINE_OF_CONTACT}, the one that has contact"
        )
    if not np.linalg.norm(found.normal) > 0:
        raise ParameterError(f"parameter '{_OBSTACLE['normal'].name}' is {found.normal.tolist()}; expected a direction")
    if found.kind == MJCF and not (is_xml(found.mjcf) or Path(found.mjcf).is_file()):
        raise ParameterError(f"parameter '{_OBSTACLE['mjcf'].name}' is '{found.mjcf}'; expected a file, or XML text")
    return replace(found, urdf=description(values))


_GROUP = "imperfections."
_DYNAMICS = declared(Imperfections, _GROUP)
_SENSORS = declared(SensorErrors, _GROUP)
PERIOD_JITTER = Parameter(
    f"{_GROUP}period_jitter", 0.0, "Largest delay of a sample, below the sample period", "s", 0.0, 1.0, dynamic=True
)
SEED = Parameter(f"{_GROUP}seed", 0, "Seed of noise, jitter and message loss; a reset restarts them", "", 0, 2**31)


def _channel(side: str) -> dict[str, Parameter]:
    """Return the declarations of one channel, "state" or "command"; both share the one of `in_order`."""
    found = {}
    for argument, each in declared(ChannelErrors).items():
        prefix = _GROUP if argument == "in_order" else f"{_GROUP}{side}_"
        found[argument] = replace(each, name=prefix + each.name, description=each.description.format(f"{side}s"))
    return found


_STATES, _COMMANDS = _channel("state"), _channel("command")


def imperfection_parameters(n: int) -> list[Parameter]:
    """Return the parameters imperfections.* for n joints."""
    channels = {each.name: each for side in (_STATES, _COMMANDS) for each in side.values()}
    return [*table(_DYNAMICS, n), *table(_SENSORS, n), *table(channels, n), PERIOD_JITTER, SEED]


def imperfections(values: Values, n: int) -> Imperfections:
    """Return the imperfections of the dynamics of n joints; raises ParameterError."""
    return Imperfections(n, **read(_DYNAMICS, values, n))


def sensor_errors(values: Values, n: int) -> SensorErrors:
    """Return the sensor errors of n joints; raises ParameterError."""
    return SensorErrors(n, **read(_SENSORS, values, n))


def channel_errors(values: Values) -> tuple[ChannelErrors, ChannelErrors]:
    """Return the channel errors of states and of commands; raises ParameterError."""
    return ChannelErrors(**read(_STATES, values, 0)), ChannelErrors(**read(_COMMANDS, values, 0))


def period_jitter(values: Values) -> float:
    """Return the largest delay of a sample [s]; raises ParameterError unless it is below the sample period."""
    jitter, period = number(values, PERIOD_JITTER.name), 1 / number(values, "publish_rate")
    if jitter >= period:
        raise ParameterError(
            f"parameter '{PERIOD_JITTER.name}' is {jitter} s; expected less than the period, {period:g} s"
        )
    return jitter


def random_seed(values: Values) -> int:
    """Return the seed of noise, jitter and message loss."""
    return int(number(values, SEED.name))
