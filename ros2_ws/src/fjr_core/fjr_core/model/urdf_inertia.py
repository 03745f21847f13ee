# SPDX-License-Identifier: Apache-2.0
"""Write the masses and inertias of a serial chain back into its URDF."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ..numerics.checks import Array
from .rigid_body import Body, rotation_to
from .urdf_parser import parse_xml, read_urdf


def with_inertias(path_or_xml: str | os.PathLike[str], joints: Sequence[str], bodies: Sequence[Body]) -> str:
    """Return the URDF text with the inertia of each body, whose joint axis is z, at the link that its joint moves.

    Links that are fixed to it, or that joints without a name here carry, lose their own inertia: it is part of the
    body. Raises RobotError for a URDF that cannot be read.
    """
    tree = read_urdf(path_or_xml)
    inline = str(path_or_xml).lstrip().startswith("<")
    root = parse_xml(str(path_or_xml) if inline else Path(path_or_xml).read_bytes())
    links = {element.get("name", ""): element for element in root.findall("link")}
    for link in tree.moved_by(joints):
        for element in links[link].findall("inertial"):
            links[link].remove(element)
    for name, body in zip(joints, bodies, strict=True):
        joint = tree.joints[name]
        turn = rotation_to(np.asarray(joint.axis))
        _add_inertial(
            links[joint.child], body.mass, turn @ np.asarray(body.com), turn @ np.asarray(body.inertia) @ turn.T
        )
    ElementTree.indent(root)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _add_inertial(link: ElementTree.Element, mass: float, com: Array, inertia: Array) -> None:
    inertial = ElementTree.SubElement(link, "inertial")
    ElementTree.SubElement(inertial, "origin", xyz=" ".join(f"{each:.9g}" for each in com))
    ElementTree.SubElement(inertial, "mass", value=f"{mass:.9g}")
    entries = {f"i{'xyz'[i]}{'xyz'[k]}": f"{inertia[i, k]:.9g}" for i in range(3) for k in range(i, 3)}
    ElementTree.SubElement(inertial, "inertia", entries)
