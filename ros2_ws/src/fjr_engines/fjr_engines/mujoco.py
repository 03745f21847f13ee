# SPDX-License-Identifier: Apache-2.0
"""MuJoCo as the simulator of the plant; its steps are in native/mujoco_steps.c, which needs no Python.

The arm may touch an obstacle: the shapes of links and obstacle are geoms that collide with the other only. Those of the
links are the ones that the pages show (fjr_monitor.scene), each mesh as its convex hull: the visuals of the URDF, and
where there are none, capsules between the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fjr_core.config.plant import BOX, MJCF, TABLE, UP, Obstacle
from fjr_core.errors import ParameterError
from fjr_core.files.text_file import is_xml
from fjr_core.model.rigid_arm import rotation_to, tip_frame
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import MOTOR, Array
from fjr_core.numerics.jit import CFunction, CLibrary, WorkSpace, c_library
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant
from fjr_plant.engine import chain, check_equations

from .mjcf.export import add_looks
from .mjcf.writing import LINK, exact_inertia, quaternion, specification

PAYLOAD, PREFIX = "payload", "obstacle_"
DISABLED = mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_LIMIT
ARM, OBSTACLE = 1, 2
"""Bits of MuJoCo's contype of arm and obstacle; each has the other's as conaffinity."""


class MujocoEngine:
    """MuJoCo in place of the plant's own integrator (fjr_plant.engine.Engine); model, data: of MuJoCo."""

    in_python = False

    def __init__(
        self, plant: NonidealPlant, joints: Sequence[str], inner_step: int, ffi: Any, obstacle: Obstacle | None = None
    ) -> None:
        """inner_step [ns]: of the integrator; ffi: with the types of robot.h. Raises ParameterError, RobotError."""
        check_equations(plant, "mujoco")
        spec = specification(plant.robot, joints)
        spec.option.timestep, spec.option.disableflags = inner_step * 1e-9, DISABLED
        tip = spec.body(joints[chain(plant.robot)[-1][0]] + LINK)
        tip.add_body(name=PAYLOAD, mass=1.0, inertia=[1.0] * 3, explicitinertial=True)
        if obstacle:
            add_contact(spec, plant.robot, joints, obstacle)
        self.model = spec.compile()
        self._obstacle = np.flatnonzero(self.model.geom_contype == OBSTACLE)
        exact_inertia(self.model, plant.robot, joints)
        self.data = mujoco.MjData(self.model)
        self._tip = tip_frame(plant.robot.links)
        self._build(plant, [*joints, *(joint + MOTOR for joint in joints)])
        own, function = self._program.ffi, self._program.ffi.addressof(self._program.lib, "fjr_mujoco_advance")
        handle, address = (int(own.cast("intptr_t", each)) for each in (self._state, function))
        self.handle = ffi.cast("void*", handle)
        self.advance = ffi.cast("int(*)(void*, struct fjr_robot*, int64_t)", address)

    def use(self, imperfections: Imperfections) -> None:
        """Attach the payload; the other imperfections are arguments of each step."""
        payload = self.model.body(PAYLOAD)
        R, r = self._tip
        payload.mass, payload.inertia = imperfections.payload_mass, np.zeros(3)
        payload.pos = r + R @ np.asarray(imperfections.payload_position)
        mujoco.mj_setConst(self.model, self.data)
        self.forget()

    def forget(self) -> None:
        """Start from the state of the robot with the next step."""
        mujoco.mj_resetData(self.model, self.data)
        self._program.lib.fjr_mujoco_begin(self._state)

    def obstruct(self, present: bool, position: Array) -> None:
        """Put the obstacle to its place or take it away; raise ParameterError if the arm at q_l, q_m (2n,) is there."""
        geoms, there = self._obstacle, mujoco.MjData(self.model)
        self.model.geom_contype[geoms], self.model.geom_conaffinity[geoms] = OBSTACLE * present, ARM * present
        there.qpos[self._dof] = position
        try:
            check_outside(self.model, there)
        except ParameterError:
            self.model.geom_contype[geoms] = self.model.geom_conaffinity[geoms] = 0
            raise

    def _build(self, plant: NonidealPlant, joints: Sequence[str]) -> None:
        """Build struct fjr_mujoco; joints: of q_l and q_m."""
        self._program, ffi = mujoco_program(), mujoco_program().ffi
        functions = [plant.joint_torques, plant.memory_step]
        self._functions, self._space = [CFunction(ffi, function) for function in functions], WorkSpace(ffi, functions)
        self._dof = np.array([self.model.joint(name).dofadr[0] for name in joints], dtype=np.int32)
        self._known = ffi.new("double[]", 4 * plant.robot.n)
        given = {
            "model": ffi.cast("void*", self.model._address),
            "data": ffi.cast("void*", self.data._address),
            "dof": ffi.from_buffer("int32_t[]", self._dof),
            "known": self._known,
            "torques": self._functions[0].pointer,
            "memory": self._functions[1].pointer,
        }
        self._state = ffi.new("struct fjr_mujoco*", given)
        self._space.lend(self._state)


