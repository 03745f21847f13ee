# SPDX-License-Identifier: Apache-2.0
"""Mesh files of several parts, rewritten so that coal reads every part.

coal numbers the corners of triangles rightly only in the first mesh of a node, and only in the root and its children.
An OBJ file therefore becomes one mesh without materials and groups, and a COLLADA file one node for each mesh.
"""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from itertools import count
from pathlib import Path
from xml.etree import ElementTree

Element = ElementTree.Element
DEEPEST = 50  # nodes within each other
MOST_NODES = 10_000  # nodes that instance each other in two places multiply
PARTING = {b"usemtl", b"mtllib", b"o", b"g", b"s", b"l", b"p"}  # lines of an OBJ file that part it, or are no face
PRIMITIVES = ("triangles", "polylist", "polygons", "tristrips", "trifans")
TRANSFORMS = ("matrix", "translate", "rotate", "scale", "skew", "lookat")


def in_one_level(path: Path) -> bytes | None:
    """Return the content of an OBJ or COLLADA file with its parts side by side; None for other files.

    Raises ElementTree.ParseError for a COLLADA file that is no XML, ValueError for one of more than MOST_NODES nodes.
    """
    if path.suffix.lower() == ".obj":
        lines = path.read_bytes().splitlines()
        return b"\n".join(line for line in lines if PARTING.isdisjoint(line.split(maxsplit=1)[:1]))
    if path.suffix.lower() == ".dae":
        return _flat_collada(path)
    return None


def _flat_collada(path: Path) -> bytes | None:
    """Return a COLLADA document whose scene has one node for each primitive of each geometry; None without any."""
    root = ElementTree.parse(path).getroot()
    for each in root.iter():
        each.tag = each.tag.rpartition("}")[2]  # without its namespace
    named = {f"#{each.get('id')}": each for each in root.iter() if each.get("id")}
    shown = root.find("scene/instance_visual_scene")
    scene = None if shown is None else named.get(shown.get("url", ""))
    if scene is None:
        return None
    parts = _one_primitive_each(root)
    nodes = []
    for number, (transforms, url) in enumerate(_placed(scene, named, [], DEEPEST, count(1))):
        for part in parts.get(url, []):
            node = Element("node", {"id": f"part_{number}_{part}"})
            node.extend(transforms)
            ElementTree.SubElement(node, "instance_geometry", {"url": f"#{part}"})
            nodes.append(node)
    scene[:] = nodes
    return ElementTree.tostring(root, encoding="utf-8") if nodes else None


def _one_primitive_each(root: Element) -> dict[str, list[str]]:
    """Add a geometry for each primitive but the first, which stays where it is; return their ids by the old URL."""
    parts: dict[str, list[str]] = {}
    for library in root.findall("library_geometries"):
        for geometry in library.findall("geometry"):
            mesh, name = geometry.find("mesh"), geometry.get("id", "")
            if mesh is None:
                continue
            primitives = [each for each in mesh if each.tag in PRIMITIVES]
            vertices = mesh.find("vertices")
            for each in [each for each in mesh if each.tag not in ("source", "vertices")]:
                mesh.remove(each)
            parts[f"#{name}"] = [f"{name}_{number}" if number else name for number in range(len(primitives))]
            for part, primitive in zip(parts[f"#{name}"], primitives, strict=True):
                if part != name:  # its sources are those of the first
                    other = ElementTree.SubElement(library, "geometry", {"id": part})
                    mesh = ElementTree.SubElement(other, "mesh")
                    mesh.extend([] if vertices is None else [deepcopy(vertices)])
                mesh.append(primitive)
    return parts


def _placed(
    node: Element, named: dict[str, Element], above: list[Element], depth: int, nodes: Iterator[int]
) -> Iterator[tuple[list[Element], str]]:
    """Yield the transforms, outermost first, and the URL of each geometry at or below a node; nodes: counts them."""
    if next(nodes) > MOST_NODES:
        raise ValueError(f"more than {MOST_NODES} nodes")
    transforms = above + [each for each in node if each.tag in TRANSFORMS]
    for each in node if depth else ():
        kind, url = each.tag, each.get("url", "")
        if kind == "instance_geometry":
            yield transforms, url
        elif kind == "node":
            yield from _placed(each, named, transforms, depth - 1, nodes)
        elif kind == "instance_node" and url in named:
            yield from _placed(named[url], named, transforms, depth - 1, nodes)
