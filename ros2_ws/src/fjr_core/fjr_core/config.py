# SPDX-License-Identifier: Apache-2.0
"""Where engineers' words meet the paper's symbols: the parameters of both nodes, and what is built from them."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from . import arms
from .checks import Array
from .errors import GainsError, ParameterError, RobotError
from .gains import PAPER_GAINS, Gains
from .integrators import INTEGRATORS
from .parameters import Parameter, Value, Values
from .reference import Sine
from .robot import Robot

MODELS: dict[str, Callable[..., Robot]] = {
    "single_link": arms.single_link,
    "planar_two_link": arms.planar_two_link,
}

JOINTS = Parameter("joints", ("joint1",), "Names of the joints, in the order of all other lists")
REALTIME_PRIORITY = Parameter(
    "realtime_priority",
    0,
    "SCHED_FIFO priority of the node's process where the system allows it; 0: ordinary scheduling",
    minimum=0,
    maximum=98,
)
MODEL = Parameter("robot.model", "single_link", "Which robot this is", choices=tuple(MODELS))

_ROBOT_WORDS = {  # argument of the model -> (parameter, unit, description)
    "link_inertia": ("robot.link_inertia", "kg m^2", "Link inertia (single_link: about the joint; else the centre)"),
    "gravity_torque": ("robot.gravity_torque", "N m", "Mass times gravity times distance of the link's centre"),
    "link_mass": ("robot.link_mass", "kg", "Mass of each link"),
    "link_length": ("robot.link_length", "m", "Length of each link"),
    "link_com": ("robot.link_com", "m", "Distance from each joint to its link's centre of mass"),
    "gravity": ("robot.gravity", "m/s^2", "Acceleration of gravity"),
    "stiffness": ("robot.joint_stiffness", "N m/rad", "Joint stiffness K, n entries or n*n by rows"),
    "motor_inertia": ("robot.motor_inertia", "kg m^2", "Motor inertia M_m at the link side, n entries or n*n by rows"),
    "link_damping": ("robot.link_damping", "N m s/rad", "Link damping D_l, n entries or n*n by rows"),
    "motor_damping": ("robot.motor_damping", "N m s/rad", "Motor damping D_m, n entries or n*n by rows"),
    "input_gain": ("robot.input_gain", "1", "Input matrix B_m, n entries or n*n by rows"),
}
_MATRICES = ("stiffness", "motor_inertia", "link_damping", "motor_damping", "input_gain")
_ROBOT_CONSTRAINTS = {
    "gravity_torque": "finite",
    "stiffness": "symmetric positive definite",
    "motor_inertia": "symmetric positive definite",
    "link_damping": "symmetric positive semidefinite",
    "motor_damping": "symmetric positive semidefinite",
    "input_gain": "invertible",
}
_SYMBOLS = {
    "K": "robot.joint_stiffness",
    "M_m": "robot.motor_inertia",
    "D_l": "robot.link_damping",
    "D_m": "robot.motor_damping",
    "B_m": "robot.input_gain",
}

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


def robot_parameters(model: str) -> list[Parameter]:
    """The parameters of a robot model; their defaults are those of its function in arms."""
    signature = inspect.signature(MODELS[model])
    return [_robot_parameter(model, name, argument.default) for name, argument in signature.parameters.items()]


def _robot_parameter(model: str, argument: str, default: Any) -> Parameter:
    name, unit, description = _ROBOT_WORDS[argument]
    if argument == "gravity":
        return Parameter(name, float(default), description, unit, minimum=0.0, maximum=1e3)
    constraint = _ROBOT_CONSTRAINTS.get(argument, "positive")
    return Parameter(name, _spread(default, joints_of(model)), description, unit, constraint=constraint)


def joints_of(model: str) -> int:
    """Number of joints of a robot model."""
    return {"single_link": 1, "planar_two_link": 2}[model]


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
        REALTIME_PRIORITY,
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
        )
        for name, (unit, text) in _GAIN_WORDS.items()
    ]
    return [
        *gains,
        Parameter("reference.type", "sine", "Kind of reference", choices=("sine",)),
        Parameter("reference.amplitude", (1.0,) * n, "Amplitude of the sine", "rad"),
        Parameter("reference.frequency", (1.0,) * n, "Angular frequency of the sine", "rad/s", minimum=0.0),
        Parameter("reference.offset", (0.0,) * n, "Offset of the sine", "rad"),
        Parameter("reference.phase", (0.0,) * n, "Phase of the sine", "rad"),
        Parameter(
            "state_timeout",
            0.5,
            "A stamp that jumps back by more restarts the reference",
            "s",
            minimum=0.0,
            maximum=1e3,
        ),
        REALTIME_PRIORITY,
    ]


def robot(values: Values) -> Robot:
    """The robot that the values of JOINTS, MODEL and robot_parameters describe; raises ParameterError."""
    model = str(values["robot.model"])
    joints, n = _strings(values["joints"]), joints_of(model)
    if len(joints) != n or len(set(joints)) != n:
        raise ParameterError(f"parameter 'joints' is {list(joints)}; {model} has {n}, with different names")
    arguments: dict[str, Any] = {}
    for argument in inspect.signature(MODELS[model]).parameters:
        name = _ROBOT_WORDS[argument][0]
        if argument == "gravity":
            arguments[argument] = values[name]
        else:
            arguments[argument] = (_matrix if argument in _MATRICES else _vector)(values, name, n)
    return _named("robot", lambda: MODELS[model](**arguments))


def gains(values: Values, n: int) -> Gains:
    """The gains of the values for n joints, with their conditions checked; raises ParameterError."""
    found = Gains(**{name: _matrix(values, f"gains.{name}", n) for name in _GAIN_WORDS})
    _named("gains", lambda: found.checked(n))
    return found


def reference(values: Values, n: int) -> Sine:
    """The reference of the values for n joints; raises ParameterError."""
    return Sine(*(_vector(values, f"reference.{name}", n) for name in ("amplitude", "frequency", "offset", "phase")))


def initial_state(values: Values, robot: Robot) -> Array:
    """The plant's initial state (4n,) of the values; raises ParameterError."""
    names = [f"initial_{side}_{what}" for what in ("position", "velocity") for side in ("link", "motor")]
    return robot.state(*(_vector(values, name, robot.n) for name in names))


