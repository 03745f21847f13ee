# SPDX-License-Identifier: Apache-2.0
"""Scene of a URDF as values for arm.js, which poses it in the browser: joints, and shapes, meshes, bones of links."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.robot_file import resolve
from fjr_core.errors import FjrError
from fjr_core.urdf.tree import parse_xml, read_urdf

LARGEST = 64 * 2**20  # bytes of a file
MOST_NODES = 10_000  # of a COLLADA scene; nodes that instance each other in two places multiply
CELLS = (4096, 256, 160, 112, 80, 56, 40, 28, 20, 14, 10, 7, 5)  # along the longest side; the first joins equal points
STEPS = 65535  # of a packed coordinate
TRIANGLES = 30_000  # of all meshes together: 0.4 MB of a page
LARGEST_SHAPE = 1e6  # m
THICKNESS, THIN = 0.03, 0.012  # radius of a capsule, relative to the reach of the arm; THIN: inside other shapes
SMALLEST, STANDARD = 1e-3, 1.0  # m, shortest capsule; reach of an arm without lengths
Element = ElementTree.Element


class MeshError(FjrError):
    """A mesh cannot be read."""


@dataclass(frozen=True)
class Mesh:
    """Vertices (v, 3) [m] and triangles (m, 3) of vertex indices."""

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]

    def packed(self) -> dict[str, Any]:
        """Return the mesh as values for arm.js: 16 bits a coordinate, from `low` in steps of `step` [m]."""
        low = self.vertices.min(axis=0)
        step = np.maximum(np.ptp(self.vertices, axis=0), 1e-9) / STEPS
        return {
            "low": low.tolist(),
            "step": step.tolist(),
            "vertices": _text(np.rint((self.vertices - low) / step).astype("<u2")),
            "triangles": _text(self.triangles.astype("<u4" if len(self.vertices) > STEPS else "<u2")),
            "wide": len(self.vertices) > STEPS,
        }


def scene(urdf: str, locked: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return root, joints, links, meshes and notes of a URDF text; raises RobotError if it is not a valid URDF.

    locked: positions [rad, m] of joints that do not move, 0 by default. A link whose mesh cannot be read, and every
    link of a URDF without any visual, is drawn as a skeleton. Boxes, spheres and cylinders, which may leave gaps, are
    connected by thin bones if there is no mesh. notes: a sentence for each mesh that cannot be read.
    """
    drawn = shapes(urdf, locked)
    return drawn | {"meshes": [mesh.packed() for mesh in drawn["meshes"]]}


