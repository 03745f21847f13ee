# SPDX-License-Identifier: Apache-2.0
"""Parameters robot.* of each robot model, and what their values describe: the robot, its URDF, which are guesses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING as REQUIRED
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ParameterError
from ..model.planar_arms import PLANAR_TWO_LINK, SINGLE_LINK, URDF_ARM
from ..numerics.checks import Array, joint_names
from ..numerics.parameter_field import declared
from ..simulation.imperfections import StatedErrors
from . import robot_file
from .parameter import LIST, MATRIX, POINT, ROWS, VECTOR, Parameter, Values, named, names, read, rows, table, vector

if TYPE_CHECKING:
    from ..model.robot import Robot

JOINTS = Parameter("joints", ("joint1",), "Joint names, in the order of all other lists", shape=LIST)
FILE = Parameter("robot.file", "", "Parameter file of the robot: a path or package://; values given here override it")


MODELS: dict[str, dict[str, Any]] = {
    "single_link": SINGLE_LINK,
    "planar_two_link": PLANAR_TWO_LINK,
    "urdf": dict.fromkeys(("urdf", "joints", "stiffness", "motor_inertia"), REQUIRED)
    | {**URDF_ARM, "locked_joints": ("",), "locked_positions": (0.0,)},
}
"""Arguments of the function that builds each model, with their defaults."""
_SIZES = {"single_link": 1, "planar_two_link": 2}  # other models: as many joints as `joints` lists
MODEL = Parameter("robot.model", "single_link", "Robot model", choices=tuple(MODELS))

_DEFINITE, _SEMIDEFINITE = "symmetric positive definite", "symmetric positive semidefinite"


def _argument(name: str, unit: str, description: str, shape: str = VECTOR, constraint: str = "") -> Parameter:
    """Declare the parameter of a model's argument, which defines its default."""
    return Parameter(f"robot.{name}", 1.0, description, unit, shape=shape, constraint=constraint)


_ARGUMENTS = {  # argument of a model -> parameter
    "link_inertia": _argument(
        "link_inertia", "kg m^2", "Link inertia about the centre of mass; single_link: the joint", constraint="positive"
    ),
    "gravity_torque": _argument(
        "gravity_torque", "N m", "Mass times gravity times distance of the link's centre of mass", constraint="finite"
    ),
    "link_mass": _argument("link_mass", "kg", "Mass of each link", constraint="positive"),
    "link_length": _argument("link_length", "m", "Length of each link", constraint="positive"),
    "link_com": _argument(
        "link_com", "m", "Distance from each joint to its link's centre of mass", constraint="positive"
    ),
    "gravity": Parameter("robot.gravity", 1.0, "Acceleration of gravity", "m/s^2", minimum=0.0, maximum=1e3),
    "urdf": Parameter("robot.urdf", "", "URDF of the arm: a path, package:// or the XML text itself"),
    "joints": JOINTS,
    "stiffness": _argument("joint_stiffness", "N m/rad", "Joint stiffness K", MATRIX, _DEFINITE),
    "motor_inertia": _argument(
        "motor_inertia", "kg m^2", "Motor inertia at the link side; with gear_ratio: of the rotor", MATRIX, _DEFINITE
    ),
    "gear_ratio": _argument(
        "gear_ratio", "1", "Motor turns per link turn; 1: motor_inertia is reflected already", constraint="not 0"
    ),
    "link_damping": _argument("link_damping", "N m s/rad", "Link damping D_l", MATRIX, _SEMIDEFINITE),
    "motor_damping": _argument("motor_damping", "N m s/rad", "Motor damping D_m", MATRIX, _SEMIDEFINITE),
    "input_gain": _argument("input_gain", "1", "Input matrix B_m", MATRIX, "invertible"),
    "gravity_vector": _argument("gravity", "m/s^2", "Gravity vector in the base frame", POINT, "finite"),
    "locked_joints": _argument(
        "locked_joints",
        "",
        "Joints locked at locked_positions; '' is none; other joints not listed in `joints` are locked at 0",
        LIST,
        "positive",
    ),
    "locked_positions": _argument("locked_positions", "rad", "Positions of locked_joints", LIST, "finite"),
}
CUBIC = Parameter(
    "robot.cubic_stiffness",
    0.0,
    "Cubic stiffness k of springs that harden, K zeta + k zeta^3; with a diagonal joint_stiffness",
    "N m/rad^3",
    minimum=0.0,
    shape=VECTOR,
)
TORSION = tuple(
    Parameter(f"robot.{name}", 0.0, f"{what} of a torsion curve, a row for each point; 0: none", unit, 0.0, shape=ROWS)
    for name, what, unit in (
        ("torsion_deflection", "Deflections beyond 0, where the slope is joint_stiffness,", "rad"),
        ("torsion_torque", "Torques at torsion_deflection", "N m"),
    )
)
GUESSES = {
    name: Parameter(
        f"robot.guesses.{name}",
        0.0,
        f"Guess of robot.{name}; a value that still equals its guess is reported; 0: none",
        minimum=0.0,
        shape=VECTOR,
    )
    for name in ("joint_stiffness", "motor_inertia")
}
"""Parameters that repeat the guessed values of a robot file, so that each is reported until it is replaced."""
_DEVIATIONS = declared(StatedErrors, "robot.deviations.")
_SYMBOLS = {
    "K": "robot.joint_stiffness",
    "cubic": CUBIC.name,
    "torsion": TORSION[1].name,
    "M_m": "robot.motor_inertia",
    "D_l": "robot.link_damping",
    "D_m": "robot.motor_damping",
    "B_m": "robot.input_gain",
    **{argument: parameter.name for argument, parameter in _ARGUMENTS.items()},
}