@cache
def mujoco_program() -> CLibrary:
    """Return the library of mujoco_steps.c, compiled and cached; raise CompilerError without a C compiler."""
    wheel, native = Path(mujoco.__file__).parent, files(__package__) / "native"
    robot = files("fjr_plant") / "native" / "robot.h"
    paths = robot, native / "mujoco_steps.h", native / "mujoco_steps.c"
    *headers, source = (path.read_text("utf-8") for path in paths)
    options = [f"-I{wheel / 'include'}", f"-L{wheel}", f"-l:libmujoco.so.{mujoco.__version__}", f"-Wl,-rpath,{wheel}"]
    return c_library("fjr_mujoco", "\n".join(headers), source, options=options)


def add_contact(spec: mujoco.MjSpec, robot: Robot, joints: Sequence[str], obstacle: Obstacle) -> None:
    """Add an obstacle and the shapes of the links of a robot of the named joints to its specification.

    Raises ParameterError, and RobotError for a URDF that cannot be read.
    """
    add_looks(spec, robot, joints, obstacle.urdf, obstacle.locked)
    for joint in joints:
        for geom in spec.body(joint + LINK).geoms:
            geom.contype, geom.conaffinity, geom.mass = ARM, OBSTACLE, 0.0
    add_obstacle(spec, obstacle)


def add_obstacle(spec: mujoco.MjSpec, obstacle: Obstacle) -> None:
    """Add the geoms of an obstacle to a specification; raises ParameterError."""
    other = _read(obstacle.mjcf) if obstacle.kind == MJCF else mujoco.MjSpec()
    if obstacle.kind != MJCF:
        centre, turn = obstacle.position, np.eye(3)
        if obstacle.kind != BOX:
            turn = rotation_to(np.asarray(UP if obstacle.kind == TABLE else obstacle.normal))
            centre = centre - turn[:, 2] * obstacle.size[2] / 2
        place = {"pos": centre, "quat": quaternion(turn), "size": obstacle.size / 2}
        kind, brown = mujoco.mjtGeom.mjGEOM_BOX, [0.7, 0.6, 0.5, 1.0]
        other.worldbody.add_geom(name=obstacle.kind, type=kind, rgba=brown, **place)
    for geom in other.geoms:
        geom.contype, geom.conaffinity = OBSTACLE, ARM
    spec.attach(other, prefix=PREFIX, frame=spec.worldbody.add_frame())


def _read(mjcf: str) -> mujoco.MjSpec:
    """Return the bodies of an MJCF path or text, of which none may move; raise ParameterError."""
    try:
        spec = mujoco.MjSpec.from_string(mjcf) if is_xml(mjcf) else mujoco.MjSpec.from_file(mjcf)
        spec.compile()
    except ValueError as error:
        raise ParameterError(f"obstacle.mjcf: {' '.join(str(error).split())}; expected a valid MJCF") from None
    if spec.joints:
        raise ParameterError(f"obstacle.mjcf has the joint '{spec.joints[0].name}'; expected bodies that do not move")
    if not spec.geoms:
        raise ParameterError("obstacle.mjcf has no geom; expected at least one")
    return spec


def check_outside(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise ParameterError if the arm at qpos of the data is inside the obstacle."""
    mujoco.mj_fwdPosition(model, data)
    if not data.ncon:
        return
    deepest = data.contact[int(np.argmin(data.contact.dist))]
    arm = next(geom for geom in deepest.geom if model.geom_contype[geom] == ARM)
    link = model.body(model.geom_bodyid[arm]).name.removesuffix(LINK)
    raise ParameterError(
        f"the obstacle is {-1e3 * deepest.dist:.3g} mm inside the link of {link}; expected it outside the arm"
    )
