# SPDX-License-Identifier: Apache-2.0
"""Compare what models leave unexplained of the deflections in a record from which nothing was identified."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_design.uncertainty.posterior import Identification

from .motion_record import MotionRecord
from .parameters import Options, Prior
from .validation import predicted_deflection

STIFF = 1e12  # times the identified stiffness


@dataclass(frozen=True, eq=False)
class HoldOut:
    """Root mean square of the deflection q_m - q_l that models leave unexplained, relative to all of it, (n,) each.

    model: the identified one. rigid: no deflection, with the identified skew between the sides. no_skew: the identified
    stiffness without skew. NaN where a side is not measured. A rigid joint without skew explains nothing: 1.
    """

    record: str
    joints: tuple[str, ...]
    model: Array
    rigid: Array
    no_skew: Array


def hold_out(found: Identification, record: MotionRecord, robot: Robot, prior: Prior, options: Options) -> HoldOut:
    """Return what models leave unexplained of a record; robot, prior, options: of the identification."""

    def unexplained(name: str = "", factor: float = 1.0) -> Array:
        changed = replace(prior, values={**prior.values, **({name: factor * prior.values[name]} if name else {})})
        estimates = tuple(
            replace(each, value=factor * each.value) if each.name == name else each for each in found.estimates
        )
        return predicted_deflection(record, robot, changed, replace(found, estimates=estimates), options).unexplained

    return HoldOut(
        record.name,
        found.joints,
        unexplained(),
        unexplained("joint_stiffness", STIFF),
        unexplained("link_skew", 0.0),
    )
