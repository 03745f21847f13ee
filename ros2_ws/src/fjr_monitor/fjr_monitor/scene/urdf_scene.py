# SPDX-License-Identifier: Apache-2.0
"""Scene of a URDF: its joints and the shapes of its links as values for arm.js, which poses them in the browser."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fjr_core.config.robot_file import resolve
from fjr_core.errors import FjrError
from fjr_core.urdf.tree import UrdfJoint, parse_xml, read_urdf
from fjr_monitor.scene.mesh import Mesh, MeshError, decimated, read_mesh
from fjr_monitor.scene.skeleton import THIN, skeleton

TRIANGLES = 30_000  # of all meshes together: 0.4 MB of a page
LARGEST_SHAPE = 1e6  # m
Element = ElementTree.Element


def scene(urdf: str, locked: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return root, joints, links, meshes and notes of a URDF text; raises RobotError if it is not a valid URDF.

    locked: positions [rad, m] of joints that do not move, 0 by default. A link whose mesh cannot be read, and every
    link of a URDF without any visual, is drawn as a skeleton. Boxes, spheres and cylinders, which may leave gaps, are
    connected by thin bones if there is no mesh. notes: a sentence for each mesh that cannot be read.
    """
    tree = read_urdf(urdf)
    root = parse_xml(urdf.lstrip("\ufeff").strip())
    joints = [_joint(each, (locked or {}).get(each.name, 0.0)) for each in tree.joints.values()]
    elements = {each.get("name", ""): each for each in root.findall("link")}
    drawn = _Shapes(root)
    links = {name: drawn.of(element) for name, element in elements.items()}
    bare = drawn.incomplete if any(links.values()) or drawn.incomplete else set(elements)
    tips = {name: (2.0 * tree.inertias[name].com).tolist() if name in tree.inertias else None for name in bare}
    shaped = {} if drawn.meshes else {name: shapes for name, shapes in links.items() if name not in bare}
    bones = {name: shapes[0]["xyz"] if shapes else None for name, shapes in shaped.items()}
    for name, shapes in (skeleton(joints, tips) | skeleton(joints, bones, THIN)).items():
        links[name] = shapes + links[name]
    children = {joint["child"] for joint in joints}
    base = next(name for name in elements if name not in children)
    meshes = [decimated(mesh, TRIANGLES // len(drawn.meshes)).packed() for mesh in drawn.meshes.values()]
    return {"root": base, "joints": joints, "links": links, "meshes": meshes, "notes": drawn.notes}


def _joint(joint: UrdfJoint, position: float) -> dict[str, Any]:
    return {
        "name": joint.name,
        "kind": joint.kind,
        "parent": joint.parent,
        "child": joint.child,
        "axis": list(joint.axis),
        "xyz": list(joint.xyz),
        "rpy": list(joint.rpy),
        "position": position,
        "mimics": joint.mimics,
    }


class _Shapes:
    """Shapes of links; `meshes` in the order of their numbers, `incomplete`: links that lack a mesh."""

    def __init__(self, root: Element) -> None:
        named = ((each.get("name"), _colour(each)) for each in root.findall("material"))
        self._materials = {name: colour for name, colour in named if colour}
        self.meshes: dict[tuple[str, tuple[float, ...]], Mesh] = {}
        self.incomplete: set[str] = set()
        self.notes: list[str] = []

    def of(self, link: Element) -> list[dict[str, Any]]:
        """Return the shapes of a link's visuals; one that cannot be drawn is left out with a note."""
        shapes = []
        for visual in link.findall("visual"):
            try:
                xyz, rpy = _origin(visual)
                material = visual.find("material")
                colour = None if material is None else _colour(material) or self._materials.get(material.get("name"))
                shapes.append({"xyz": xyz, "rpy": rpy, "colour": colour, **self._geometry(visual)})
            except (FjrError, ValueError, StopIteration) as error:
                self.incomplete.add(link.get("name", ""))
                reason = str(error) if isinstance(error, FjrError) else "its geometry or a number in it is not valid"
                self.notes.append(f"a visual of link '{link.get('name')}' is not shown: {reason}")
        return shapes

    def _geometry(self, visual: Element) -> dict[str, Any]:
        element = next(iter(next(iter(visual.findall("geometry")))))
        if element.tag == "box":
            return {"kind": "box", "size": _numbers(element, "size", 3)}
        if element.tag == "sphere":
            return {"kind": "sphere", "size": _numbers(element, "radius", 1)}
        if element.tag == "cylinder":
            return {"kind": "cylinder", "size": _numbers(element, "radius", 1) + _numbers(element, "length", 1)}
        if element.tag != "mesh":
            raise ValueError(element.tag)
        return {"kind": "mesh", "mesh": self._mesh(element)}

    def _mesh(self, element: Element) -> int:
        name, scale = element.get("filename", ""), tuple(_numbers(element, "scale", 3, "1 1 1"))
        if (name, scale) not in self.meshes:
            self.meshes[name, scale] = read_mesh(_file(name), scale)
        return list(self.meshes).index((name, scale))


def _file(name: str) -> Path:
    path = resolve(name.removeprefix("file://"), Path())
    if not path.is_file():
        raise MeshError(f"the mesh {name} does not exist here")
    return path


def _origin(element: Element) -> tuple[list[float], list[float]]:
    origin = element.find("origin")
    if origin is None:
        return [0.0] * 3, [0.0] * 3
    return _numbers(origin, "xyz", 3, "0 0 0", math.inf), _numbers(origin, "rpy", 3, "0 0 0", math.inf)


def _colour(material: Element) -> str | None:
    """Return the colour of a material as #rrggbb; None without one, or if it is not four numbers."""
    element = material.find("color")
    if element is None:
        return None
    try:
        rgba = _numbers(element, "rgba", 4)
    except ValueError:
        return None
    return "#" + "".join(f"{round(255 * min(max(part, 0.0), 1.0)):02x}" for part in rgba[:3])


def _numbers(
    element: Element, attribute: str, count: int, default: str = "", most: float = LARGEST_SHAPE
) -> list[float]:
    """Return the numbers of an attribute; raises ValueError unless there are `count` of them, below `most` in size."""
    values = [float(word) for word in element.get(attribute, default).split()]
    if len(values) != count or not all(abs(value) < most for value in values):
        raise ValueError(attribute)
    return values
