# SPDX-License-Identifier: Apache-2.0
"""Random serial chains and URDFs with their Pinocchio models, the oracle for arms with any number of joints."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

import fjr_core as fjr
from core.oracles.cases import FULL, PLANAR, Arm, Array, GainSet, gain_set, square
from fjr_core.model.rigid_arm import ArmDynamics

ROBOTS = Path(__file__).parents[3] / "ros2_ws/src/fjr_bringup/robots"
ARM7 = ROBOTS / "arm7.urdf"
ARM7_JOINTS = tuple(f"joint{i}" for i in range(1, 8))


class PinocchioLinks:
    """M, C, P and grad_P of the named joints of a Pinocchio model, with the others locked at the given positions.

    It accepts floats only. The argument `f` exists because the closed forms of oracles/cases.py have it.
    """

    def __init__(self, model: Any, names: Any, locked: dict[str, float] | None = None) -> None:
        self.model, self.data, self.n = model, model.createData(), len(names)
        self.joints = [model.joints[model.getJointId(name)] for name in names]
        self.rows = [joint.idx_v for joint in self.joints]
        self.rest = pin.neutral(model)
        for name, position in (locked or {}).items():
            self._place(self.rest, model.joints[model.getJointId(name)], position)

    def _place(self, q: Array, joint: Any, position: float) -> None:
        """Write a joint position to the configuration; Pinocchio stores continuous joints as (cos, sin)."""
        values = [position] if joint.nq == 1 else [np.cos(position), np.sin(position)]
        q[joint.idx_q : joint.idx_q + joint.nq] = values

    def q(self, q_l: Array) -> Array:
        q = self.rest.copy()
        for joint, position in zip(self.joints, q_l, strict=True):
            self._place(q, joint, position)
        return q

    def v(self, dq_l: Array) -> Array:
        v = np.zeros(self.model.nv)
        v[self.rows] = dq_l
        return v

    def M(self, q_l: Array, f: Any = np) -> Array:
        upper = np.triu(pin.crba(self.model, self.data, self.q(q_l)))
        return (upper + np.triu(upper, 1).T)[np.ix_(self.rows, self.rows)]

    def C(self, q_l: Array, dq_l: Array, f: Any = np) -> Array:
        C = pin.computeCoriolisMatrix(self.model, self.data, self.q(q_l), self.v(dq_l))
        return C[np.ix_(self.rows, self.rows)].copy()

    def P(self, q_l: Array, f: Any = np) -> float:
        return float(pin.computePotentialEnergy(self.model, self.data, self.q(q_l)))

    def grad_P(self, q_l: Array, f: Any = np) -> Array:
        return pin.computeGeneralizedGravity(self.model, self.data, self.q(q_l))[self.rows].copy()


@dataclass(frozen=True, eq=False)
class Chain:
    """A random chain as ArmDynamics and as a Pinocchio model."""

    links: ArmDynamics
    pinocchio: PinocchioLinks

    @property
    def n(self) -> int:
        return self.links.n


@cache
def random_chain(n: int, seed: int) -> Chain:
    """Return a chain of n revolute or prismatic joints with random axes and gravity in a random direction."""
    rng = np.random.default_rng((n, seed))
    gravity = rng.normal(size=3) * 5
    model, bodies, parent = pin.Model(), [], 0
    for i in range(n):
        axis, prismatic = random_axis(rng), bool(rng.random() < 0.3)
        joint = (pin.JointModelPrismaticUnaligned if prismatic else pin.JointModelRevoluteUnaligned)(*axis)
        placement = pin.SE3(random_rotation(rng), rng.uniform(-0.5, 0.5, 3))
        mass, com, inertia = random_inertia(rng)
        parent = model.addJoint(parent, joint, placement, f"joint{i}")
        model.appendBodyToJoint(parent, pin.Inertia(mass, com, inertia), pin.SE3.Identity())
        bodies.append(fjr.Body(placement.rotation, placement.translation, axis, mass, com, inertia, prismatic))
    model.gravity.linear = gravity
    return Chain(fjr.serial_chain(bodies, gravity), PinocchioLinks(model, list(model.names)[1:]))


def random_axis(rng: np.random.Generator) -> Array:
    """Return a unit vector: a coordinate axis, a reversed one, or a random direction."""
    axis = rng.normal(size=3) if rng.random() < 0.5 else rng.choice([-1, 1]) * np.eye(3)[rng.integers(3)]
    return axis / np.linalg.norm(axis)


def random_rotation(rng: np.random.Generator) -> Array:
    return pin.rpy.rpyToMatrix(rng.uniform(-3, 3, 3))


def random_inertia(rng: np.random.Generator) -> tuple[float, Array, Array]:
    """Return mass, centre of mass and inertia about it of a randomly oriented box."""
    mass, turn = rng.uniform(0.5, 4.0), random_rotation(rng)
    squares = rng.uniform(0.05, 0.4, 3) ** 2
    inertia = turn @ np.diag(mass / 12 * (np.sum(squares) - squares)) @ turn.T
    return mass, rng.uniform(-0.3, 0.3, 3), (inertia + inertia.T) / 2


@dataclass(frozen=True)
class UrdfCase:
    """A random URDF, joint names in an order other than that of the chain, and positions of the locked joints."""

    xml: str
    joints: tuple[str, ...]
    locked: dict[str, float]
    gravity: Array

    @property
    def pinocchio(self) -> PinocchioLinks:
        """Return the Pinocchio model of the whole arm, read from the same text."""
        model = pin.buildModelFromXML(self.xml)
        model.gravity.linear = self.gravity
        return PinocchioLinks(model, self.joints, self.locked)


def random_urdf(n: int, seed: int) -> UrdfCase:
    """Return a chain of n named joints with fixed and locked joints in between and a branch at every link."""
    rng = np.random.default_rng((n, seed))
    parts, tip = [link_xml("base", rng)], "base"
    named: list[str] = []
    locked: dict[str, float] = {}
    for i in range(n):
        for kind in rng.permutation(["fixed", "locked", "named"]):
            child = f"{kind}_link{i}"
            parts += [joint_xml(f"{kind}{i}", kind_of(kind, rng), tip, child, rng), link_xml(child, rng)]
            tip = child
        parts += [
            joint_xml(f"side{i}", kind_of("locked", rng), tip, f"side_link{i}", rng),
            link_xml(f"side_link{i}", rng),
        ]
        named.append(f"named{i}")
        locked |= {f"locked{i}": rng.uniform(-2, 2), f"side{i}": rng.uniform(-2, 2)}
    order = tuple(str(name) for name in rng.permutation(named))
    return UrdfCase(robot_xml(*parts), order, locked, rng.normal(size=3) * 5)


def kind_of(role: str, rng: np.random.Generator) -> str:
    return "fixed" if role == "fixed" else str(rng.choice(["revolute", "continuous", "prismatic"]))


def robot_xml(*parts: str) -> str:
    return '<robot name="random">' + "".join(parts) + "</robot>"


def numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def link_xml(name: str, rng: np.random.Generator) -> str:
    mass, com, inertia = random_inertia(rng)
    entries = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = " ".join(f'{key}="{float(inertia[at])!r}"' for key, at in entries.items())
    origin = f'<origin xyz="{numbers(com)}" rpy="{numbers(rng.uniform(-3, 3, 3))}"/>'
    return f'<link name="{name}"><inertial>{origin}<mass value="{mass!r}"/><inertia {values}/></inertial></link>'


def joint_xml(name: str, kind: str, parent: str, child: str, rng: np.random.Generator) -> str:
    place = f'<origin xyz="{numbers(rng.uniform(-0.5, 0.5, 3))}" rpy="{numbers(rng.uniform(-3, 3, 3))}"/>'
    axis = f'<axis xyz="{numbers(random_axis(rng))}"/><limit lower="-3" upper="3" effort="9" velocity="2"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{place}{axis}</joint>'


STIFF = {
    "stiffness": (10000.0, 10000.0, 8000.0, 8000.0, 5000.0, 4000.0, 3000.0),
    "motor_inertia": (0.6, 0.6, 0.45, 0.45, 0.2, 0.2, 0.2),
    "link_damping": 0.5,
    "motor_damping": (2.0, 2.0, 1.5, 1.5, 1.0, 0.5, 0.5),
    "input_gain": 1.0,
}


def urdf_arm(name: str, urdf: Any, joints: tuple[str, ...], **values: Any) -> Arm:
    """Return the robot from the URDF with the Pinocchio model of the whole URDF."""
    robot = fjr.robot_from_urdf(urdf, list(joints), **values)
    model = pin.buildModelFromXML(Path(urdf).read_text() if isinstance(urdf, Path) else urdf)
    keys = ("stiffness", "motor_inertia", "link_damping", "motor_damping", "input_gain")
    matrices = (square(values[key], len(joints)) for key in keys)
    straight = np.zeros(len(joints))
    return Arm(name, robot, PinocchioLinks(model, joints), *matrices, straight, load=10.0)


@cache
def arm7() -> Arm:
    """Return the seven-joint arm with a stiff drive train."""
    return urdf_arm("arm7", ARM7, ARM7_JOINTS, **STIFF)


def scaled_gains(arm: Arm, beta: float = 10.0, cubic: bool = False) -> GainSet:
    """Return gains scaled to the robot: Pi_l and K_ld with diag M_l, Pi_m with K, K_md with M_m."""
    M = np.diag(arm.links.M(np.full(arm.n, 0.5)))
    Pi_l, Pi_m = beta**2 * M, np.diag(arm.K)
    return gain_set(
        f"scaled{'-cubic' if cubic else ''}",
        arm.n,
        Lambda_l=beta,
        Pi_l=Pi_l,
        K_ld=2 * beta * M,
        Lambda_m=1.5 * beta,
        Pi_m=Pi_m,
        K_md=2 * beta * np.diag(arm.M_m),
        Gamma_l=4.0 if cubic else 0.0,
        Gamma_m=2.0 if cubic else 0.0,
    )


@cache
def two_joints() -> Arm:
    """Return a two-link arm with skew axes, gravity and full elastic matrices."""
    m, c, inertia = PLANAR["link_mass"], PLANAR["link_com"], PLANAR["link_inertia"]
    links = "".join(
        f'<link name="link{i}"><inertial><origin xyz="0.02 0.01 {-c[i]}"/><mass value="{m[i]}"/>'
        f'<inertia ixx="0.01" ixy="0" ixz="0" iyy="{inertia[i]}" iyz="0" izz="0.006"/></inertial></link>'
        for i in (0, 1)
    )
    joints = "".join(
        f'<joint name="joint{i}" type="revolute"><parent link="{parent}"/><child link="link{i}"/>'
        f'<origin xyz="0 0 {z}"/><axis xyz="{axis}"/><limit lower="-3" upper="3" effort="9" velocity="9"/></joint>'
        for i, parent, z, axis in ((0, "base", 0, "0 1 0"), (1, "link0", -0.3, "0.6 0.8 0"))
    )
    return urdf_arm(
        "two",
        f'<robot name="two"><link name="base"/>{links}{joints}</robot>',
        ("joint1", "joint0"),
        **FULL,
    )
