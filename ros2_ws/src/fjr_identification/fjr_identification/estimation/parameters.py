# SPDX-License-Identifier: Apache-2.0
"""Parameters that can be identified: their units, coordinates, prior values, and which of them are free."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from fjr_core.errors import ParameterError
from fjr_core.model.robot import Robot
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import LINEAR, LOG, NONNEGATIVE


@dataclass(frozen=True)
class Kind:
    """Unit of a parameter of a revolute joint, its coordinate, and the width of its prior where it has a fixed one."""

    unit: str
    coordinate: str
    width: float | None = None


LOG_CHOLESKY = ("alpha", "d1", "d2", "d3", "s12", "s23", "s13", "t1", "t2", "t3")
KINDS = {
    "joint_stiffness": Kind("N m/rad", LOG, 0.7),
    "motor_inertia": Kind("kg m^2", LOG, 0.5),
    "link_damping": Kind("N m s/rad", NONNEGATIVE),
    "motor_damping": Kind("N m s/rad", NONNEGATIVE),
    "link_coulomb_friction": Kind("N m", NONNEGATIVE),
    "motor_coulomb_friction": Kind("N m", NONNEGATIVE),
    "link_static_friction": Kind("N m", NONNEGATIVE),
    "motor_static_friction": Kind("N m", NONNEGATIVE),
    "offset": Kind("rad", LINEAR, 0.02),
    "payload_mass": Kind("kg", NONNEGATIVE),
    "payload_position_x": Kind("m", LINEAR, 0.2),
    "payload_position_y": Kind("m", LINEAR, 0.2),
    "payload_position_z": Kind("m", LINEAR, 0.2),
    "position_torque_sin1": Kind("N m", LINEAR),
    "position_torque_cos1": Kind("N m", LINEAR),
    "position_torque_sin2": Kind("N m", LINEAR),
    "position_torque_cos2": Kind("N m", LINEAR),
    **{f"pseudo_inertia_{name}": Kind("", LINEAR, 0.1) for name in LOG_CHOLESKY},
    "effort_delay": Kind("s", LINEAR, 3e-3),
    "link_skew": Kind("s", LINEAR, 3e-3),
    "torque_skew": Kind("s", LINEAR, 3e-3),
}
"""All parameters by name. A width of None follows from the efforts and velocities of the records."""
PAYLOAD = ("payload_mass", "payload_position_x", "payload_position_y", "payload_position_z")
PSEUDO_INERTIA = tuple(f"pseudo_inertia_{name}" for name in LOG_CHOLESKY)
"""Correction of the mass and inertia of each link (estimation.pseudo_inertia); 0 is the robot file's."""
OF_LINKS = (*PAYLOAD, *PSEUDO_INERTIA)
"""Parameters that the torques of the rigid links depend on."""
POSITION_TORQUE = ("position_torque_sin1", "position_torque_cos1", "position_torque_sin2", "position_torque_cos2")
STATIC = ("link_static_friction", "motor_static_friction")
TIMING = ("effort_delay", "link_skew", "torque_skew")
USUAL = tuple(name for name in KINDS if name not in (*OF_LINKS, *POSITION_TORQUE, *STATIC))
"""Parameters that are free by default."""
LARGEST_SKEW = 8e-3  # s


@dataclass(frozen=True)
class Options:
    """What is identified.

    free: names of free parameters. joints: those whose parameters are free; empty: all. static_friction, payload: free
    these, too (the payload is a point mass on the last link). link_inertia: free a correction of mass and inertia of
    each link, positive definite and near the robot's own. position_torque: joint with a torque sum_k a_k sin k q +
    b_k cos k q, k = 1, 2, on the link, such as a counterbalance; "": none. smoothing, stribeck [rad/s]: velocities of
    the friction model, scalar or one per joint. segment [s]: length of the pieces of the record that are predicted;
    None: from the resonances. threads: number of segments evaluated at the same time.
    """

    free: tuple[str, ...] = USUAL
    joints: tuple[str, ...] = ()
    static_friction: bool = False
    payload: bool = False
    link_inertia: bool = False
    position_torque: str = ""
    smoothing: ArrayLike = 0.01
    stribeck: ArrayLike = 0.1
    segment: float | None = None
    threads: int = 2

    def __post_init__(self) -> None:
        unknown = [name for name in self.free if name not in KINDS]
        if unknown:
            raise ParameterError(f"free parameter {unknown[0]!r} is unknown; expected some of {', '.join(KINDS)}")
        if self.segment is not None:
            checks.positive("segment", self.segment, ParameterError)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of all free parameters."""
        chosen = [*self.free, *(STATIC if self.static_friction else ()), *(PAYLOAD if self.payload else ())]
        chosen += PSEUDO_INERTIA if self.link_inertia else ()
        chosen += POSITION_TORQUE if self.position_torque else ()
        return tuple(name for name in KINDS if name in chosen)


@dataclass(frozen=True, eq=False)
class Prior:
    """Values before the records are read, and how far off they may be.

    values: by parameter name, (n,) for those of joints, (1,) for those of the payload. widths: standard deviations of
    the same shapes, of the logarithm for positive parameters; missing ones have a default.
    """

    values: Mapping[str, Array]
    widths: Mapping[str, Array] = field(default_factory=dict)

    @classmethod
    def of(
        cls, robot: Robot, values: Mapping[str, ArrayLike] | None = None, widths: Mapping[str, ArrayLike] | None = None
    ) -> Prior:
        """Return the prior of a robot with diagonal K, M_m, D_l and D_m; values replace its own, 0 the others.

        Raises ParameterError.
        """
        own: dict[str, ArrayLike] = {
            "joint_stiffness": _diagonal("K", robot.K),
            "motor_inertia": _diagonal("M_m", robot.M_m),
            "link_damping": _diagonal("D_l", robot.D_l),
            "motor_damping": _diagonal("D_m", robot.D_m),
        }
        return cls(
            _shaped({**dict.fromkeys(KINDS, 0.0), **own, **(values or {})}, robot.n), _shaped(widths or {}, robot.n)
        )


def size(name: str, n: int) -> int:
    """Return the number of entries of a parameter for n joints."""
    return 1 if name in PAYLOAD else n


def _shaped(values: Mapping[str, ArrayLike], n: int) -> dict[str, Array]:
    unknown = [name for name in values if name not in KINDS]
    if unknown:
        raise ParameterError(f"parameter {unknown[0]!r} is unknown; expected some of {', '.join(KINDS)}")
    return {name: checks.vector(name, value, size(name, n), ParameterError) for name, value in values.items()}


def _diagonal(name: str, matrix: Array) -> Array:
    if np.any(matrix - np.diag(np.diag(matrix))):
        raise ParameterError(f"{name} is not diagonal; expected one number per joint")
    return np.diag(matrix).copy()
