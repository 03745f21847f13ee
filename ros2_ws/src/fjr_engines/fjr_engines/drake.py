# SPDX-License-Identifier: Apache-2.0
"""Drake as the simulator of the plant, in lock-step only, because each of its steps calls back into Python.

A joint is a pair of Drake's joints in series: q_m turns a rotor without mass, which has the reflected inertia M_m, and
q_l - q_m the link behind the spring. The kinetic energy is that of eq. (35), since the link moves with the sum of both.
Torques that Drake has no element for act as generalised forces at each stage of the integrator.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    FixedOffsetFrame,
    PrismaticJoint,
    PrismaticSpring,
    RevoluteJoint,
    RevoluteSpring,
    SpatialInertia,
    UnitInertia,
)
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from fjr_core.errors import RobotError
from fjr_core.model.rigid_arm import Body, tip_frame
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import MOTOR, Array
from fjr_core.numerics.symbolic import bind, evaluate
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant
from fjr_plant.engine import check_equations, gravity_and_chain

SPRING, ROTOR, LINK = "_spring", "_rotor", "_link"
"""Endings of the names of joints and bodies after that of the robot's joint, as MOTOR."""
PAYLOAD = "payload"
INTEGRATOR = "runge_kutta5"
"""Drake's method of Dormand and Prince, of order 5, here with the inner step of the plant."""


class DrakeEngine:
    """Drake in place of the plant's own integrator (fjr_plant.engine.Engine); arm, simulator: of Drake."""

    in_python = True

    def __init__(self, plant: NonidealPlant, joints: Sequence[str], inner_step: int, ffi: Any, _: None = None) -> None:
        """inner_step [ns]: of the integrator; ffi: with the types of robot.h. Raises ParameterError, RobotError."""
        check_equations(plant, "drake")
        self._plant, self._ffi, self._dt = plant, ffi, inner_step * 1e-9
        self.arm = multibody_plant(plant.robot, joints)
        self._map, builder = joint_map(self.arm, joints), DiagramBuilder()
        builder.AddSystem(self.arm)
        self._forces = builder.AddSystem(GeneralisedForces(plant, self._map))
        builder.Connect(self.arm.get_state_output_port(), self._forces.state)
        builder.Connect(self._forces.get_output_port(), self.arm.get_applied_generalized_force_input_port())
        self.simulator = Simulator(builder.Build())
        ResetIntegratorFromFlags(self.simulator, INTEGRATOR, self._dt).set_fixed_step_mode(True)
        self._context = self.simulator.get_mutable_context()
        self._of_arm = self.arm.GetMyMutableContextFromRoot(self._context)
        self._of_forces = self._forces.GetMyMutableContextFromRoot(self._context)
        n = plant.robot.n
        self._sizes = {"state": 6 * n, "u": n, "external": n, "parameters": len(Imperfections(n).vector)}
        self.handle = ffi.new_handle(self)
        self.advance = ffi.callback("int(void*, struct fjr_robot*, int64_t)", self._advance, error=1)

    def use(self, imperfections: Imperfections) -> None:
        """Attach the payload; the other imperfections are arguments of each step."""
        R, r = tip_frame(self._plant.robot.links)
        place = r + R @ np.asarray(imperfections.payload_position)
        (mass,) = np.asarray(imperfections.payload_mass)
        inertia = SpatialInertia(mass, place, UnitInertia.PointMass(place))
        self.arm.GetBodyByName(PAYLOAD).SetSpatialInertiaInBodyFrame(self._of_arm, inertia)

    def forget(self) -> None:
        """Begin at the time 0 with the next step."""
        self._context.SetTime(0.0)
        self.simulator.Initialize()

    def _advance(self, _: Any, robot: Any, steps: int) -> int:
        """Move struct fjr_robot by inner steps; where Drake stops at numbers that are not finite, it gets such ones."""
        state, u, external, parameters = (
            np.frombuffer(self._ffi.buffer(getattr(robot, name), 8 * size)) for name, size in self._sizes.items()
        )
        n = len(u)
        x, a, sliders = np.split(state, [4 * n, 5 * n])
        velocity, _ = self._plant.measure(state, parameters)
        self.arm.SetPositions(self._of_arm, np.linalg.solve(self._map, x[: 2 * n]))
        self.arm.SetVelocities(self._of_arm, np.linalg.solve(self._map, velocity))
        try:
            for _ in range(steps):
                self._forces.hold(self._of_forces, a, u, external, sliders, parameters)
                self.simulator.AdvanceTo(self._context.get_time() + self._dt)
                position = self._map @ self.arm.GetPositions(self._of_arm)
                a[:], sliders[:] = evaluate(self._plant.memory_step, position, a, u, sliders, parameters, self._dt)
            x[:] = self._plant.state(position, self._map @ self.arm.GetVelocities(self._of_arm), parameters)
        except RuntimeError:
            x[:] = np.nan
        return 0


