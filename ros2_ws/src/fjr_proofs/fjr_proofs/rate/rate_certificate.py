# SPDX-License-Identifier: Apache-2.0
"""Write the proof of a rate as numbers and lists that another program can check (docs/proof.md)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np

from fjr_core.law.gains import CheckedGains, Gains
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array

from ..verification.branch_and_bound import Part
from .proof_of_rate import RateProof

FORMAT = "rate certificate 1"
MARGIN = 1e-5
"""Relative distance of the rate in a certificate from the proven one; it gives other bounds room for rounding."""
LEAF = 0


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
        "boxes": _preorder(proof.inertia.proof.root),
    }
    return {**content, "sha256": digest(content)}


def digest(content: dict[str, Any]) -> str:
    """Return the SHA-256 digest of the entries as JSON with sorted keys and without white space."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def _preorder(root: Part) -> list[Any]:
    """Return the boxes as a tree in preorder: LEAF, or [joint, cut, ..] of a split, followed by its parts.

    Joints count from 0 at the base.
    """
    found: list[Any] = []
    left = [root]
    while left:
        part = left.pop()
        found.append(LEAF if part.axis is None else [part.axis + 1, *part.cuts])
        left += reversed(part.parts)
    return found
