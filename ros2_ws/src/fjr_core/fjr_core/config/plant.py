# SPDX-License-Identifier: Apache-2.0
"""Parameters of the simulated robot: sampling, integration, initial state, lock-step and ~/advance."""

from __future__ import annotations

from ..errors import FjrError, ParameterError
from ..extensions.python_code import own_plant
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot
from ..numerics.checks import Array
from ..numerics.integrators import INTEGRATORS
from .nonidealities import imperfection_parameters
from .parameter import VECTOR, Parameter, Values, read
from .process import process_parameters
from .user_options import options

FLEXIBLE_JOINT = "flexible_joint"
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
_OWN = (
    TYPE,
    Parameter("publish_rate", 1000.0, "Rate of /joint_states", "Hz", minimum=1.0, maximum=10000.0),
    Parameter("inner_steps", 4, "Integrator steps per published state", minimum=1, maximum=1000),
    Parameter("integrator", "rk4", "Integrator", choices=tuple(INTEGRATORS)),
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
    return [*own, *imperfection_parameters(n), *process_parameters()]


def plant(values: Values, robot: Robot) -> Plant:
    """Return the simulated robot of the values; raises ParameterError."""
    name, integrator = str(values[TYPE.name]), str(values["integrator"])
    if name == FLEXIBLE_JOINT:
        return Plant(robot, integrator, compile=bool(values["compile"]))
    try:
        return own_plant(name, robot, options(TYPE, values), integrator)
    except FjrError as error:
        raise ParameterError(f"parameter '{TYPE.name}' is {name!r}: {error}") from None


def initial_state(values: Values, robot: Robot) -> Array:
    """Return the plant's initial state (4n,) of the values; raises ParameterError."""
    return robot.state(**read(_INITIAL_STATE, values, robot.n))
