# SPDX-License-Identifier: Apache-2.0
"""Parameters that can be identified: units, prior values, and the coordinates z in which is optimised.

A parameter is one line of KINDS; the equations that it enters are in `elastic_arm` and `filtered_fit`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError
from fjr_core.model.robot import Robot
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import LINEAR, LOG, NONNEGATIVE, SQUARE, natural


@dataclass(frozen=True)
class Kind:
    """Unit of a parameter of a revolute joint, its coordinate, what reveals it, and the width of its prior.

    revealed_by: what is missing in records that do not determine it. width: None: of the efforts and velocities of the
    records (`Estimation.widths`).
    """

    unit: str
    coordinate: str
    revealed_by: str
    width: float | None = None


REVERSALS = "needs reversals of the {0}; move to and fro, slowly, too"
NEAR_ZERO = "needs motion at velocities near zero; reverse slowly"
LOADS = "needs motion to and fro under small and large loads"
POSES = "needs poses in which its weight pulls elsewhere"
RANGE = "needs a larger range of the joint"
TORQUES = "the torques of the motion do not depend on it enough; use other poses, faster motion"
STRIBECK, USUAL_STRIBECK = "stribeck_velocity", 0.1  # rad/s
PAYLOAD = ("payload_mass", "payload_position_x", "payload_position_y", "payload_position_z")
POSITION_TORQUE = ("position_torque_sin1", "position_torque_cos1", "position_torque_sin2", "position_torque_cos2")
LOG_CHOLESKY = ("alpha", "d1", "d2", "d3", "s12", "s23", "s13", "t1", "t2", "t3")
PSEUDO_INERTIA = tuple(f"pseudo_inertia_{name}" for name in LOG_CHOLESKY)  # elastic_arm.corrected_chain
KINDS = {
    "joint_stiffness": Kind(
        "N m/rad", LOG, "the spring deflects too little against the noise; use larger loads or accelerations", 0.7
    ),
    "cubic_stiffness": Kind(
        "N m/rad^3",
        NONNEGATIVE,
        "the spring deflects too little for its curve to show; use larger loads or accelerations",
    ),
    "motor_inertia": Kind("kg m^2", LOG, "the motor accelerates too little; use faster reversals", 0.5),
    "link_damping": Kind(
        "N m s/rad",
        NONNEGATIVE,
        "needs link velocities with a known link skew; use faster motion that excites the resonance",
    ),
    "motor_damping": Kind("N m s/rad", NONNEGATIVE, "needs a range of velocities; move at several speeds"),
    "link_coulomb_friction": Kind("N m", NONNEGATIVE, REVERSALS.format("link")),
    "motor_coulomb_friction": Kind("N m", NONNEGATIVE, REVERSALS.format("motor")),
    "link_static_friction": Kind("N m", NONNEGATIVE, NEAR_ZERO),
    "motor_static_friction": Kind("N m", NONNEGATIVE, NEAR_ZERO),
    STRIBECK: Kind("rad/s", LOG, NEAR_ZERO, 1.0),
    "link_load_friction": Kind("", NONNEGATIVE, LOADS, 0.1),
    "motor_load_friction": Kind("", NONNEGATIVE, LOADS, 0.1),
    "friction_smoothing_velocity": Kind("rad/s", LOG, "needs friction and reversals; reverse slowly", 2.0),
    "offset": Kind(
        "rad", LINEAR, "needs spring torques of both signs, or a known one; change the load of the joint", 0.02
    ),
    "payload_mass": Kind("kg", NONNEGATIVE, "the payload changes the torques too little; move the joints that lift it"),
    **dict.fromkeys(PAYLOAD[1:], Kind("m", LINEAR, POSES, 0.2)),
    **dict.fromkeys(POSITION_TORQUE, Kind("N m", LINEAR, RANGE)),
    **dict.fromkeys(PSEUDO_INERTIA, Kind("", LINEAR, TORQUES, 0.1)),
    "effort_delay": Kind("s", LINEAR, "needs efforts that change quickly; use faster reversals", 3e-3),
    "actuator_lag": Kind("s", SQUARE, "needs efforts that change quickly; use faster reversals", 1e-5),
    "link_skew": Kind("s", LINEAR, "needs velocities that change; move faster", 3e-3),
    "torque_skew": Kind("s", LINEAR, "needs spring torques that change quickly; use faster reversals", 3e-3),
    "gear_ratio_error": Kind("", LINEAR, "needs a large range, and torques that do not grow with the position", 5e-3),
}
OF_LINKS = (*PAYLOAD, *PSEUDO_INERTIA)  # parameters that the torques of the rigid links depend on
SMOOTHING = "friction_smoothing_velocity"  # v_0, over which friction of both sides turns over: level tanh(v / v_0)
USUAL_SMOOTHING = 0.01  # rad/s, as of the plant
COULOMB = ("link_coulomb_friction", "motor_coulomb_friction")
LOAD = ("link_load_friction", "motor_load_friction")  # share of the spring's torque, as in gears
STATIC = ("link_static_friction", "motor_static_friction", STRIBECK)
LAG, RATIO = "actuator_lag", "gear_ratio_error"
"""Time constant of the torque behind an effort, which the delay contains; q_m without deflection over q_l, less 1."""
TIMING = ("effort_delay", LAG, "link_skew", "torque_skew")
DYNAMIC = tuple(name for name in KINDS if name not in (*TIMING, RATIO))  # parameters of the equations of motion
HARDENING = "cubic_stiffness"
FREED = {
    "static_friction": STATIC,
    "load_friction": LOAD,
    "payload": PAYLOAD,
    "cubic_stiffness": (HARDENING,),
    "link_inertia": PSEUDO_INERTIA,
    "position_torque": POSITION_TORQUE,
}
"""Parameters that options free, by the field of IdentifyOptions."""
USUAL = tuple(name for name in KINDS if not any(name in names for names in FREED.values()))  # free by default
LARGEST_SKEW = 8e-3  # s


@dataclass(frozen=True)
class IdentifyOptions:
    """What is identified.

    free: names of free parameters. joints: those whose parameters are free; empty: all. static_friction, load_friction,
    payload, cubic_stiffness: free these, too (the payload is a point mass on the last link); friction also where the
    records show it. link_inertia: free a correction of mass and inertia of each link, positive definite and near the
    robot's own. position_torque: joint with a torque sum_k a_k sin k q + b_k cos k q, k = 1, 2, on the link, such as a
    counterbalance; "": none. threads: number of segments evaluated at the same time.
    """

    free: tuple[str, ...] = USUAL
    joints: tuple[str, ...] = ()
    static_friction: bool = False
    load_friction: bool = False
    payload: bool = False
    cubic_stiffness: bool = False
    link_inertia: bool = False
    position_torque: str = ""
    threads: int = 2

    def __post_init__(self) -> None:
        unknown = [name for name in self.free if name not in KINDS]
        if unknown:
            raise ParameterError(f"free parameter {unknown[0]!r} is unknown; expected some of {', '.join(KINDS)}")

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all free parameters."""
        chosen = {name for option, names in FREED.items() if getattr(self, option) for name in names} | {*self.free}
        return tuple(name for name in KINDS if name in chosen)


