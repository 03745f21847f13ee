# SPDX-License-Identifier: Apache-2.0
"""Predict the deflection in a record that was not fitted: does the identified arm explain it better than a rigid one?

    q_m - q_l(t + skew) = offset + (M_l a + C v + grad P_l + D_l v + F_l(v) + T(q)) / K - skew v

The right side follows from the filtered motion of the record and the parameters alone; nothing is fitted. A rigid arm
without skew has a constant deflection.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from fjr_core.errors import StateError
from fjr_core.model.robot import Robot
from fjr_core.numerics import checks
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import Identification

from .elastic_arm import ElasticArm, free_entries, position_torque
from .initial_guess import decimated, filtered, inner, rigid_torque, shifted, smoothed
from .motion_record import MotionRecord
from .parameters import OF_LINKS, Options, Prior


@dataclass(frozen=True, eq=False)
class Deflection:
    """Deflection q_m - q_l of each joint in a record within the bandwidth of the motion, less its mean, in [rad].

    t (k,), measured, predicted (k, n), NaN where a side is not measured. unexplained (n,): root mean square of measured
    minus predicted relative to that of measured, which is what a rigid arm without skew leaves.
    """

    record: str
    joints: tuple[str, ...]
    t: Array
    measured: Array
    predicted: Array

    @property
    def rigid(self) -> Array:
        """Return the root mean square deflection (n,), which a rigid arm leaves unexplained."""
        return _rms(self.measured)

    @property
    def elastic(self) -> Array:
        """Return the root mean square difference (n,) of measured and predicted deflection."""
        return _rms(self.measured - self.predicted)

    @property
    def unexplained(self) -> Array:
        """Return elastic relative to rigid (n,)."""
        return self.elastic / self.rigid


def predicted_deflection(
    record: MotionRecord,
    robot: Robot,
    prior: Prior,
    found: Identification,
    options: Options = Options(),  # noqa: B008
) -> Deflection:
    """Return the deflection of a record, predicted by an identification from other records."""
    values = parameters_of(robot, prior, found, options)
    of_links = [
        (each.name, found.joints.index(each.joint) if each.joint else 0)
        for each in found.estimates
        if each.name in OF_LINKS
    ]
    arm = ElasticArm(robot, free_entries(ElasticArm(robot, ()).layout, of_links))
    motion = filtered(record, arm, values)
    q, v, a = motion.q_l, motion.v_l, motion.a_l
    skew = values["link_skew"]
    q, v, a = (np.column_stack([shifted(x[:, j], record.dt, s) for j, s in enumerate(skew)]) for x in (q, v, a))
    torque = rigid_torque(arm, values, q, v, a) + values["link_damping"] * v
    torque += values["link_coulomb_friction"] * np.tanh(v / values["smoothing"])
    torque += np.asarray(position_torque(SimpleNamespace(**values), q, np))
    measured = smoothed(record.q_m - record.q_l, record.dt)
    predicted = torque / values["joint_stiffness"] - skew * v
    measured, predicted = (inner(each, record.dt) for each in (measured, predicted))
    measured, predicted = (decimated(each - np.mean(each, axis=0), motion.stride) for each in (measured, predicted))
    t = record.dt * inner(np.arange(len(q), dtype=float), record.dt)[:: motion.stride]
    return Deflection(record.name, record.joints, t, measured, predicted)


def parameters_of(robot: Robot, prior: Prior, found: Identification, options: Options) -> Mapping[str, Array]:
    """Return all parameters by name: the estimates, where there is none the prior."""
    values = {name: value.copy() for name, value in prior.values.items()}
    for each in found.estimates:
        values[each.name][found.joints.index(each.joint) if each.joint else 0] = each.value
    velocities = {name: getattr(options, name) for name in ("smoothing", "stribeck")}
    return {**values, **{name: checks.vector(name, v, robot.n, StateError) for name, v in velocities.items()}}


def _rms(signal: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(signal**2, axis=0)))