def shapes(urdf: str, locked: Mapping[str, float] | None = None) -> dict[str, Any]:
    """Return the values of `scene` with each mesh as a Mesh."""
    tree = read_urdf(urdf)
    root = parse_xml(urdf.lstrip("\ufeff").strip())
    joints = [
        {name: getattr(each, name) for name in ("name", "kind", "parent", "child", "axis", "xyz", "rpy", "mimics")}
        | {"position": (locked or {}).get(each.name, 0.0)}
        for each in tree.joints.values()
    ]
    elements = {each.get("name", ""): each for each in root.findall("link")}
    drawn = _Shapes(root)
    links = {name: drawn.of(element) for name, element in elements.items()}
    bare = drawn.incomplete if any(links.values()) or drawn.incomplete else set(elements)
    tips = {name: (2.0 * tree.inertias[name].com).tolist() if name in tree.inertias else None for name in bare}
    shaped = {} if drawn.meshes else {name: shapes for name, shapes in links.items() if name not in bare}
    bones = {name: shapes[0]["xyz"] if shapes else None for name, shapes in shaped.items()}
    for name, bare_shapes in (skeleton(joints, tips) | skeleton(joints, bones, THIN)).items():
        links[name] = bare_shapes + links[name]
    children = {joint["child"] for joint in joints}
    base = next(name for name in elements if name not in children)
    meshes = [decimated(mesh, TRIANGLES // len(drawn.meshes)) for mesh in drawn.meshes.values()]
    return {"root": base, "joints": joints, "links": links, "meshes": meshes, "notes": drawn.notes}


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
                origin = visual.find("origin")
                where = ElementTree.Element("origin") if origin is None else origin
                xyz, rpy = (_numbers(where, name, 3, "0 0 0", math.inf) for name in ("xyz", "rpy"))
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
            path = resolve(name.removeprefix("file://"), Path())
            if not path.is_file():
                raise MeshError(f"the mesh {name} does not exist here")
            self.meshes[name, scale] = read_mesh(path, scale)
        return list(self.meshes).index((name, scale))


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


def skeleton(
    joints: Sequence[Mapping[str, Any]], tips: Mapping[str, Sequence[float] | None], thickness: float = THICKNESS
) -> dict[str, list[dict[str, Any]]]:
    """Return the shapes of the links in `tips`, in their frames, as values for arm.js.

    joints: those of the scene. tips: where each link to draw ends if it has no further joint (3,) [m]; None: not known.
    thickness: radius of a capsule, relative to the reach of the arm.
    """
    ends: dict[str, list[Sequence[float]]] = {name: [] for name in tips}
    for joint in joints:
        if joint["parent"] in ends:
            ends[joint["parent"]].append(joint["xyz"])
    for name, tip in tips.items():
        if not ends[name] and tip is not None:
            ends[name].append(tip)
    reach = sum(float(np.linalg.norm(joint["xyz"])) for joint in joints)
    reach += sum(float(np.linalg.norm(each)) for points in ends.values() for each in points) / max(1, len(joints))
    radius = thickness * (reach or STANDARD)
    shapes: dict[str, list[dict[str, Any]]] = {name: [] for name in tips}
    for name, points in ends.items():
        for end in points:
            if np.linalg.norm(end) > SMALLEST:
                shapes[name].append({"kind": "capsule", "size": [radius], "to": [*map(float, end)], "colour": None})
    for joint in joints:  # a cylinder along the axis, about the origin of the child
        if joint["child"] in shapes and joint["kind"] != "fixed":
            along = 3.0 * radius * np.asarray(joint["axis"]) / np.linalg.norm(joint["axis"])
            hub = {"kind": "hub", "size": [1.5 * radius], "to": [*map(float, along)], "colour": None}
            shapes[joint["child"]].append(hub)
    return shapes


def read_mesh(path: Path, scale: tuple[float, ...]) -> Mesh:
    """Read an STL, OBJ, DAE or other mesh file that trimesh knows, scaled by (3,); raises MeshError in one sentence."""
    if path.is_file() and path.stat().st_size > LARGEST:
        raise MeshError(f"{path} has more than {LARGEST // 2**20} MiB")
    try:
        corners = (_collada if path.suffix.lower() == ".dae" else _mesh)(path)
    except ImportError as error:
        raise MeshError(f"the package {error.name}, which reads meshes, is not installed") from None
    except Exception:  # the readers raise many types
        raise MeshError(f"{path} cannot be read as a mesh") from None
    if not (len(corners) and np.isfinite(corners).all()):
        raise MeshError(f"{path} has no triangle, or a vertex that is not finite")
    return Mesh(corners.reshape(-1, 3) * scale, np.arange(3 * len(corners)).reshape(-1, 3))


def _mesh(path: Path) -> NDArray[np.float64]:
    """Return the corners (m, 3, 3) of all triangles of a file."""
    import trimesh

    mesh = trimesh.load_mesh(path, process=False, skip_materials=True)
    return np.asarray(mesh.vertices, dtype=float)[mesh.faces]


def _collada(path: Path) -> NDArray[np.float64]:
    """Return the corners (m, 3, 3) [m] of all triangles of a COLLADA scene; raise ValueError beyond MOST_NODES.

    pycollada skips what it cannot read, such as textures. trimesh has no limit of nodes.
    """
    from collada import Collada, DaeError
    from collada.polylist import Polylist
    from collada.scene import GeometryNode
    from collada.triangleset import TriangleSet

    def placed(node: Any, pose: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
        if next(nodes) > MOST_NODES:
            raise ValueError(f"more than {MOST_NODES} nodes")
        for part in node.geometry.primitives if isinstance(node, GeometryNode) else ():
            triangles = part.triangleset() if isinstance(part, Polylist) else part
            if isinstance(triangles, TriangleSet):
                yield (triangles.vertex @ pose[:3, :3].T + pose[:3, 3])[triangles.vertex_index]
        for child in getattr(node, "children", ()):
            yield from placed(child, pose @ getattr(node, "matrix", np.eye(4)))

    nodes, document = count(1), Collada(str(path), ignore=[DaeError])
    metres = np.diag([*[document.assetInfo.unitmeter or 1.0] * 3, 1.0])
    return np.concatenate([part for node in document.scene.nodes for part in placed(node, metres)])


def decimated(mesh: Mesh, most: int) -> Mesh:
    """Return the mesh with at most about `most` triangles: vertices of one cell of a grid become their mean."""
    for cells in CELLS:
        reduced = _clustered(mesh, cells)
        if len(reduced.triangles) <= most:
            break
    return reduced


def _clustered(mesh: Mesh, cells: int) -> Mesh:
    low = mesh.vertices.min(axis=0)
    side = max(float(np.ptp(mesh.vertices, axis=0).max()), 1e-9) / cells
    key = ((mesh.vertices - low) / side).astype(np.int64) @ np.array([1, 2**20, 2**40])
    _, place, count = np.unique(key, return_inverse=True, return_counts=True)
    sums = np.stack([np.bincount(place, column) for column in mesh.vertices.T], axis=1)
    corners = place[mesh.triangles]
    a, b, c = corners.T
    return Mesh(sums / count[:, None], corners[(a != b) & (b != c) & (c != a)])


def _text(numbers: NDArray[Any]) -> str:
    return base64.b64encode(numbers.tobytes()).decode()