Prior = Mapping[str, Array]
"""Values of all parameters before the records are read, by name: (n,) of joints, (1,) of the payload."""


def prior_of(robot: Robot, values: Mapping[str, ArrayLike] | None = None) -> dict[str, Array]:
    """Return the prior of a robot with diagonal K, M_m, D_l and D_m; values replace its own, 0 the others.

    Raises ParameterError.
    """
    unknown = [name for name in values or {} if name not in KINDS]
    if unknown:
        raise ParameterError(f"parameter {unknown[0]!r} is unknown; expected some of {', '.join(KINDS)}")
    of_robot: dict[str, ArrayLike] = {
        "joint_stiffness": _diagonal("K", robot.K),
        HARDENING: 0.0 if robot.cubic is None else robot.cubic,
        "motor_inertia": _diagonal("M_m", robot.M_m),
        "link_damping": _diagonal("D_l", robot.D_l),
        "motor_damping": _diagonal("D_m", robot.D_m),
    }
    usual = {**dict.fromkeys(KINDS, 0.0), SMOOTHING: USUAL_SMOOTHING, STRIBECK: USUAL_STRIBECK}
    complete = {**usual, **of_robot, **(values or {})}
    return {name: checks.vector(name, value, size(name, robot.n), ParameterError) for name, value in complete.items()}


def size(name: str, n: int) -> int:
    """Return the number of entries of a parameter for n joints."""
    return 1 if name in PAYLOAD else n


def _diagonal(name: str, matrix: Array) -> Array:
    if not checks.is_diagonal(matrix):
        raise ParameterError(f"{name} is not diagonal; expected one number per joint")
    return np.diag(matrix).copy()


@dataclass(frozen=True, eq=False)
class ParameterCoordinates:
    """The vector z of the free parameters (name, index), in the order of KINDS, with the normal prior of each.

    values: of all parameters in the prior, by name. width (p,): of the prior of z. z of a positive parameter is its
    logarithm, that of a lag its square. held: entries of z with respect to which no derivatives are taken, so that they
    keep their value or go to the prior.
    """

    free: tuple[tuple[str, int], ...]
    values: Prior
    width: Array
    held: frozenset[int] = frozenset()

    @cached_property
    def mean(self) -> Array:
        """Mean (p,) of the prior of z."""
        return self.of_values(self.values)

    @cached_property
    def moving(self) -> tuple[int, ...]:
        """Return the entries of z that are not held."""
        return tuple(k for k in range(len(self.free)) if k not in self.held)

    def parameters(self, z: Array) -> dict[str, Array]:
        """Return all parameters by name at z (p,)."""
        values = {name: np.array(value, dtype=float) for name, value in self.values.items()}
        for (name, i), value in zip(self.free, z, strict=True):
            coordinate = KINDS[name].coordinate
            values[name][i] = value if coordinate == NONNEGATIVE else natural(value, coordinate)
        return values

    def of_values(self, values: Mapping[str, Array]) -> Array:
        """Return z (p,) of parameters by name."""
        inverse = {LOG: np.log, SQUARE: np.square}
        return np.array([inverse.get(KINDS[name].coordinate, float)(values[name][i]) for name, i in self.free])

    def scale(self, z: Array) -> Array:
        """Return d parameter / d z (p,) at z; 1 for squares, by which derivatives are taken."""
        return np.exp(np.where(self._are(LOG), z, 0.0))

    @property
    def nonnegative(self) -> Array:
        """Return which entries (p,) of z are not negative."""
        return self._are(NONNEGATIVE, SQUARE)

    @property
    def dynamic(self) -> tuple[tuple[str, int], ...]:
        """Return the parameters of the equations of motion that are not held."""
        return tuple(self.free[k] for k in self.moving if self.free[k][0] in DYNAMIC)

    @property
    def delays(self) -> tuple[int, ...]:
        """Return the joints j whose effort delay is not held, and n + j of those whose actuator lag is not."""
        of_effort, n = ("effort_delay", LAG), len(self.values["effort_delay"])
        moving = (self.free[k] for k in self.moving)
        return tuple(of_effort.index(name) * n + j for name, j in moving if name in of_effort)

    def _are(self, *coordinates: str) -> Array:
        return np.array([KINDS[name].coordinate in coordinates for name, _ in self.free], dtype=bool)
