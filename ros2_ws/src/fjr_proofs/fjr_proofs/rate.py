# SPDX-License-Identifier: Apache-2.0
"""Prove a convergence rate on a domain of joint positions, and write its certificate (docs/proof.md).

The block of sigma_l has the rate beta if D_l + K_ld - beta M_l(q_l) >= 0 for every q_l of the domain, i.e. for
M_l(q_l) <= (D_l + K_ld) / beta. The other blocks have closed forms. The certificate is numbers and lists that another
program can check.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from fjr_core.law.gains import CheckedGains, Gains
from fjr_core.law.rate import Rate, rate_from_inertia_bounds
from fjr_core.model.robot import Robot
from fjr_core.motions.domain import GOAL, MOST_BOXES, Domain
from fjr_core.numerics.checks import Array

from .verification.inertia_bounds import ProofBox, RelativeInertia, Watch, largest_inertia, unwatched

FORMAT = "rate certificate 1"
MARGIN = 1e-5
"""Relative distance of the rate in a certificate from the proven one; it gives other bounds room for rounding."""
LEAF = 0
SHARE = 40
"""The largest inertia, for eq. (50) only, takes at most 1 / SHARE of the boxes."""


@dataclass(frozen=True, eq=False)
class RateProof:
    """A proven rate, and the bound M_l(q_l) <= inertia.bound (D_l + K_ld) with its boxes."""

    rate: Rate
    inertia: RelativeInertia


def proof_of_rate(
    robot: Robot,
    gains: CheckedGains,
    domain: Domain | None = None,
    goal: float = GOAL,
    most_boxes: int = MOST_BOXES,
    samples: Array | tuple[()] = (),
    watch: Watch = unwatched,
) -> RateProof:
    """Return the proven rate of a robot on a domain, by default the joint range; see TrackingLaw.proven_rate.

    samples (k, n) [rad, m]: configurations of small rates, if known. watch: see verification.inertia_bounds.
    """
    inertia = largest_inertia(robot, robot.D_l + gains.K_ld, domain, goal, most_boxes, samples, watch)
    largest = largest_inertia(robot, 1.0, domain, goal, 1 + most_boxes // SHARE, samples)
    rate = rate_from_inertia_bounds(robot, gains, inertia.bound, inertia.attained, largest.bound)
    return RateProof(rate, inertia)


def rate_certificate(robot: Robot, gains: CheckedGains, proof: RateProof, joints: Sequence[str]) -> dict[str, Any]:
    """Return the certificate of a rate on a box of joint positions; all joints in the order of the chain.

    joints: names in the order of the robot. sha256: of the other entries, as digest() computes it.
    """
    at = np.argsort(robot.links.order)
    square = np.ix_(at, at)

    def matrix(value: Array) -> list[list[float]]:
        return value[square].tolist()

    content = {
        "format": FORMAT,
        "joints": [joints[k] for k in at],
        "bodies": [
            {
                "prismatic": body.prismatic,
                "rotation": np.asarray(body.rotation).tolist(),
                "translation": np.asarray(body.translation).tolist(),
                "mass": float(body.mass),
                "com": np.asarray(body.com).tolist(),
                "inertia": np.asarray(body.inertia).tolist(),
            }
            for body in robot.links.bodies
        ],
        **{name: matrix(getattr(robot, name)) for name in ("M_m", "D_l", "D_m")},
        **{field.name: matrix(getattr(gains, field.name)) for field in fields(Gains)},
        "lower": proof.inertia.lower[at].tolist(),
        "upper": proof.inertia.upper[at].tolist(),
        "beta": proof.rate.beta * (1 - MARGIN),
        "boxes": _preorder(proof.inertia.root),
    }
    return {**content, "sha256": digest(content)}


def digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 digest of the entries as JSON with sorted keys and without white space."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _preorder(root: ProofBox) -> list[Any]:
    """Return the boxes as a tree in preorder: LEAF, or [joint, cut, ..] of a split, followed by its parts.

    Joints count from 0 at the base.
    """
    entries: list[Any] = []
    left = [root]
    while left:
        box = left.pop()
        entries.append(LEAF if box.axis is None else [box.axis + 1, *box.cuts])
        left += reversed(box.parts)
    return entries
