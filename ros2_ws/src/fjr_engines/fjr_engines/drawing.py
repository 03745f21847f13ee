# SPDX-License-Identifier: Apache-2.0
"""Draw an arm in MuJoCo at given positions; a link turns orange as its spring deflects.

As a program, draw a film: MuJoCo chooses its renderer when it is imported.
"""

from __future__ import annotations

import pickle
import sys

import mujoco
import numpy as np

from fjr_core.config.plant import obstacle
from fjr_core.config.robot import description, locked_positions
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array

from .mjcf.export import add_looks
from .mjcf.writing import specification
from .mujoco import add_obstacle

ORANGE = np.array([0.9, 0.4, 0.0, 1.0])
AZIMUTH, ELEVATION, FIELD = 125.0, -20.0, 30.0  # degrees; of the camera
SHADOW = 1024  # pixels of each side of the shadow map; MuJoCo's own 4096 take a quarter of the drawing
CLOSER = 0.8  # the camera is nearer than where a ball about all poses is seen


class DrawnArm:
    """MuJoCo's `model` of an arm, its obstacle and a floor, and `data`, which `pose` changes.

    largest (n,): deflection so far [rad, m]. Raises RobotError, and ValueError for a mesh that MuJoCo refuses.
    """

    def __init__(self, scenario: Scenario) -> None:
        robot, joints, values = scenario.plant.robot, scenario.joints, scenario.plant_values
        spec = specification(robot, joints)
        add_looks(spec, robot, joints, description(values), locked_positions(values))
        if (found := obstacle(values)) is not None:
            add_obstacle(spec, found)
        _add_surroundings(spec)
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        self.largest = np.full(len(joints), 1e-9)
        self._positions = [self.model.joint(joint).qposadr[0] for joint in joints]
        bodies = {self.model.joint(joint).bodyid[0]: k for k, joint in enumerate(joints)}
        self._shapes = [(i, bodies[body]) for i, body in enumerate(self.model.geom_bodyid) if body in bodies]
        self._colours = self.model.geom_rgba.copy()

    def pose(self, q_l: Array, q_m: Array) -> None:
        """Pose and colour the links by the positions (n,) [rad, m] of both sides."""
        deflection = np.abs(np.nan_to_num(q_m - q_l))
        self.largest = np.maximum(self.largest, deflection)
        for i, k in self._shapes:
            share = deflection[k] / self.largest[k]
            self.model.geom_rgba[i] = (1.0 - share) * self._colours[i] + share * ORANGE
        self.data.qpos[self._positions] = q_l
        mujoco.mj_kinematics(self.model, self.data)
        mujoco.mj_camlight(self.model, self.data)

    def camera(self, q_l: Array) -> mujoco.MjvCamera:
        """Return a camera that sees the arm at all positions (k, n)."""
        places = []
        for pose in q_l:
            self.pose(pose, pose)
            places.append(self.data.geom_xpos.copy())
        ends = np.array([np.min(places, axis=(0, 1)), np.max(places, axis=(0, 1))])
        camera = mujoco.MjvCamera()
        camera.lookat, camera.azimuth, camera.elevation = ends.mean(axis=0), AZIMUTH, ELEVATION
        radius = 0.5 * np.linalg.norm(np.ptp(ends, axis=0)) + self.model.geom_rbound.max()
        camera.distance = CLOSER * radius / np.sin(0.5 * np.radians(FIELD))
        return camera


def _add_surroundings(spec: mujoco.MjSpec) -> None:
    """Add a floor with a grid, a sky and a lamp."""
    kinds, builtin = mujoco.mjtTexture, mujoco.mjtBuiltin
    sky = {"rgb1": [1.0, 1.0, 1.0], "rgb2": [0.85, 0.9, 0.95], "width": 64, "height": 384}
    spec.add_texture(type=kinds.mjTEXTURE_SKYBOX, builtin=builtin.mjBUILTIN_GRADIENT, **sky)
    grid = {"rgb1": [0.86, 0.88, 0.9], "rgb2": [0.8, 0.82, 0.85], "width": 128, "height": 128}
    spec.add_texture(name="grid", type=kinds.mjTEXTURE_2D, builtin=builtin.mjBUILTIN_CHECKER, **grid)
    floor = spec.add_material(name="grid", texuniform=True, texrepeat=[4.0, 4.0])
    floor.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "grid"
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0], material="grid")
    spec.worldbody.add_light(pos=[0.7, -1.5, 3.0], dir=[-0.2, 0.5, -1.0], diffuse=[0.5] * 3, cutoff=60.0)
    head = spec.visual.headlight
    head.ambient, head.diffuse, head.specular = [0.35] * 3, [0.4] * 3, [0.1] * 3
    spec.visual.global_.fovy, spec.visual.quality.shadowsize = FIELD, SHADOW


def main() -> None:
    """Read (arm, positions of links and motors (k, n), height, width); write its frames, three bytes a pixel."""
    arm, q_l, q_m, *size = pickle.load(sys.stdin.buffer)
    camera = arm.camera(q_l)
    arm.largest = np.maximum(arm.largest, np.abs(np.nan_to_num(q_m - q_l)).max(axis=0))
    with mujoco.Renderer(arm.model, *size) as renderer:
        for positions in zip(q_l, q_m, strict=True):
            arm.pose(*positions)
            renderer.update_scene(arm.data, camera)
            sys.stdout.buffer.write(renderer.render().tobytes())


if __name__ == "__main__":
    main()
