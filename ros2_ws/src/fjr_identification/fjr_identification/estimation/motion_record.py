# SPDX-License-Identifier: Apache-2.0
"""A record of motion from which an arm is identified: effort and positions on a uniform grid of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_core.errors import StateError
from fjr_core.numerics.checks import Array, positive
from fjr_core.numerics.one_line import joints as joints_of


@dataclass(frozen=True, eq=False)
class MotionRecord:
    """k samples of n joints, `dt` [s] apart, reflected to the joint side.

    u (k, n) [N m]: effort that the motors were given from each sample to the next. q_l, q_m (k, n) [rad or m]:
    positions of links and motors, NaN: not measured (a joint without a link encoder has a column of NaN). torque (k, n)
    [N m]: spring torque from a sensor, NaN: none. name: of the file, for messages. Raises StateError for wrong shapes,
    an effort that is not finite and a joint without any measurement.
    """

    name: str
    joints: tuple[str, ...]
    dt: float
    u: Array
    q_l: Array
    q_m: Array
    torque: Array

    def __repr__(self) -> str:
        k, n = self.u.shape
        return f"MotionRecord({self.name!r}, {joints_of(n)}, {k} samples, dt={self.dt:.4g} s)"

    def __post_init__(self) -> None:
        positive("dt", self.dt, StateError)
        shape = np.shape(self.u)
        if len(shape) != 2 or shape[1] != len(self.joints):
            raise StateError(f"u has shape {shape}; expected (samples, {len(self.joints)})")
        for name in ("q_l", "q_m", "torque"):
            if np.shape(getattr(self, name)) != shape:
                raise StateError(f"{name} has shape {np.shape(getattr(self, name))}; expected {shape}")
        if not np.all(np.isfinite(self.u)):
            raise StateError("u is not finite at some sample; expected an effort at each sample")
        for j, joint in enumerate(self.joints):
            if not any(np.any(np.isfinite(getattr(self, name)[:, j])) for name in ("q_l", "q_m")):
                raise StateError(f"{joint} has neither link nor motor positions; expected at least one of them")