class GeneralisedForces(LeafSystem):
    """Torques beside Drake's own elements, as generalised forces (2n,), which do the work of the torques.

    Inputs: `state` (4n,) of a MultibodyPlant, and `begin` [s], the time since which the other arguments are held.
    """

    def __init__(self, plant: NonidealPlant, coordinates: Array) -> None:
        """coordinates (2n, 2n): (q_l, q_m) of the coordinates of Drake."""
        super().__init__()
        self._map, self._damping, function = coordinates, np.diag(plant.robot.D_l), plant.joint_torques
        self._arguments = [np.zeros(function.size1_in(name)) for name in function.name_in()]
        self._torques = np.zeros(len(coordinates))
        self._evaluate = bind(function, self._arguments, [self._torques])
        self.state = self.DeclareVectorInputPort("state", 2 * len(coordinates))
        self.begin = self.DeclareVectorInputPort("begin", 1)
        self.DeclareVectorOutputPort("forces", len(coordinates), self._calculate)

    def hold(self, context: Context, *held: Array) -> None:
        """Hold a, u, external torques, sliders and parameters of NonidealPlant.joint_torques from now on."""
        for argument, values in zip(self._arguments[2:-1], held, strict=True):
            argument[:] = values
        self.begin.FixValue(context, context.get_time())

    def _calculate(self, context: Context, forces: BasicVector) -> None:
        q, dq, *_, t = self._arguments
        q[:], dq[:] = np.reshape(self.state.Eval(context), (2, -1)) @ self._map.T
        t[:] = context.get_time() - self.begin.Eval(context)
        self._evaluate()
        self._torques[: len(self._damping)] -= self._damping * dq[: len(self._damping)]
        forces.SetFromVector(self._map.T @ self._torques)


def multibody_plant(robot: Robot, joints: Sequence[str]) -> MultibodyPlant:
    """Return Drake's model of a robot of the n named joints; raise RobotError for one that it cannot express."""
    (gravity, bodies), arm = gravity_and_chain(robot, "Drake"), MultibodyPlant(time_step=0.0)
    arm.mutable_gravity_field().set_gravity_vector(gravity)
    frame = arm.world_frame()
    for k, body in bodies:
        pose = RigidTransform(RotationMatrix(np.asarray(body.rotation)), np.asarray(body.translation))
        base = arm.AddFrame(FixedOffsetFrame(joints[k], frame, pose))
        rotor = arm.AddRigidBody(joints[k] + ROTOR, SpatialInertia.Zero()).body_frame()
        frame = arm.AddRigidBody(joints[k] + LINK, spatial_inertia(body)).body_frame()
        kind, elastic = (PrismaticJoint, PrismaticSpring) if body.prismatic else (RevoluteJoint, RevoluteSpring)
        axis = np.asarray(body.axis)
        motor = arm.AddJoint(kind(joints[k] + MOTOR, base, rotor, axis, damping=robot.D_m[k, k]))
        arm.AddJointActuator(joints[k] + MOTOR, motor).set_default_rotor_inertia(robot.M_m[k, k])
        spring = arm.AddJoint(kind(joints[k] + SPRING, rotor, frame, axis))
        arm.AddForceElement(elastic(spring, 0.0, robot.K[k, k]))
    arm.WeldFrames(frame, arm.AddRigidBody(PAYLOAD, SpatialInertia.Zero()).body_frame())
    arm.Finalize()
    return arm


def joint_map(arm: MultibodyPlant, joints: Sequence[str]) -> Array:
    """Return T (2n, 2n) with (q_l, q_m) = T q of Drake's coordinates q."""
    n = len(joints)
    T = np.zeros((2 * n, 2 * n))
    for k, joint in enumerate(joints):
        motor, spring = (arm.GetJointByName(joint + end).position_start() for end in (MOTOR, SPRING))
        T[k, [motor, spring]] = T[n + k, motor] = 1.0
    return T


def spatial_inertia(body: Body) -> SpatialInertia:
    """Return the inertia of a link about the origin of its frame.

    Raises RobotError for a link without mass but with an inertia, which Drake does not have.
    """
    inertia, com = np.asarray(body.inertia), np.asarray(body.com)
    if not body.mass:
        if np.any(inertia):
            raise RobotError("a link has the mass 0 and an inertia; expected a mass: Drake has no other bodies")
        return SpatialInertia.Zero()
    G = UnitInertia(*(inertia / body.mass)[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    return SpatialInertia(body.mass, com, G.ShiftFromCenterOfMass(com), skip_validity_check=True)
