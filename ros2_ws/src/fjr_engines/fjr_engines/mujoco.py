# SPDX-License-Identifier: Apache-2.0
"""MuJoCo as the simulator of the plant; its steps are in native/mujoco_steps.c, which needs no Python."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from fjr_core.config.plant import Obstacle
from fjr_core.model.rigid_arm import tip_frame
from fjr_core.numerics.checks import MOTOR, Array
from fjr_core.numerics.jit import CLibrary, c_library
from fjr_core.runtime.library import CFunction, WorkSpace
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant
from fjr_plant.engine import chain, check_equations

from .contact import ARM, OBSTACLE, InsideError, add_contact, check_outside
from .mjcf.writing import LINK, exact_inertia, specification

PAYLOAD = "payload"
DISABLED = mujoco.mjtDisableBit.mjDSBL_AUTORESET | mujoco.mjtDisableBit.mjDSBL_LIMIT


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
        spec.body(joints[chain(plant.robot)[-1][0]] + LINK).add_body(
            name=PAYLOAD, mass=1.0, inertia=[1.0] * 3, explicitinertial=True
        )
        if obstacle:
            add_contact(spec, plant.robot, joints, obstacle)
        self.model = spec.compile()
        self._obstacle = np.flatnonzero(self.model.geom_contype == OBSTACLE)
        exact_inertia(self.model, plant.robot, joints)
        self.data = mujoco.MjData(self.model)
        self._tip = tip_frame(plant.robot.links)
        self._build(plant, [*joints, *(joint + MOTOR for joint in joints)])
        handle = int(self._program.ffi.cast("intptr_t", self._state))
        function = self._program.ffi.addressof(self._program.lib, "fjr_mujoco_advance")
        self.handle = ffi.cast("void*", handle)
        self.advance = ffi.cast(
            "int(*)(void*, struct fjr_robot*, int64_t)", int(self._program.ffi.cast("intptr_t", function))
        )

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
        """Put the obstacle to its place or take it away; raise InsideError if the arm at q_l, q_m (2n,) is there."""
        geoms, there = self._obstacle, mujoco.MjData(self.model)
        self.model.geom_contype[geoms], self.model.geom_conaffinity[geoms] = OBSTACLE * present, ARM * present
        there.qpos[self._dof] = position
        try:
            check_outside(self.model, there)
        except InsideError:
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
    *headers, source = (
        path.read_text(encoding="utf-8") for path in (robot, native / "mujoco_steps.h", native / "mujoco_steps.c")
    )
    options = [f"-I{wheel / 'include'}", f"-L{wheel}", f"-l:libmujoco.so.{mujoco.__version__}", f"-Wl,-rpath,{wheel}"]
    return c_library("fjr_mujoco", "\n".join(headers), source, options=options)