def _strings(value: Value) -> tuple[str, ...]:
    return tuple(str(entry) for entry in value) if isinstance(value, tuple) else (str(value),)


def _spread(value: Any, n: int) -> tuple[float, ...]:
    return tuple(float(v) for v in np.broadcast_to(value, n))


def _vector(values: Values, name: str, n: int) -> Array:
    array = np.asarray(values[name], dtype=float)
    if array.shape != (n,):
        raise ParameterError(f"parameter '{name}' has {array.size} entries; expected {n}, one per joint")
    return array


def _matrix(values: Values, name: str, n: int) -> Array:
    array = np.asarray(values[name], dtype=float)
    if array.size == n:
        return np.diag(array)
    if array.size != n * n:
        raise ParameterError(f"parameter '{name}' has {array.size} entries; expected {_entries(n)}")
    return array.reshape(n, n)


def _entries(n: int) -> str:
    return "1, for the one joint" if n == 1 else f"{n}, one per joint, or {n * n}, a matrix by rows"


def _named(group: str, build: Callable[[], Any]) -> Any:
    """Run `build`; an error about a symbol becomes one about the parameter that set it."""
    try:
        return build()
    except (RobotError, GainsError) as error:
        symbol = str(error).split(" ", 1)[0]
        name = _SYMBOLS.get(symbol, f"{group}.{symbol}" if group == "gains" else group)
        raise ParameterError(f"parameter '{name}': {error}") from None


def all_parameters(own: Callable[[int], Sequence[Parameter]], model: str) -> list[Parameter]:
    """All parameters of a node for a robot model: `own` is plant_parameters or controller_parameters."""
    return [JOINTS, MODEL, *robot_parameters(model), *own(joints_of(model))]


def model_of(given: dict[str, object]) -> str:
    """The robot model among given values (or the default); raises ParameterError when unknown."""
    return str(MODEL.check(given.get(MODEL.name, MODEL.default)))
