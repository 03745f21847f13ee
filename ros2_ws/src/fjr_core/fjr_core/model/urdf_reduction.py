# SPDX-License-Identifier: Apache-2.0
"""Lock joints of a URDF by Pinocchio, which merges the fixed and locked bodies, once for each URDF.

To import Pinocchio takes 0.08 s, a fifth of a node's start. Its result is kept with the compiled code, and verified as
that is.
"""

from __future__ import annotations

import hashlib
import importlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from typing import Any

from ..errors import RobotError
from ..numerics.code_cache import code_folder, is_intact, keep

Numbers = list[Any]
"""An array as nested lists, which JSON keeps to the last bit."""


@dataclass(frozen=True)
class ReducedModel:
    """The k joints that are not locked, each with its body.

    names (k,); parents (k,): number of the joint before, from 1, 0 for the base. rotation (k, 3, 3), translation (k, 3)
    [m]: pose of the joint in its parent's frame. mass (k,) [kg], com (k, 3) [m], inertia (k, 3, 3) [kg m^2] about the
    centre of mass, in the frame of the joint.
    """

    names: list[str]
    parents: list[int]
    rotation: Numbers
    translation: Numbers
    mass: Numbers
    com: Numbers
    inertia: Numbers


def reduced_model(urdf: str, positions: Mapping[str, float]) -> ReducedModel:
    """Return the model with the joints at `positions` [rad, m] locked; raise RobotError.

    urdf: UrdfTree.skeleton. The key of a kept model contains the file of Pinocchio and its time of change.
    """
    try:
        inputs = json.dumps([urdf, dict(positions), *_installed()])
        folder, name = code_folder(), f"chain-{hashlib.sha256(inputs.encode()).hexdigest()[:32]}.json"
        if is_intact(folder, name):
            return ReducedModel(**json.loads(folder.read(name) or b""))
    except (OSError, ValueError, ImportError):  # no cache, or no Pinocchio
        return _reduced(urdf, positions)
    model = _reduced(urdf, positions)
    with suppress(OSError):
        keep(folder, name, json.dumps(asdict(model)).encode())
    return model


def _installed() -> tuple[str, int]:
    """Return the file of Pinocchio and its time of change [ns]; raise ValueError or ImportError if there is none."""
    spec = find_spec("pinocchio")
    if spec is None or spec.origin is None:
        raise ImportError("pinocchio")
    return spec.origin, os.stat(spec.origin).st_mtime_ns


def _reduced(urdf: str, positions: Mapping[str, float]) -> ReducedModel:
    try:
        pin = importlib.import_module("pinocchio")
    except ImportError as error:
        wanted = "expected it for reading a URDF: pip install pin (fjr_core[urdf]), or ros-jazzy-pinocchio"
        if "libgomp" in str(error):
            wanted = "expected this library, of the Debian package libgomp1"
        raise RobotError(f"Pinocchio cannot be imported ({error}); {wanted}") from None
    try:
        model = pin.buildModelFromXML(urdf)
    except Exception as error:  # its parser raises many types
        raise RobotError(f"Pinocchio cannot read the URDF ({error}); expected a valid one") from None
    q = pin.neutral(model)
    for name, position in positions.items():
        q[model.joints[model.getJointId(name)].idx_q] = position
    return _as_lists(pin.buildReducedModel(model, [model.getJointId(name) for name in positions], q))


def _as_lists(model: Any) -> ReducedModel:
    """Return the joints of a Pinocchio model but the first one, the universe."""
    placements, bodies = list(model.jointPlacements)[1:], list(model.inertias)[1:]
    return ReducedModel(
        names=list(model.names)[1:],
        parents=[int(parent) for parent in list(model.parents)[1:]],
        rotation=[placement.rotation.tolist() for placement in placements],
        translation=[placement.translation.tolist() for placement in placements],
        mass=[float(body.mass) for body in bodies],
        com=[body.lever.tolist() for body in bodies],
        inertia=[body.inertia.tolist() for body in bodies],
    )
