# SPDX-License-Identifier: Apache-2.0
"""Robots in engineers' words: the parameters of each model, and the robot that their values describe."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..robot import closed_form_arms
from ..robot.robot import Robot
from ..robot.urdf_import import robot_from_urdf
from .parameter import Parameter, Value, Values, matrix, named, names, vector

JOINTS = Parameter("joints", ("joint1",), "Names of the joints, in the order of all other lists")
FILE = Parameter("robot.file", "", "Parameter file of the robot: a path or package://; values given here win over it")


def _urdf(
    urdf: str,
    joints: Sequence[str],
    stiffness: ArrayLike,
    motor_inertia: ArrayLike,
    gear_ratio: ArrayLike = 1.0,
    link_damping: ArrayLike = 0.0,
    motor_damping: ArrayLike = 0.0,
    input_gain: ArrayLike = 1.0,
    gravity_vector: ArrayLike = (0.0, 0.0, -9.81),
    locked_joints: Sequence[str] = ("",),
    locked_positions: ArrayLike = (0.0,),
) -> Robot:
    """robot_from_urdf; a locked joint without a name stands for none, since ROS has no empty lists."""
    positions = np.asarray(locked_positions, dtype=float)
    if len(locked_joints) != len(positions):
        raise ParameterError(
            f"parameter 'robot.locked_positions' has {len(positions)} entries; expected {len(locked_joints)}, "
            "one for each of 'robot.locked_joints'"
        )
    return robot_from_urdf(
        urdf,
        list(joints),
        stiffness,
        motor_inertia,
        link_damping,
        motor_damping,
        gravity_vector,
        gear_ratio=gear_ratio,
        locked={name: float(q) for name, q in zip(locked_joints, positions, strict=True) if name},
        input_gain=input_gain,
    )


MODELS: dict[str, Callable[..., Robot]] = {
    "single_link": closed_form_arms.single_link,
    "planar_two_link": closed_form_arms.planar_two_link,
    "urdf": _urdf,
}
_SIZES = {"single_link": 1, "planar_two_link": 2}  # of the others: as many joints as are named
MODEL = Parameter("robot.model", "single_link", "Which robot this is", choices=tuple(MODELS))

Reader = Callable[[Values, str, int], Any]


def _plain(values: Values, name: str, _n: int) -> Value:
    return values[name]


def _three(values: Values, name: str, _n: int) -> Any:
    return vector(values, name, 3, "its x, y and z")


@dataclass(frozen=True)
class _Word:
    """What engineers call an argument of a model, and how it is read."""

    parameter: str
    unit: str
    description: str
    read: Reader = vector
    constraint: str = "positive"


def _matrix_word(parameter: str, unit: str, description: str, constraint: str) -> _Word:
    return _Word(parameter, unit, f"{description}, n entries or n*n by rows", matrix, constraint)


_DEFINITE, _SEMIDEFINITE = "symmetric positive definite", "symmetric positive semidefinite"
_WORDS = {  # argument of the model -> parameter
    "link_inertia": _Word(
        "robot.link_inertia", "kg m^2", "Link inertia (single_link: about the joint; else about the centre of mass)"
    ),
    "gravity_torque": _Word(
        "robot.gravity_torque", "N m", "Mass times gravity times distance of the link's centre", constraint="finite"
    ),
    "link_mass": _Word("robot.link_mass", "kg", "Mass of each link"),
    "link_length": _Word("robot.link_length", "m", "Length of each link"),
    "link_com": _Word("robot.link_com", "m", "Distance from each joint to its link's centre of mass"),
    "gravity": _Word("robot.gravity", "m/s^2", "Acceleration of gravity", _plain),
    "urdf": _Word("robot.urdf", "", "The arm as a URDF: a path, package:// or the XML text itself", _plain),
    "joints": _Word(JOINTS.name, "", JOINTS.description, lambda values, name, _n: names(values, name)),
    "stiffness": _matrix_word("robot.joint_stiffness", "N m/rad", "Joint stiffness K", _DEFINITE),
    "motor_inertia": _matrix_word(
        "robot.motor_inertia", "kg m^2", "Motor inertia at the link side, or at the motor with gear_ratio", _DEFINITE
    ),
    "gear_ratio": _Word("robot.gear_ratio", "1", "Turns of the motor for one of the link; 1: inertia is reflected"),
    "link_damping": _matrix_word("robot.link_damping", "N m s/rad", "Link damping D_l", _SEMIDEFINITE),
    "motor_damping": _matrix_word("robot.motor_damping", "N m s/rad", "Motor damping D_m", _SEMIDEFINITE),
    "input_gain": _matrix_word("robot.input_gain", "1", "Input matrix B_m", "invertible"),
    "gravity_vector": _Word("robot.gravity", "m/s^2", "Gravity in the base's frame", _three, "finite"),
    "locked_joints": _Word(
        "robot.locked_joints",
        "",
        "Joints held at locked_positions; '' is none; others that `joints` does not name are held at 0",
        lambda values, name, _n: names(values, name),
    ),
    "locked_positions": _Word("robot.locked_positions", "rad", "Positions of locked_joints", _plain, "finite"),
}
_SYMBOLS = {
    "K": "robot.joint_stiffness",
    "M_m": "robot.motor_inertia",
    "D_l": "robot.link_damping",
    "D_m": "robot.motor_damping",
    "B_m": "robot.input_gain",
    **{argument: word.parameter for argument, word in _WORDS.items()},
}


def model_of(given: Mapping[str, object]) -> str:
    """The robot model among given values (or the default); raises ParameterError when unknown."""
    return str(MODEL.check(given.get(MODEL.name, MODEL.default)))


def joints_of(given: Mapping[str, object]) -> int:
    """Number of joints n of the robot that the given values describe; raises ParameterError."""
    model = model_of(given)
    if model in _SIZES:
        return _SIZES[model]
    if JOINTS.name not in given:
        raise ParameterError(f"parameter '{JOINTS.name}' is not given; expected the names of the {model}'s joints")
    return len(names({JOINTS.name: JOINTS.check(given[JOINTS.name])}, JOINTS.name))


def robot_parameters(given: Mapping[str, object]) -> list[Parameter]:
    """The parameters that describe a robot of the given model and joints; defaults are those of its function."""
    n = joints_of(given)
    arguments = inspect.signature(MODELS[model_of(given)]).parameters.values()
    own = [_parameter(argument, n) for argument in arguments if argument.name != "joints"]
    return [JOINTS, FILE, MODEL, *own]


def _parameter(argument: inspect.Parameter, n: int) -> Parameter:
    word = _WORDS[argument.name]
    required = argument.default is inspect.Parameter.empty
    if argument.name == "urdf":
        return Parameter(word.parameter, "", word.description, word.unit, required=required)
    if argument.name == "gravity":
        return Parameter(word.parameter, float(argument.default), word.description, word.unit, 0.0, 1e3)
    default: Any = 1.0 if required else argument.default
    if word.read in (vector, matrix):
        default = np.broadcast_to(default, n)
    entries: Any = tuple(entry if isinstance(entry, str) else float(entry) for entry in default)
    return Parameter(
        word.parameter, entries, word.description, word.unit, constraint=word.constraint, required=required
    )


def robot(values: Values) -> Robot:
    """The robot that the values of robot_parameters describe; raises ParameterError."""
    model, joints = str(values[MODEL.name]), names(values, JOINTS.name)
    n = joints_of(values)
    if len(joints) != n or len(set(joints)) != n:
        raise ParameterError(f"parameter 'joints' is {list(joints)}; {model} has {n}, with different names")
    build = MODELS[model]
    arguments = {
        argument: _WORDS[argument].read(values, _WORDS[argument].parameter, n)
        for argument in inspect.signature(build).parameters
    }
    fallback = "robot.urdf" if model == "urdf" else "robot"
    return named(lambda symbol: _SYMBOLS.get(symbol, fallback), lambda: build(**arguments))