def model_of(given: Mapping[str, object]) -> str:
    """Return the robot model among given values, else the default; raises ParameterError when unknown."""
    return str(MODEL.check(given.get(MODEL.name, MODEL.default)))


def joints_of(given: Mapping[str, object]) -> int:
    """Return the number of joints n of the robot that the given values describe; raises ParameterError."""
    model = model_of(given)
    if model in _SIZES:
        return _SIZES[model]
    if JOINTS.name not in given:
        raise ParameterError(f"parameter '{JOINTS.name}' is not given; expected the names of the {model}'s joints")
    return len(names({JOINTS.name: JOINTS.check(given[JOINTS.name])}, JOINTS.name))


def robot_parameters(given: Mapping[str, object]) -> list[Parameter]:
    """Return the parameters of the given model for its joints; defaults are those of the model's function."""
    n = joints_of(given)
    arguments = MODELS[model_of(given)].items()
    own = [_parameter(*argument).for_joints(n) for argument in arguments if argument[0] != "joints"]
    curves = (each.for_joints(n) for each in (CUBIC, *TORSION))
    return [JOINTS, FILE, MODEL, *own, *curves, *table(GUESSES, n), *table(_DEVIATIONS, n)]


def _parameter(name: str, default: Any) -> Parameter:
    """Return the parameter of a model's argument."""
    return replace(_ARGUMENTS[name], **({"required": True} if default is REQUIRED else {"default": default}))


def robot(values: Values) -> Robot:
    """Return the robot that the values of robot_parameters describe; raises ParameterError."""
    model, joints = str(values[MODEL.name]), names(values, JOINTS.name)
    n = joints_of(values)
    if len(joint_names(f"parameter '{JOINTS.name}'", joints, ParameterError)) != n:
        raise ParameterError(f"parameter '{JOINTS.name}' is {list(joints)}; expected the names of {n}, as {model} has")
    arguments = read({name: _ARGUMENTS[name] for name in MODELS[model]}, values, n)
    fallback = "robot.urdf" if model == "urdf" else "robot"
    cubic, points = vector(values, CUBIC.name, n), [rows(values, each.name, n) for each in TORSION]
    if len(points[0]) != len(points[1]):
        raise ParameterError(
            f"parameter '{TORSION[1].name}' has {len(points[1])} points; expected {len(points[0])}, as "
            f"'{TORSION[0].name}' has"
        )

    def built() -> Robot:
        if model == "urdf":
            straight = _from_urdf(**arguments)
        else:
            from ..model import closed_form_arms

            straight = getattr(closed_form_arms, model)(**arguments)
        return replace(straight, cubic=cubic, torsion=np.stack(points)) if cubic.any() or np.any(points) else straight

    return named(lambda symbol: _SYMBOLS.get(symbol, fallback), built)


