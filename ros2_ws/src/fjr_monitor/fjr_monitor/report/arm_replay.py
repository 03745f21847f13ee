# SPDX-License-Identifier: Apache-2.0
"""Replay of a run in 3D: the scene of its URDF and the motion of links, motors and reference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fjr_core.config.robot import description, locked_positions
from fjr_core.numerics.checks import Array
from fjr_monitor.plotting.figure import Pool
from fjr_monitor.report.shown import Shown
from fjr_monitor.scene.urdf_scene import scene
from fjr_msgs_py.console.output import number

VISIBLE = 0.3  # rad or m, of the largest deflection as magnified at first
FACTORS = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)


@dataclass(frozen=True)
class ArmReplay:
    """What the page shows of the arm: a scene (urdf_scene.py) and positions [rad, m] at the times t (k,) [s].

    title: the result. link, motor, reference (k, n): q_l, q_m on the link side of the gears, q_ld; NaN: not known.
    magnification: of the deflections at first.
    """

    title: str
    scene: dict[str, Any]
    joints: Sequence[str]
    t: Array
    link: Array
    motor: Array
    reference: Array
    magnification: int

    @property
    def notes(self) -> list[str]:
        """Return a sentence for each visual that is not shown."""
        return list(self.scene["notes"])

    def packed(self, pool: Pool) -> dict[str, Any]:
        """Return the replay as values for arm_replay.js; its arrays are added to the pool."""
        motion = {"link": self.link, "motor": self.motor, "reference": self.reference}
        known = {name: values for name, values in motion.items() if np.isfinite(values).any()}
        return {
            "scene": self.scene,
            "joints": list(self.joints),
            "t": pool.add(self.t, np.float64),
            "motion": {name: [pool.add(column) for column in values.T] for name, values in known.items()},
            "magnification": self.magnification,
        }


def arm_replay(data: Shown) -> ArmReplay | None:
    """Return the replay of a run; None without positions of the links. Raises ParameterError, RobotError."""
    values, frames = data.run.scenario.controller_values, data.frames
    link, motor = frames["q_l"], frames["q_m"]
    if not np.isfinite(link).any():
        return None
    return ArmReplay(
        _title(data),
        scene(description(values), locked_positions(values)),
        data.run.joints,
        frames["t"],
        link,
        motor,
        frames["q_ld"],
        magnification(motor - link),
    )


def _title(data: Shown) -> str:
    """Return the largest deflection of a spring as a sentence."""
    sizes, joints = data.deflection, data.run.joints
    if not np.isfinite(sizes).any():
        return "The motion of the links"
    joint = int(np.nanargmax(sizes))
    largest = number(float(sizes[joint]), data.run.units[joint].position)
    return f"The {'springs deflect' if len(joints) > 1 else 'spring deflects'} by at most {largest}" + (
        f", at {joints[joint]}" if len(joints) > 1 else ""
    )


def magnification(deflection: Array) -> int:
    """Return the largest of FACTORS with which the deflections (k, n) stay below VISIBLE; 1 if none is known."""
    largest = float(np.nanmax(np.abs(deflection), initial=0.0))
    return max((factor for factor in FACTORS if factor * largest <= VISIBLE), default=1) if largest else 1