def _from_urdf(
    urdf: str,
    joints: Sequence[str],
    gravity_vector: Array,
    locked_joints: Sequence[str],
    locked_positions: Sequence[float],
    **given: Any,
) -> Robot:
    """Call robot_from_urdf; '' in locked_joints stands for none, since ROS parameters have no empty lists."""
    from ..urdf.robot import robot_from_urdf

    if len(locked_joints) != len(locked_positions):
        raise ParameterError(
            f"parameter 'robot.locked_positions' has length {len(locked_positions)}; expected {len(locked_joints)}, "
            "one for each of 'robot.locked_joints'"
        )
    locked = {name: float(q) for name, q in zip(locked_joints, locked_positions, strict=True) if name}
    return robot_from_urdf(urdf, list(joints), gravity=gravity_vector, locked=locked, **given)


def stated_errors(values: Values) -> StatedErrors:
    """Return the stated errors of the robot of the values."""
    n = joints_of(values)
    return StatedErrors(n, **read(_DEVIATIONS, values, n))


def guessed_joints(values: Values) -> dict[str, tuple[str, ...]]:
    """Return the joints whose value still equals its guess, by the name of the value, where there are any.

    Of a matrix the diagonal counts.
    """
    joints, found = names(values, "joints"), {}
    n = len(joints)
    for name, parameter in GUESSES.items():
        guess, value = (np.asarray(values.get(each, np.zeros(n))) for each in (parameter.name, f"robot.{name}"))
        if value.size == n * n and n > 1:
            value = np.diag(value.reshape(n, n))
        if guess.shape == value.shape == (n,):
            found[name] = tuple(joints[j] for j in np.flatnonzero((guess > 0) & (value == guess)))
    return {name: each for name, each in found.items() if each}


def guess_sentences(values: Values) -> tuple[str, ...]:
    """Return a sentence for each kind of value that is a guess."""
    sentences = []
    for name, joints in guessed_joints(values).items():
        of = f"joint {joints[0]}" if len(joints) == 1 else f"{len(joints)} joints"
        what = f"{name.replace('_', ' ')} of {of} is a guess"
        sentences.append(f"{what}; replace it by a measured or data-sheet value in robot.{name}")
    return tuple(sentences)


def description(values: Values) -> str:
    """Return the URDF text of the robot of the values; raises ParameterError if the URDF cannot be read.

    A closed-form robot hangs along -z in the x-z plane; the URDF holds its geometry and inertia, not its gravity.
    """
    if values[MODEL.name] == "urdf":
        return str(robot_file.inlined(values)["robot.urdf"])
    from ..model.planar_arms import urdf_of_links

    lengths = vector(values, "robot.link_length", 2) if values[MODEL.name] == "planar_two_link" else (0.0,)
    bodies = robot(values).links.bodies
    return urdf_of_links(str(values[MODEL.name]), names(values, "joints"), bodies, float(lengths[-1]))


def locked_positions(values: Values) -> dict[str, float]:
    """Return the positions [rad, m] of the locked joints of the URDF by name; all other joints are locked at 0."""
    if values[MODEL.name] != "urdf":
        return {}
    positions = vector(values, "robot.locked_positions", len(names(values, "robot.locked_joints")))
    locked = zip(names(values, "robot.locked_joints"), positions, strict=True)
    return {name: float(position) for name, position in locked if name}


def robot_name(values: Values) -> str:
    """Return the name of the robot in its URDF."""
    if values[MODEL.name] != "urdf":
        return str(values[MODEL.name])
    from ..urdf.tree import parse_xml

    return str(parse_xml(description(values)).get("name", ""))
